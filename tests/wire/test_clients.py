"""Clients that people use, unmodified, against the served cell.

ur_rtde holds Python's lock while it connects: it runs in a process of its own, the controller in this one. It knows no
ports but a robot's, so each test process binds to a loopback address of its own: several may run at a time.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ur5_twin.recording import read
from ur5_twin.scenario import load_scenario
from ur5_twin.wire.controller import VirtualController
from ur5_twin.wire.server import Server
from ur5_twin.wire.state import State
from ur5_twin.wire.version import version

pytest.importorskip("rtde_receive")

_PID = os.getpid()
HOST = f"127.{64 + (_PID >> 16 & 63)}.{_PID >> 8 & 255}.{max(_PID & 255, 1)}"

Client = Callable[..., Any]


@pytest.fixture
def client(tmp_path: Path) -> Client:
    """Run a client's code; what it puts into ``found`` comes back."""

    def run(code: str) -> Any:
        text = f"import json, time\nHOST = {HOST!r}\nfound = {{}}\n{code}\nprint('FOUND' + json.dumps(found))\n"
        done = subprocess.run(
            [sys.executable, "-c", text], capture_output=True, text=True, timeout=60, cwd=tmp_path, check=False
        )
        assert done.returncode == 0, done.stderr + done.stdout
        return json.loads(done.stdout.rpartition("FOUND")[2])

    return run


def made(series: str, scenario: str = "empty_cell", *, run: bool = False) -> VirtualController:
    return VirtualController(load_scenario(scenario), version(series), run=run)


class Kept:
    """A device that keeps all states, for comparison."""

    name = "kept"
    address = None
    connected = None

    def __init__(self) -> None:
        self.states: dict[float, State] = {}

    async def start(self) -> None:
        pass

    def publish(self, state: State) -> None:
        self.states[round(state.timestamp, 6)] = state

    async def close(self) -> None:
        pass


@pytest.mark.parametrize("series", ["3.4", "5.11", "5.25.1"])
def test_what_is_received_is_what_is_published(client: Client, series: str) -> None:
    kept = Kept()
    with Server(made(series, "free_motion", run=True), bind=HOST, devices=[kept]):
        found = client("""
import rtde_receive
robot = rtde_receive.RTDEReceiveInterface(HOST)
time.sleep(1.2)
rows = []
while len(rows) < 20:
    before, q, force, pose, mode, after = (robot.getTimestamp(), robot.getActualQ(), robot.getActualTCPForce(),
        robot.getActualTCPPose(), robot.getRobotMode(), robot.getTimestamp())
    # One package: the clock is the same before and after.
    if before == after:
        rows.append([before, q, force, pose, mode])
    time.sleep(0.01)
found["rows"] = rows
robot.disconnect()
""")
    assert len({row[0] for row in found["rows"]}) > 5
    for stamp, q, force, pose, mode in found["rows"]:
        signals = kept.states[round(stamp, 6)].signals
        np.testing.assert_array_equal(q, signals["actual_q"])
        np.testing.assert_array_equal(force, signals["actual_TCP_force"])
        np.testing.assert_array_equal(pose, signals["actual_TCP_pose"])
        assert mode == 7


def test_ur_rtdes_recording_is_read_back(client: Client, tmp_path: Path) -> None:
    kept = Kept()
    with Server(made("3.15.8", "free_motion", run=True), bind=HOST, devices=[kept]):
        client("""
import rtde_receive
robot = rtde_receive.RTDEReceiveInterface(HOST)
robot.startFileRecording("log.csv")
time.sleep(2.0)
robot.stopFileRecording()
robot.disconnect()
""")
    # ur_rtde records by a clock of its own: rows twice or not at all.
    robot = read(tmp_path / "log.csv", repair=True).robot
    assert len(robot) > 100
    for k in range(0, len(robot), 10):
        signals = kept.states[round(robot.time[k], 6)].signals
        np.testing.assert_allclose(robot["actual_q"][k], signals["actual_q"], atol=1e-6)
        np.testing.assert_allclose(robot["target_moment"][k], signals["target_moment"], atol=1e-6)


def test_a_name_that_nobody_knows_is_told(client: Client) -> None:
    with Server(made("5.25.1"), bind=HOST):
        found = client("""
import rtde_receive
try:
    rtde_receive.RTDEReceiveInterface(HOST, 125.0, ["timestamp", "actual_qqq"])
except RuntimeError as error:
    found["error"] = str(error)
""")
    assert "[actual_qqq]" in found["error"]


def test_the_dashboard_client(client: Client) -> None:
    with Server(made("5.25.1"), bind=HOST):
        found = client("""
import dashboard_client
board = dashboard_client.DashboardClient(HOST)
board.connect()
found["remote"] = board.isInRemoteControl()
found["version"] = board.polyscopeVersion()
found["serial"] = board.getSerialNumber()
found["model"] = board.getRobotModel()
found["modes"] = [board.robotmode(), board.safetymode(), board.safetystatus(), board.programState()]
board.powerOff(); found["off"] = board.robotmode()
board.powerOn(); found["on"] = board.robotmode()
board.brakeRelease(); found["released"] = board.robotmode()
board.popup("mind the arm"); board.closePopup(); board.closeSafetyPopup()
board.play(); found["running"] = board.running()
board.stop()
board.quit()
""")
    assert found["remote"] is True
    assert "5.25.1" in found["version"]
    assert found["serial"].isdigit()
    assert found["model"] == "UR5"
    assert found["modes"] == [
        "Robotmode: RUNNING",
        "Safetymode: NORMAL",
        "Safetystatus: NORMAL",
        "STOPPED empty_cell.urp",
    ]
    assert (found["off"], found["on"], found["released"]) == (
        "Robotmode: POWER_OFF",
        "Robotmode: IDLE",
        "Robotmode: RUNNING",
    )


def test_the_io_interface(client: Client) -> None:
    with Server(made("5.25.1"), bind=HOST):
        found = client("""
import rtde_io, rtde_receive
io = rtde_io.RTDEIOInterface(HOST)
robot = rtde_receive.RTDEReceiveInterface(HOST)
io.setStandardDigitalOut(3, True)
io.setStandardDigitalOut(5, True)
io.setToolDigitalOut(1, True)
io.setSpeedSlider(0.25)
time.sleep(0.3)
found["bits"] = robot.getActualDigitalOutputBits()
io.setStandardDigitalOut(3, False)
time.sleep(0.3)
found["later"] = robot.getActualDigitalOutputBits()
found["slider"] = robot.getTargetSpeedFraction()
io.disconnect(); robot.disconnect()
""")
    assert found["bits"] == 1 << 3 | 1 << 5 | 1 << 17
    assert found["later"] == 1 << 5 | 1 << 17
    assert found["slider"] == pytest.approx(0.25)


TALKATIVE = """
sec talkative():
  k = 0
  while True:
    textmsg("k ", k)
    popup("mind the arm")
    k = k + 1
    sync()
  end
end
"""


@pytest.mark.parametrize("series", ["3.15.8", "5.25.1"])
def test_programs_that_talk_disturb_nobody(client: Client, series: str) -> None:
    controller = made(series)
    with Server(controller, bind=HOST):
        controller.post(lambda: controller.run_script(TALKATIVE))
        found = client("""
import rtde_control, rtde_io, rtde_receive
robot = rtde_receive.RTDEReceiveInterface(HOST)
io = rtde_io.RTDEIOInterface(HOST)
control = rtde_control.RTDEControlInterface(HOST)
goal = [0.0, -1.57, -1.4, -1.57, 1.57, 0.1]
found["movej"] = [control.moveJ(goal, 3.0, 6.0), robot.getActualQ(), goal]
io.setStandardDigitalOut(3, True)
for _ in range(400):
    if robot.getActualDigitalOutputBits() == 1 << 3:
        break
    time.sleep(0.005)
found["bits"] = robot.getActualDigitalOutputBits()
found["connected"] = [robot.isConnected(), control.isConnected()]
control.stopScript()
control.disconnect(); io.disconnect(); robot.disconnect()
""")
    assert controller.messages[-1].number > 100
    done, there, asked = found["movej"]
    assert done is True
    np.testing.assert_allclose(there, asked, atol=2e-3)
    assert found["bits"] == 1 << 3
    assert found["connected"] == [True, True]


CONTROL = """
import math, rtde_control, rtde_receive
def until(condition):
    for _ in range(1000):
        if condition():
            return
        time.sleep(0.005)
robot = rtde_receive.RTDEReceiveInterface(HOST)
control = rtde_control.RTDEControlInterface(HOST)
found["running"] = control.isProgramRunning()
goal = [0.0, -1.57, -1.4, -1.57, 1.57, 0.1]
found["movej"] = [control.moveJ(goal, 3.0, 6.0), robot.getActualQ(), goal]
pose = robot.getActualTCPPose(); pose[2] += 0.03
found["movel"] = [control.moveL(pose, 0.5, 2.0), robot.getActualTCPPose(), pose]
here = robot.getActualQ()
found["fk"] = [control.getForwardKinematics(), robot.getActualTCPPose()]
found["ik"] = [control.getInverseKinematics(robot.getActualTCPPose(), here), here]
try:
    second = rtde_control.RTDEControlInterface(HOST)
except RuntimeError as error:
    found["second"] = str(error)
follow = list(here)
for k in range(50):
    began = control.initPeriod()
    follow[5] = here[5] + 0.05 * (1 - math.cos(math.pi * k / 50))
    control.servoJ(follow, 0, 0, 0.008, 0.05, 500)
    control.waitPeriod(began)
for k in range(1000):
    began = control.initPeriod()
    control.servoJ(follow, 0, 0, 0.008, 0.05, 500)
    control.waitPeriod(began)
    if abs(robot.getActualQ()[5] - follow[5]) < 1e-3:
        break
found["servoj"] = [robot.getActualQ(), follow]
control.servoStop()
control.speedJ([0, 0, 0, 0, 0, 0.5], 4.0, 2.0)
until(lambda: robot.getTargetQd()[5] > 0.4999)
found["speedj"] = robot.getTargetQd()
control.speedStop(10.0)
control.moveJ(goal, 0.3, 0.5, True)
until(lambda: max(abs(v) for v in robot.getTargetQd()) > 0.02)
found["moving"] = max(abs(v) for v in robot.getTargetQd())
control.stopJ(5.0)
until(lambda: max(abs(v) for v in robot.getTargetQd()) == 0)
found["stopped"] = max(abs(v) for v in robot.getTargetQd())
control.stopScript()
until(lambda: not control.isProgramRunning())
found["after stopScript"] = control.isProgramRunning()
control.reuploadScript()
until(control.isProgramRunning)
found["reuploaded"] = [control.isProgramRunning(), control.moveJ(goal, 3.0, 6.0), robot.getActualQ(), goal]
control.disconnect()
found["reconnected"] = [control.reconnect(), control.isProgramRunning(), control.moveJ(here, 3.0, 6.0)]
control.stopScript()
control.disconnect(); robot.disconnect()
"""


@pytest.mark.parametrize("series", ["3.15.8", "5.25.1"])
def test_the_control_interface(client: Client, series: str) -> None:
    controller = made(series)
    with Server(controller, bind=HOST):
        found = client(CONTROL)
    errors = [message.text for message in controller.messages if message.kind == "error"]
    assert not errors
    assert found["running"] is True
    # An arm with friction in its gears comes to rest within a milliradian or so.
    for name, within in (("movej", 2e-3), ("movel", 1e-3)):
        done, there, asked = found[name]
        assert done is True
        np.testing.assert_allclose(there, asked, atol=within, err_msg=name)
    np.testing.assert_allclose(*found["fk"], atol=1e-3)
    np.testing.assert_allclose(*found["ik"], atol=2e-3)
    # Its inputs are the first client's.
    assert "second" in found
    np.testing.assert_allclose(*found["servoj"], atol=5e-3)
    np.testing.assert_allclose(found["speedj"], [0, 0, 0, 0, 0, 0.5], atol=1e-6)
    assert found["moving"] > 0.01
    assert found["stopped"] == 0
    assert found["after stopScript"] is False
    running, moved, there, asked = found["reuploaded"]
    assert running
    assert moved
    np.testing.assert_allclose(there, asked, atol=2e-3)
    assert found["reconnected"] == [True, True, True]
