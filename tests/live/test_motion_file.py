"""Motion files on a robot: what is sent when, and what makes it stop."""

from __future__ import annotations

import re
import socket
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import ArmModel, load_model
from ur5_twin.control.commands import Pose
from ur5_twin.errors import TwinError, WireError
from ur5_twin.live.motion_file import MotionFile, Run, ScriptLine, Step, read_motion_file

START = np.array([1.266, -2.135, -1.947, -0.377, -2.542, -0.5])


@pytest.fixture(scope="module")
def arm() -> ArmModel:
    return load_model("controller")


def file_of(tmp_path: Path, text: str) -> Path:
    (tmp_path / "file.txt").write_text(text)
    return tmp_path / "file.txt"


def movej(q: np.ndarray, more: str = "") -> str:
    return f"movej([{', '.join(map(str, q.tolist()))}]{more})\n"


def test_a_waypoint_file(arm: ArmModel, tmp_path: Path) -> None:
    path = file_of(
        tmp_path, "joint_space 2.5\n" + movej(START) + movej(START + 0.1, ", a=1.0, v=0.5, r=0.05") + movej(START)
    )
    motion = read_motion_file(path, arm, START)
    np.testing.assert_array_equal(motion.start, START)
    assert [step.script for step in motion.steps] == [movej(START), movej(START + 0.1, ", a=1.0, v=0.5"), movej(START)]
    assert motion.interval == 2.5
    assert motion.steps[0].duration == 0.0
    assert motion.duration == pytest.approx(5.0 + motion.steps[2].duration)


def test_a_servoj_file(arm: ArmModel, tmp_path: Path) -> None:
    times = 0.008 * np.arange(50)
    lines = "\n".join(f"{t:.3f} " + " ".join(f"{x:.6f}" for x in START + 0.1 * t) for t in times)
    motion = read_motion_file(file_of(tmp_path, f"# t q\n{lines}\n"), arm, START)
    script = motion.steps[0].script.splitlines()
    assert (script[0], script[-2], script[-1]) == ("def ur5_twin_servoj():", "  stopj(2.0)", "end")
    assert script[1] == (
        "  servoj([1.266000, -2.135000, -1.947000, -0.377000, -2.542000, -0.500000], t=0.0080, "
        "lookahead_time=0.1, gain=300)"
    )
    assert len(script) == 53
    assert 0.392 < motion.duration < 2.0


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (movej(START) + movej(START + 10.0), r"file\.txt: movej\(\[11\.266"),
        ("0.0 1 2 3\n", "not a time and six joint positions"),
        ("fly([1, 2, 3, 4, 5, 6])\n", "unknown command 'fly'"),
        ("\n# nothing\n", "there is no move"),
    ],
)
def test_what_the_arm_cannot_do_is_found_before_it_moves(arm: ArmModel, tmp_path: Path, text: str, what: str) -> None:
    with pytest.raises(TwinError, match=what):
        read_motion_file(file_of(tmp_path, text), arm, START)
    with pytest.raises(TwinError, match="cannot read"):
        read_motion_file(tmp_path / "none", arm, START)


def test_how_far_the_arm_is_from_its_start(arm: ArmModel) -> None:
    motion = MotionFile("f", START, (Step("", "", 0.0),), 0.0)
    assert motion.away(START + 0.015, arm) is None
    assert motion.away(START + np.array([0, 0, 0.1, 0, 0, -0.03]), arm) == "off by elbow 5.7 deg, wrist 3 1.7 deg"
    pose = MotionFile("f", Pose(tuple(kinematics.tcp_pose(arm, START))), (Step("", "", 0.0),), 0.0)
    assert pose.away(START + 1e-3, arm) is None
    assert "mm" in str(pose.away(START + 0.02, arm))


class Sent(list):
    """A line that keeps what is sent."""

    closed = False

    def send(self, script: str) -> None:
        if self.closed:
            raise WireError("gone")
        self.append(script)

    def drain(self) -> None:
        pass

    def close(self) -> None:
        self.closed = True


def row(speed: float = 0.0, safety: float = 1.0) -> dict[str, np.ndarray]:
    return {"actual_qd": np.full(6, speed), "target_qd": np.full(6, speed), "safety_mode": np.array([safety])}


def moves(n: int, interval: float = 3.0) -> MotionFile:
    return MotionFile("f", START, tuple(Step(f"move {k}\n", f"move {k}", 1.0) for k in range(n)), interval)


def play(run: Run, speeds: list[tuple[float, float]]) -> list[tuple[float, str]]:
    """Step through (until s, speed rad/s) 20 ms at a time; what it said, and when."""
    said, k = [], 0
    for until, speed in speeds:
        while 0.02 * k < until:
            what = run.step(0.02 * k, row(speed))
            if what:
                said.append((round(0.02 * k, 2), what))
            k += 1
    return said


def test_each_move_is_sent_when_the_arm_stands_and_its_time_has_come() -> None:
    line = Sent()
    run = Run(moves(3), line)  # type: ignore[arg-type]
    # The first takes longer than the interval, the second does not.
    said = play(run, [(1.2, 0.0), (4.6, 0.3), (5.2, 0.0), (6.0, 0.3), (8.0, 0.0), (9.0, 0.3), (12.0, 0.0)])
    assert list(line) == ["move 0\n", "move 1\n", "move 2\n"]
    assert [what for _, what in said] == ["sent move 0", "sent move 1", "sent move 2", "f: done"]
    assert [when for when, _ in said] == pytest.approx([1.0, 4.8, 7.8, 10.0], abs=0.05)
    assert run.finished
    run.close()
    assert line[-1] == "move 2\n"
    assert run.failure is None


def test_stopped_in_the_middle_it_stops_the_arm() -> None:
    line = Sent()
    run = Run(moves(3), line)  # type: ignore[arg-type]
    play(run, [(1.2, 0.0), (1.6, 0.3)])
    run.close()
    assert list(line) == ["move 0\n", "stopj(2.0)\n"]
    assert line.closed
    untouched = Sent()
    Run(moves(3), untouched).close()  # type: ignore[arg-type]
    assert list(untouched) == []


@pytest.mark.parametrize(
    ("speeds", "why"),
    [
        ([(7.0, 0.0)], r"stopped before 2 of 3 moves: the arm did not begin to move; is it in remote control"),
        ([(1.2, 0.0), (20.0, 0.3)], r"the arm still moves though it was to take 1\.0 s"),
    ],
)
def test_a_robot_that_does_otherwise_gets_nothing_further(speeds: list[tuple[float, float]], why: str) -> None:
    line = Sent()
    run = Run(moves(3), line)  # type: ignore[arg-type]
    play(run, speeds)
    assert re.search(why, str(run.failure))
    assert list(line) == ["move 0\n", "stopj(2.0)\n"]
    assert run.finished


def test_a_protective_stop_ends_it() -> None:
    line = Sent()
    run = Run(moves(2), line)  # type: ignore[arg-type]
    run.step(0.0, row())
    run.step(1.5, row())
    assert run.step(1.6, row(0.1, safety=3.0)) == "f: stopped before 1 of 2 moves: the robot's safety mode is 3"
    assert run.step(1.7, None) is None


def test_the_line_takes_all_and_reads_what_comes() -> None:
    server = socket.create_server(("127.0.0.1", 0))
    line = ScriptLine("127.0.0.1", server.getsockname()[1])
    robot, _ = server.accept()
    robot.sendall(b"state" * 1000)
    line.drain()
    line.send("movej([0, 0, 0, 0, 0, 0])\n")
    robot.close()
    line.close()
    server.close()
    with pytest.raises(WireError, match="no URScript can be sent"):
        ScriptLine("127.0.0.1", server.getsockname()[1] if server.fileno() >= 0 else 1)
