"""The program that ur_rtde uploads, run with built-ins that only write down what is called."""

from __future__ import annotations

import re
from collections import defaultdict
from typing import Any

import pytest

from ur5_twin.wire.urscript import Interpreter, Pose, library, parse


class Robot:
    """Registers and a list of calls."""

    def __init__(self, text: str) -> None:
        self.calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []
        self.inputs: dict[int, int] = defaultdict(int)
        self.floats: dict[int, float] = defaultdict(float)
        self.outputs: dict[int, int] = defaultdict(int)
        self.closed: list[str] = []
        names = re.findall(r"\b([a-z_][a-z_0-9]*)\s*\(", text)
        self.library = {name: self.note(name) for name in names} | library()
        self.library |= {
            "read_input_integer_register": lambda address: self.inputs[address],
            "read_input_float_register": lambda address: self.floats[address],
            "write_output_integer_register": self.outputs.__setitem__,
            "textmsg": lambda s1, s2="": None,
            "get_steptime": lambda: 0.002,
            "sync": self.sync,
            "movej": self.motion("movej", 5),
            "servoj": self.motion("servoj", 1),
            "speedj": self.motion("speedj", 1),
        }
        self.interpreter = Interpreter(parse(text), self.library)

    def note(self, name: str) -> Any:
        answer: Any = [0.0] * 6
        if "jacobian" in name or "matrix" in name:
            answer = [[0.0] * 6 for _ in range(6)]
        elif "pose" in name or "offset" in name:
            answer = Pose([0.0] * 6)
        elif name in ("get_target_payload", "tool_contact"):
            answer = 1.5
        elif not name.startswith("get_"):
            answer = True

        def built_in(*given: Any, **named: Any) -> Any:
            self.calls.append((name, given, named))
            return answer

        return built_in

    def motion(self, name: str, ticks: int) -> Any:
        def built_in(*given: Any, **named: Any) -> Any:
            self.calls.append((name, given, named))
            try:
                for _ in range(ticks):
                    yield
            finally:
                self.closed.append(name)

        return built_in

    def sync(self) -> Any:
        yield

    def count(self, name: str) -> int:
        return sum(called == name for called, *_ in self.calls)

    def step(self, ticks: int = 1) -> None:
        for _ in range(ticks):
            self.interpreter.step()
            assert self.interpreter.error is None

    def command(self, number: int) -> None:
        """Ask as the client does: command register, wait for done, clear, wait for ready."""
        self.inputs[0] = number
        for _ in range(100):
            self.step()
            if self.outputs[0] == 2:
                break
        assert self.outputs[0] == 2
        self.inputs[0] = 0
        self.step(3)
        assert self.outputs[0] == 1


@pytest.fixture
def robot(client_program: str) -> Robot:
    robot = Robot(client_program)
    robot.step(3)
    return robot


def test_it_says_that_it_is_ready_and_waits(robot: Robot) -> None:
    robot.step(100)
    assert robot.outputs[0] == 1
    assert robot.interpreter.running


def test_movej_goes_through_with_its_target(robot: Robot) -> None:
    target = [0.1, -1.2, 1.3, -1.4, -1.5, 0.6]
    robot.floats |= dict(enumerate([*target, 1.05, 1.4]))
    robot.command(1)
    _, given, named = next(call for call in robot.calls if call[0] == "movej")
    assert [*given, *named.values()][0] == target
    assert robot.closed == ["movej"]


def test_servoing_runs_in_a_thread_until_it_is_stopped(robot: Robot) -> None:
    robot.floats |= dict(enumerate([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))
    robot.inputs[0] = 11  # such commands come in every tick and have no handshake
    robot.step(50)
    assert 45 <= robot.count("servoj") <= 50, "one servoj in a tick"
    assert robot.outputs[0] == 1
    robot.inputs[0] = 0
    robot.step(3)
    robot.command(16)
    count = robot.count("servoj")
    robot.step(20)
    assert robot.count("servoj") == count
    assert robot.closed.count("servoj") == count, "the one that was interrupted is closed too"


def test_every_command_of_the_client_is_understood(client_program: str) -> None:
    commands = sorted({int(number) for number in re.findall(r"\bcmd == (\d+):", client_program)} - {0, 255})
    assert len(commands) > 50
    robot = Robot(client_program)
    for command in commands:
        robot.inputs[0] = command
        robot.interpreter.step()
        robot.interpreter.step()
        assert robot.interpreter.error is None, f"command {command}: {robot.interpreter.error}"
        robot.inputs[0] = 0
        robot.step(6)  # it may take a motion to come back


def test_it_stops_when_told(robot: Robot) -> None:
    robot.inputs[0] = 255
    robot.step(5)
    assert not robot.interpreter.running
