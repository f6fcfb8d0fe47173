"""A waypoint or servoj file run on a robot: checked before, sent as URScript, and stopped when asked to.

URScript over a socket is what every controller takes, the thesis' of 2013 too, and what the lab's program did; RTDE's
control interface needs a controller of 3.3 on, ur_rtde, and a program of its own on the robot. Moves of a waypoint file
are sent one by one, as the lab sent them, each when the arm stands: whenever the sender ends, the arm does so after one
move. A servoj file is one program, since set points sent one by one would come as unevenly as a network carries them.
"""

from __future__ import annotations

import contextlib
import math
import socket
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ur5_twin import spatial
from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.control.commands import Move, Pose, Program, ServoJ
from ur5_twin.control.program import plan
from ur5_twin.control.waypoints import SPACES, format_move, read_waypoints
from ur5_twin.errors import ScenarioError, TwinError, WireError
from ur5_twin.scenario.program import read_stream

#: TCP port of the secondary interface, where a controller takes URScript.
SCRIPT_PORT = 30002
#: How near to the file's start the arm must be: any joint, rad; its flange, m, and as much rad.
TOLERANCE, TOLERANCE_M = 0.02, 0.005
#: An arm whose joints turn slower than this stands, rad/s; for so long before the next move is sent, s.
STANDING, _STANDS = 5e-3, 0.2
#: A move that has not begun so long after it was sent never will, s.
_BEGINS = 5.0
#: Longer than planned by this, in s and as a share, is too long.
_LATE, _LATE_SHARE = 10.0, 0.5
#: Rest that is recorded before the first move and after the last, s.
REST = 1.0
#: Safety modes in which a robot moves: normal and reduced.
_MAY_MOVE = (1, 2)
#: The deceleration with which all joints are stopped, rad/s^2.
_STOP = "stopj(2.0)\n"
_CONNECT = 3.0
#: Set points of a servoj file: more make a program that no controller takes.
_MOST_POINTS = 10_000


@dataclass(frozen=True)
class Step:
    """One script.

    Attributes:
        script: URScript, as it is sent.
        what: it, for notes.
        duration: how long the motion takes as planned, s.
    """

    script: str
    what: str
    duration: float


@dataclass(frozen=True)
class MotionFile:
    """A checked file.

    Attributes:
        name: of the file.
        start: (6,) where the arm has to be, rad; or the flange's pose.
        steps: what is sent, in order.
        interval: s from one move's sending to the next at least.
    """

    name: str
    start: np.ndarray | Pose
    steps: tuple[Step, ...]
    interval: float

    @property
    def duration(self) -> float:
        """How long it takes as planned, s."""
        between = [max(self.interval, step.duration) for step in self.steps[:-1]]
        return sum(between) + self.steps[-1].duration

    def away(self, q: np.ndarray, arm: ArmModel) -> str | None:
        """How far from the start an arm at q (6,) rad is, if it is too far."""
        if isinstance(self.start, Pose):
            X_BF, goal = kinematics.forward(arm, q), self.start.matrix()
            off = float(np.linalg.norm(X_BF[:3, 3] - goal[:3, 3]))
            turned = float(np.linalg.norm(spatial.vector_from_rotation(X_BF[:3, :3].T @ goal[:3, :3])))
            if off > TOLERANCE_M or turned > TOLERANCE:
                return f"the flange is {1e3 * off:.1f} mm and {math.degrees(turned):.1f} deg off"
            return None
        off = np.abs(q - self.start)
        if off.max() <= TOLERANCE:
            return None
        names = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")
        worst = [f"{names[j]} {math.degrees(off[j]):.1f} deg" for j in np.flatnonzero(off > TOLERANCE)]
        return f"off by {', '.join(worst)}"

    def start_in_words(self) -> str:
        """The start as a teach pendant shows it."""
        if isinstance(self.start, Pose):
            x, y, z, *_ = self.start.vector
            return f"flange at [{1e3 * x:.1f}, {1e3 * y:.1f}, {1e3 * z:.1f}] mm"
        return "joints at [" + ", ".join(f"{math.degrees(value):.1f}" for value in self.start) + "] deg"


def read_motion_file(path: Path, arm: ArmModel, q: np.ndarray) -> MotionFile:
    """Read a file and plan it, so that what the arm cannot do is found before it moves.

    Args:
        path: a waypoint file (``control.waypoints``), or a servoj file: time and six joint positions a line.
        arm: the arm with its limits.
        q: (6,) where the arm is, rad, to plan a first move to a pose from.

    Raises:
        TwinError: the file cannot be read, or asks for what the arm cannot do.
    """
    if _is_stream(path):
        return _stream_file(path, arm)
    points = read_waypoints(path)
    commands = points.commands()
    first = commands[0].goal
    at = np.array(q if isinstance(first, Pose) else first)
    steps = []
    for move in commands:
        try:
            reference = plan(arm, at, Program((move,)))
        except TwinError as error:
            raise ScenarioError(f"{path.name}: {format_move(move)}: {error}") from None
        # A move of its own: what it blends with is not behind it.
        steps.append(Step(f"{format_move(_without_blend(move))}\n", format_move(move), float(reference.time[-1])))
        at = reference.rows[-1, 0]
    return MotionFile(path.name, first if isinstance(first, Pose) else np.array(first), tuple(steps), points.wait)


def _is_stream(path: Path) -> bool:
    """Whether the first line that says something begins with a number."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            for line in file:
                content = line.split("#", 1)[0].strip()
                if content:
                    return "(" not in content and content.split()[0] not in SPACES
    except OSError as error:
        raise ScenarioError(f"cannot read {path}: {error.strerror or error}") from None
    return False


def _stream_file(path: Path, arm: ArmModel) -> MotionFile:
    times, points = read_stream(path)
    if len(times) > _MOST_POINTS:
        raise ScenarioError(f"{path.name}: {len(times):,} set points; one program takes up to {_MOST_POINTS:,}")
    stream = ServoJ(times, points)
    try:
        reference = plan(arm, np.array(points[0]), Program((stream,)))
    except TwinError as error:
        raise ScenarioError(f"{path.name}: {error}") from None
    lines = ["def ur5_twin_servoj():"]
    spans = [*np.diff(times), 0.008]
    for span, point in zip(spans, points, strict=True):
        numbers = ", ".join(f"{value:.6f}" for value in point)
        # No place of the arm for the robot to be told of more exactly than it can be measured.
        lines.append(
            f"  servoj([{numbers}], t={span:.4f}, lookahead_time={stream.lookahead_time:g}, gain={stream.gain:g})"
        )
    lines += ["  stopj(2.0)", "end", ""]
    what = f"servoj along {len(points):,} set points"
    step = Step("\n".join(lines), what, float(reference.time[-1]))
    return MotionFile(path.name, np.array(points[0]), (step,), 0.0)


def _without_blend(move: Move) -> Move:
    return type(move)(move.goal, a=move.a, v=move.v, t=move.t) if move.r else move


class ScriptLine:
    """A connection over which a controller takes URScript; what it says is read and thrown away.

    Args:
        host, port: of the controller.

    Raises:
        WireError: nobody is there.
    """

    def __init__(self, host: str, port: int = SCRIPT_PORT) -> None:
        try:
            self._socket = socket.create_connection((host, port), timeout=_CONNECT)
        except OSError as error:
            raise WireError(f"{host}:{port}: no URScript can be sent ({error.strerror or error})") from None

    def send(self, script: str) -> None:
        """Send a script.

        Raises:
            WireError: the connection is lost.
        """
        try:
            self._socket.settimeout(_CONNECT)
            self._socket.sendall(script.encode("ascii"))
        except OSError as error:
            raise WireError(f"URScript could not be sent: {error.strerror or error}") from None

    def drain(self) -> None:
        """Read what has come: a controller that nobody reads from stops sending, some stop listening."""
        self._socket.setblocking(False)
        with contextlib.suppress(OSError):
            while self._socket.recv(1 << 16):
                pass

    def close(self) -> None:
        """Say that there is no more, and leave once the controller has taken all."""
        with contextlib.suppress(OSError):
            self.drain()
            self._socket.shutdown(socket.SHUT_WR)
            self._socket.settimeout(0.5)
            end = time.monotonic() + 1.0
            while time.monotonic() < end and self._socket.recv(1 << 16):
                pass
        self._socket.close()


class Run:
    """A motion file on its way, step by step (``test_stand.Task``).

    The first move is sent after a rest, each further one when the arm stands and the file's interval is over. A robot
    that may not move any more, does not begin, or takes far longer than planned, gets nothing further.

    Args:
        file: what to run.
        line: where to send it.
    """

    def __init__(self, file: MotionFile, line: ScriptLine) -> None:
        self._file, self._line = file, line
        self._next = 0
        self._begun: float | None = None
        self._sent = self._standing = -math.inf
        self._moved = True
        self._moving = False
        self._over = False
        self.failure: str | None = None

    @property
    def finished(self) -> bool:
        """Whether nothing more is to come, and the rest at its end is over."""
        return self._over

    def step(self, now: float, newest: Mapping[str, np.ndarray] | None) -> str | None:
        """Send what is due (``test_stand.Task``)."""
        self._line.drain()
        if self._over or newest is None:
            return None
        if self._begun is None:
            self._begun = now
        self._see(now, newest)
        mode = newest.get("safety_mode")
        if mode is not None and int(mode[0]) not in _MAY_MOVE:
            return self._fail(f"the robot's safety mode is {int(mode[0])}")
        rested = not self._moving and now - self._standing >= _STANDS
        if self._next == 0:
            return self._send(now) if now - self._begun >= REST else None
        step = self._file.steps[self._next - 1]
        # A move that asks for next to nothing, since the arm is where it goes, may not be seen.
        began = self._moved or step.duration < 2.0 * _STANDS
        if not began:
            if now - self._sent > _BEGINS:
                return self._fail(f"the arm did not begin to move; is it in remote control? ({step.what})")
            return None
        if now - self._sent > (1.0 + _LATE_SHARE) * step.duration + _LATE and self._moving:
            return self._fail(f"the arm still moves though it was to take {step.duration:.1f} s ({step.what})")
        if not rested or now - self._sent < max(step.duration, self._file.interval if self._left else 0.0):
            return None
        if self._left:
            return self._send(now)
        if now - self._standing >= REST:
            self._over = True
            return f"{self._file.name}: done"
        return None

    def close(self) -> None:
        """Stop the arm if it may still move, and disconnect."""
        if self._next and not self._over:
            with contextlib.suppress(WireError):
                self._line.send(_STOP)
        self._over = True
        self._line.close()

    @property
    def _left(self) -> int:
        return len(self._file.steps) - self._next

    def _see(self, now: float, newest: Mapping[str, np.ndarray]) -> None:
        speeds = [newest[name] for name in ("actual_qd", "target_qd") if name in newest]
        self._moving = any(bool((np.abs(speed) > STANDING).any()) for speed in speeds)
        if self._moving:
            self._moved = True
            self._standing = math.inf
        elif math.isinf(self._standing):
            self._standing = now

    def _send(self, now: float) -> str:
        step = self._file.steps[self._next]
        try:
            self._line.send(step.script)
        except WireError as error:
            return self._fail(str(error))
        self._next += 1
        self._sent, self._moved = now, False
        self._standing = now
        return f"sent {step.what}"

    def _fail(self, why: str) -> str:
        self.failure = f"{self._file.name}: stopped before {self._left} of {len(self._file.steps)} moves: {why}"
        with contextlib.suppress(WireError):
            self._line.send(_STOP)
        self._over = True
        return self.failure


def describe_steps(steps: Sequence[Step]) -> str:
    """What is going to be sent, for a person who is to say yes."""
    shown = [step.what for step in steps[:3]]
    more = f" and {len(steps) - 3} more" if len(steps) > 3 else ""
    return "; ".join(shown) + more
