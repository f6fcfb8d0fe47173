"""What the arm is told to do, one class a command, in SI units. Poses are of the flange, not of a tool's tip."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class MoveJ:
    """To joint positions, all joints together, the slowest at ``speed``.

    Attributes:
        q: (6,) rad.
        speed: rad/s.
        acceleration: rad/s^2.
        blend: radius about the target in which the next motion may begin, m.
    """

    q: np.ndarray
    speed: float
    acceleration: float
    blend: float


@dataclass(frozen=True)
class MoveL:
    """In a straight line to a pose of the flange.

    Attributes:
        X_BF: (4, 4) pose of the flange in the base.
        speed: of the flange's origin, m/s.
        acceleration: m/s^2.
        blend: radius about the target in which the next motion may begin, m.
    """

    X_BF: np.ndarray
    speed: float
    acceleration: float
    blend: float


@dataclass(frozen=True)
class Wait:
    """Stand still for ``duration`` s."""

    duration: float


@dataclass(frozen=True)
class ServoJ:
    """Follow a stream of joint positions from a file, as ``servoj`` does.

    Attributes:
        path: the file, a table of time in s and six joint positions in rad.
        lookahead: s.
        gain: UR's proportional gain, without unit.
    """

    path: Path
    lookahead: float
    gain: float


@dataclass(frozen=True)
class Waypoints:
    """Send the moves of a waypoint file one by one (``control.waypoints``).

    Attributes:
        path: the file.
        space: how its moves are planned; None for what the file says.
        wait: between two moves, s; None for what the file says.
    """

    path: Path
    space: Literal["joint_space", "task_space"] | None
    wait: float | None


Motion = MoveJ | MoveL | Wait | ServoJ | Waypoints
