"""Commands to the controller, with URScript's names and defaults, in SI units.

``a`` acceleration, ``v`` speed, ``t`` time (0: not given), ``r`` blend radius, as URScript's arguments. A UR without
tool offset has its tool centre point in the flange, so a pose is the flange's in the base.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import UnionType

import numpy as np

from ur5_twin import spatial
from ur5_twin.arm.parameters import N_JOINTS
from ur5_twin.control.trajectory import require_positive
from ur5_twin.errors import TwinError

#: What URScript's manual allows for servoj.
LOOKAHEAD_RANGE = (0.03, 0.2)
GAIN_RANGE = (100.0, 2000.0)


@dataclass(frozen=True)
class Pose:
    """URScript's p[x, y, z, rx, ry, rz]: position in m and rotation vector in rad of the flange in the base.

    Raises:
        TwinError: not six finite numbers.
    """

    vector: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "vector", _six(self.vector, "pose"))

    def matrix(self) -> np.ndarray:
        """X_BF (4, 4)."""
        return spatial.pose_from_vector(np.array(self.vector))


Goal = tuple[float, ...] | Pose


@dataclass(frozen=True)
class MoveJ:
    """Straight in joint space; ``docs/motion.md`` has the law.

    Attributes:
        goal: six joint positions in rad, or a Pose, reached in the joint position nearest to the current one.
        a: acceleration of the leading joint, rad/s^2.
        v: speed of the leading joint, rad/s.
        t: time of the move, s; if not 0 it rules and ``a`` and ``v`` do not count.
        r: blend radius, m; counts where another move follows at once.

    Raises:
        TwinError: not six finite numbers, ``a`` or ``v`` not positive, ``t`` or ``r`` negative.
    """

    goal: Goal
    a: float = 1.4
    v: float = 1.05
    t: float = 0.0
    r: float = 0.0

    name = "movej"

    def __post_init__(self) -> None:
        _check_move(self)


@dataclass(frozen=True)
class MoveL:
    """The flange straight in space; ``docs/motion.md`` has the law.

    Attributes:
        goal: a Pose, or six joint positions in rad whose flange pose is meant.
        a: acceleration along the line, m/s^2 (rad/s^2 where the rotation is the longer way).
        v: speed along the line, m/s (rad/s).
        t: time of the move, s; if not 0 it rules and ``a`` and ``v`` do not count.
        r: blend radius, m; counts where another move follows at once.

    Raises:
        TwinError: not six finite numbers, ``a`` or ``v`` not positive, ``t`` or ``r`` negative.
    """

    goal: Goal
    a: float = 1.2
    v: float = 0.25
    t: float = 0.0
    r: float = 0.0

    name = "movel"

    def __post_init__(self) -> None:
        _check_move(self)


@dataclass(frozen=True)
class MoveC:
    """The tool on a circle through a point to a pose; of programs on the controller, not of scenarios.

    Attributes:
        via: a Pose whose position the tool passes.
        goal: a Pose.
        a: acceleration along the circle, m/s^2 (rad/s^2 where turning to the goal is the longer way).
        v: speed along the circle, m/s (rad/s).
        r: blend radius, m.
        turns_with: the orientation keeps to the circle's tangent, instead of turning evenly to the goal's.

    Raises:
        TwinError: ``a`` or ``v`` not positive, ``r`` negative.
    """

    via: Pose
    goal: Pose
    a: float = 1.2
    v: float = 0.25
    r: float = 0.0
    turns_with: bool = False

    name = "movec"
    t = 0.0

    def __post_init__(self) -> None:
        require_positive(self.name, a=self.a, v=self.v)
        if not self.r >= 0.0:
            raise TwinError(f"{self.name}: r is {self.r:g} m, it must be 0 or more")


@dataclass(frozen=True)
class ServoJ:
    """A stream of set points, one servoj call each; ``docs/motion.md`` has the law.

    Attributes:
        times: when each set point reaches the controller, s from the stream's start, rising, the first at 0 or later.
        points: joint positions, rad, six for each time.
        lookahead_time: s, 0.03 to 0.2.
        gain: 1/s^2, 100 to 2000.

    Raises:
        TwinError: times and points do not fit, times do not rise, or a parameter is out of URScript's range.
    """

    times: tuple[float, ...]
    points: tuple[tuple[float, ...], ...]
    lookahead_time: float = 0.1
    gain: float = 300.0

    name = "servoj"

    def __post_init__(self) -> None:
        times = tuple(float(x) for x in self.times)
        points = tuple(_six(point, f"servoj: set point {k}") for k, point in enumerate(self.points))
        if not times or len(times) != len(points):
            raise TwinError(f"servoj: {len(times)} times and {len(points)} set points, expected as many, one at least")
        if not all(np.isfinite(times)) or times[0] < 0.0:
            raise TwinError("servoj: times must be finite and start at 0 or later")
        for k, (before, after) in enumerate(pairwise(times), start=1):
            if after <= before:
                raise TwinError(f"servoj: times must rise; set point {k} is at {after} s, after {before} s")
        for name, value, (low, high) in (
            ("lookahead_time", self.lookahead_time, LOOKAHEAD_RANGE),
            ("gain", self.gain, GAIN_RANGE),
        ):
            if not low <= value <= high:
                raise TwinError(f"servoj: {name} is {value}, URScript allows {low:g} to {high:g}")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "points", points)


@dataclass(frozen=True)
class Wait:
    """Stand still for ``seconds`` (URScript's sleep), rounded up to ticks.

    Raises:
        TwinError: negative or not finite.
    """

    seconds: float

    name = "wait"

    def __post_init__(self) -> None:
        if not 0.0 <= self.seconds < np.inf:
            raise TwinError(f"wait: seconds is {self.seconds}, it must not be negative")


Move = MoveJ | MoveL
Command = MoveJ | MoveL | ServoJ | Wait


@dataclass(frozen=True)
class Program:
    """Commands of one program: each starts when the former one ended.

    Raises:
        TwinError: there is none, or one is no command.
    """

    commands: tuple[Command, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "commands", _commands(self.commands, Command))


@dataclass(frozen=True)
class Sent:
    """Moves sent one by one from a PC over a socket, whether the arm is ready or not (thesis section 4.4.1).

    Attributes:
        commands: the moves.
        times: when each arrives, s from the start, not falling.

    Raises:
        TwinError: there is none, one is no MoveJ, MoveL or ServoJ, or the times do not fit.
    """

    commands: tuple[MoveJ | MoveL | ServoJ, ...]
    times: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "commands", _commands(self.commands, MoveJ | MoveL | ServoJ))
        times = tuple(float(x) for x in self.times)
        if len(times) != len(self.commands):
            raise TwinError(f"sent: {len(times)} times for {len(self.commands)} commands")
        if not all(np.isfinite(times)) or times[0] < 0.0 or any(b < a for a, b in pairwise(times)):
            raise TwinError("sent: times must be finite, not negative and not fall")
        object.__setattr__(self, "times", times)

    @classmethod
    def every(cls, commands: Iterable[MoveJ | MoveL | ServoJ], wait: float = 3.0) -> Sent:
        """One command each ``wait`` seconds, the first at 0, as the lab's program sends them (default 3 s).

        Raises:
            TwinError: ``wait`` is not positive.
        """
        require_positive("sent", wait=wait)
        commands = tuple(commands)
        return cls(commands, tuple(k * wait for k in range(len(commands))))


def _six(values: Sequence[float] | np.ndarray, what: str) -> tuple[float, ...]:
    try:
        six = tuple(float(x) for x in values)
    except (TypeError, ValueError):
        raise TwinError(f"{what}: {values!r} is not a list of {N_JOINTS} numbers") from None
    if len(six) != N_JOINTS:
        raise TwinError(f"{what}: {len(six)} numbers, expected {N_JOINTS}")
    if not all(np.isfinite(six)):
        raise TwinError(f"{what}: {list(six)} has a number that is not finite")
    return six


def _check_move(move: Move) -> None:
    if not isinstance(move.goal, Pose):
        object.__setattr__(move, "goal", _six(move.goal, f"{move.name}: goal"))
    require_positive(move.name, a=move.a, v=move.v)
    for name, value in (("t", move.t), ("r", move.r)):
        if not 0.0 <= value < np.inf:
            raise TwinError(f"{move.name}: {name} is {value}, it must not be negative")


def _commands(commands: Iterable[Command], kind: UnionType) -> tuple:
    commands = tuple(commands)
    if not commands:
        raise TwinError("a program needs one command at least")
    for k, command in enumerate(commands):
        if not isinstance(command, kind):
            names = ", ".join(one.__name__ for one in kind.__args__)
            raise TwinError(f"command {k} is a {type(command).__name__}, expected one of {names}")
    return commands
