"""The virtual controller: a scenario's cell behind the ports of a UR5.

    controller.py   the robot's computer: one tick after the other, it moves the cell and says what it publishes
    urscript/       the language: text -> syntax -> threads, a tick at a time; knows no robot
    builtins/       URScript's functions, on the controller
    rtde.py, realtime.py, dashboard.py, primary.py, net_ft.py, mti.py   what goes over each port, and who listens
    server.py       the ports of one controller, and the thread that ticks

Two threads: one ticks, and owns controller and cell; the other runs all ports in one asyncio loop. What a client asks
for goes to the first as an action (``VirtualController.post``), what the controller publishes comes to the second as a
``State``, which nobody changes any more.
"""
