"""ur_rtde's receive interface in a process of its own: ``python -m ur5_twin.sources.rtde_reader HOST FREQUENCY``.

Its constructor keeps Python's lock until the controller answers, for ever if that is mute, and it keeps nothing but the
newest package, so that whoever is late loses rows. Here nobody else needs the lock, nothing else makes it late, and a
reader that hangs can be killed. Rows go to standard output as native doubles, ``WIDTH`` each; end of standard input, or
of whoever reads the rows, ends the process. The only place that imports ur_rtde.
"""

from __future__ import annotations

import os
import select
import signal
import struct
import sys
import time

#: What is read, by RTDE's name -> name of the getter and width. All controllers with RTDE have these.
SIGNALS = {
    "target_q": ("getTargetQ", 6),
    "target_qd": ("getTargetQd", 6),
    "target_qdd": ("getTargetQdd", 6),
    "target_current": ("getTargetCurrent", 6),
    "target_moment": ("getTargetMoment", 6),
    "actual_q": ("getActualQ", 6),
    "actual_qd": ("getActualQd", 6),
    "actual_current": ("getActualCurrent", 6),
    "actual_TCP_pose": ("getActualTCPPose", 6),
    "actual_TCP_speed": ("getActualTCPSpeed", 6),
    "actual_TCP_force": ("getActualTCPForce", 6),
    "actual_tool_accelerometer": ("getActualToolAccelerometer", 3),
    "joint_temperatures": ("getJointTemperatures", 6),
    "robot_mode": ("getRobotMode", 1),
    "safety_mode": ("getSafetyMode", 1),
    "runtime_state": ("getRuntimeState", 1),
    "speed_scaling": ("getSpeedScaling", 1),
}
#: Doubles of a row: arrival on the monotonic clock and the controller's stamp, s, then the signals.
WIDTH = 2 + sum(width for _, width in SIGNALS.values())
#: Asked for beside these: ur_rtde reads them by itself.
_BESIDE = ("timestamp", "robot_status_bits", "safety_status_bits")
#: Looks at the newest package per period, and the shortest and longest wait between two, s.
_LOOKS, _SHORTEST, _LONGEST = 6, 0.0003, 0.001
#: How often it looks whether anybody still wants rows, and whether the connection is up, s.
_GLANCE = 0.2


def main() -> int:
    """Read until nobody wants it or the connection is lost; 1 if it is lost, with the reason on standard error."""
    # Ctrl-C in a terminal reaches every process there; the parent says when it is over.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    host, frequency = sys.argv[1], float(sys.argv[2])
    # What ur_rtde prints must not come between the rows.
    out = os.dup(1)
    os.dup2(2, 1)
    from rtde_receive import RTDEReceiveInterface

    try:
        robot = RTDEReceiveInterface(host, frequency, [*_BESIDE, *SIGNALS])
    except Exception as error:
        return _end(f"{type(error).__name__}: {error}")
    stamp_of = robot.getTimestamp
    getters = [(getattr(robot, getter), width) for getter, width in SIGNALS.values()]
    pack = struct.Struct(f"={WIDTH}d").pack
    wait, last, glanced = _SHORTEST, stamp_of(), time.monotonic()
    while True:
        stamp = stamp_of()
        if stamp != last:
            arrival = time.monotonic()
            row: list[float] = []
            for get, width in getters:
                value = get()
                row += value if width > 1 else (value,)
            if stamp_of() != stamp:
                # A package came in while this one was read: the row may be of both. It is the newer one's turn.
                continue
            if 0.0 < stamp - last < 0.1:
                wait = min(max((stamp - last) / _LOOKS, _SHORTEST), _LONGEST)
            last = stamp
            try:
                os.write(out, pack(arrival, stamp, *row))
            except BrokenPipeError:
                return 0
        else:
            time.sleep(wait)
        now = time.monotonic()
        if now - glanced > _GLANCE:
            glanced = now
            if select.select([0], [], [], 0.0)[0]:
                return 0
            if not robot.isConnected():
                return _end("no package for two seconds, or the connection was closed")


def _end(why: str) -> int:
    print(" ".join(why.split()), file=sys.stderr, flush=True)
    return 1


if __name__ == "__main__":
    # Its threads may hang in the connection.
    os._exit(main())
