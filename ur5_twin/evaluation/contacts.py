"""Who touched the arm where: the table ``contact`` of a run, brought to the rows of the robot's table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ur5_twin.recording.table import Recording

#: The controller's period, s.
TICK = 0.008
#: What ``contact_obstacle`` says of a push, and of one link on another.
PUSH, ITSELF = -1, -2
#: What ``contact_link`` counts from 1, in words.
LINKS = ("shoulder", "upper arm", "forearm", "wrist 1", "wrist 2", "wrist 3", "tool")
#: Contacts of a surface that chatters are one if they are no further apart, s.
_APART = 0.1


@dataclass(frozen=True)
class Touch:
    """One link's contact with one obstacle, or all pushes on one link.

    Attributes:
        link: 1 to 6, or 7 for the tool.
        obstacle: its index in the scenario, ``PUSH`` or ``ITSELF``.
        rows: (m,) rows of the robot's table at which it acts, increasing.
        force: (m, 3) N on the arm in base axes, all points of contact together.
        point: (m, 3) m in base axes, the points' mean by the size of their forces.
    """

    link: int
    obstacle: int
    rows: np.ndarray
    force: np.ndarray
    point: np.ndarray

    @property
    def is_push(self) -> bool:
        return self.obstacle == PUSH

    @property
    def size(self) -> np.ndarray:
        """(m,) of the force, N."""
        return np.linalg.norm(self.force, axis=1)

    @property
    def duration(self) -> float:
        """How long it acts, s: a tick for each row."""
        return len(self.rows) * TICK

    @property
    def impulse(self) -> np.ndarray:
        """(3,) integral of the force over time, N s in base axes."""
        return self.force.sum(axis=0) * TICK

    def over(self, n: int) -> np.ndarray:
        """(n,) size of the force at each row of the robot's table, N; 0 where it does not act."""
        size = np.zeros(n)
        size[self.rows] = self.size
        return size

    def episodes(self) -> list[np.ndarray]:
        """Its rows, cut where it rests for more than 0.1 s."""
        gaps = np.flatnonzero(np.diff(self.rows) * TICK > _APART) + 1
        return np.split(self.rows, gaps)

    def name(self, obstacles: Sequence[str] = ()) -> str:
        """In words, as ``tool on plate`` or ``push on forearm``; an obstacle without a name is counted from 1."""
        link = LINKS[self.link - 1]
        return f"push on {link}" if self.is_push else f"{link} on {obstacle_name(self.obstacle, obstacles)}"


def obstacle_name(obstacle: int, obstacles: Sequence[str]) -> str:
    """What ``contact_obstacle`` stands for."""
    if obstacle in (PUSH, ITSELF):
        return "push" if obstacle == PUSH else "arm itself"
    return obstacles[obstacle] if obstacle < len(obstacles) else f"obstacle {obstacle + 1}"


def points(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Which rows of the table ``contact`` belong to the robot's rows, (m,), and to which of them, (m,), increasing.

    Both are empty if there is no such table. Rows further than half a tick from any row of the robot's are left out.
    """
    table, time = recording.tables.get("contact"), recording.robot.time
    if table is None or not len(table) or not len(time):
        return np.empty(0, dtype=int), np.empty(0, dtype=int)
    at = table.time  # the robot's clock: the twin writes both
    before = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 1)
    after = np.minimum(before + 1, len(time) - 1)
    near = np.where(np.abs(time[before] - at) <= np.abs(time[after] - at), before, after)
    known = np.flatnonzero(np.abs(time[near] - at) < TICK / 2)
    known = known[np.argsort(near[known], kind="stable")]
    return known, near[known]


def touches(recording: Recording) -> list[Touch]:
    """What the table ``contact`` of a run holds, by link and obstacle: contacts first, then pushes."""
    known, rows = points(recording)
    if not len(known):
        return []
    table = recording.tables["contact"]
    link, obstacle = (table[f"contact_{key}"][known, 0].astype(int) for key in ("link", "obstacle"))
    force, point = table["contact_force"][known], table["contact_point"][known]
    found = []
    for pair in sorted(set(zip(obstacle.tolist(), link.tolist(), strict=True)), key=lambda pair: (pair[0] < 0, pair)):
        mine = (obstacle == pair[0]) & (link == pair[1])
        at, first = np.unique(rows[mine], return_index=True)
        # A point without force counts a little, so that every tick has a point.
        weight = np.linalg.norm(force[mine], axis=1)[:, None] + 1e-9
        total = np.add.reduceat(force[mine], first)
        middle = np.add.reduceat(point[mine] * weight, first) / np.add.reduceat(weight, first)
        found.append(Touch(pair[1], pair[0], at, total, middle))
    return found


def acting(touched: Sequence[Touch], n: int) -> np.ndarray:
    """(n,) whether anything touches or pushes the arm at each row of the robot's table."""
    mask = np.zeros(n, dtype=bool)
    for touch in touched:
        mask[touch.rows] = True
    return mask
