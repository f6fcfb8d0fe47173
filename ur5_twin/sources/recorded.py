"""A recording as a source: its robot table, row by row."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import repeat

import numpy as np

from ur5_twin.errors import ReplayError
from ur5_twin.recording.table import Recording
from ur5_twin.twin.sample import Sample

_TARGETS = ("target_q", "target_qd", "target_qdd")
_STATE = ("actual_q", "actual_qd")
#: Deceleration that ends a move and is no rounding, rad/s^2.
_BRAKING = 1e-2


def commanded(target: np.ndarray) -> np.ndarray:
    """Targets (n, 3, 6) as the servo holds them, from the ones that are published.

    While the arm is idle the real controller publishes as target_q what it measured a tick earlier, and so a push at
    standstill shows in target_q too; the servo goes on holding the end of the last move, to which the arm returns.
    Rows without target velocity and acceleration therefore hold the end of the last move, or the first row. Where rows
    are missing the last row of a move is not its end; it is where that row's deceleration brings the joint to rest,
    q + qd |qd| / (2 |qdd|).
    """
    q, qd, qdd = target[:, 0], target[:, 1], target[:, 2]
    idle = np.asarray(~target[:, 1:].any(axis=(1, 2)))
    braking = (qd * qdd < 0.0) & (np.abs(qdd) > _BRAKING)
    end = q + np.divide(qd * np.abs(qd), 2.0 * np.abs(qdd), out=np.zeros_like(q), where=braking)
    last = np.maximum.accumulate(np.where(idle, -1, np.arange(len(target))))
    held = target.copy()
    held[:, 0] = np.where(idle[:, None], np.where(last[:, None] < 0, q[:1], end[np.maximum(last, 0)]), q)
    return held


class RecordedSource:
    """Samples of a recording, in order; their targets are None where the log lacks one of the three signals.

    Args:
        recording: what to go through.
        wrench: (n, 6) measured wrench for each row, see ``Sample``; none if not given.
        held: give the targets as the servo holds them (``commanded``), not as they are published.

    Attributes:
        missing_targets: those of target_q, target_qd and target_qdd that the log lacks.

    Raises:
        ReplayError: the robot table lacks actual_q or actual_qd, or holds fewer than two rows.
    """

    def __init__(self, recording: Recording, wrench: np.ndarray | None = None, *, held: bool = False) -> None:
        robot = recording.robot
        missing = [name for name in _STATE if name not in robot]
        if missing:
            raise ReplayError(
                f"{recording.source}: a replay needs {' and '.join(_STATE)}; no {', '.join(missing)} here"
            )
        if len(robot) < 2:
            raise ReplayError(f"{recording.source}: {len(robot)} rows, a replay needs at least two")
        self._time: list[float] = robot.time.tolist()
        self._q, self._qd = (np.ascontiguousarray(robot[name]) for name in _STATE)
        self.missing_targets = tuple(name for name in _TARGETS if name not in robot)
        self._targets = repeat(None)
        if not self.missing_targets:
            targets = np.stack([robot[name] for name in _TARGETS], axis=1)
            self._targets = commanded(targets) if held else targets
        self._wrench = repeat(None) if wrench is None else wrench
        self._current = robot["actual_current"] if "actual_current" in robot else repeat(None)

    def __len__(self) -> int:
        return len(self._time)

    def __iter__(self) -> Iterator[Sample]:
        yield from map(Sample, self._time, self._q, self._qd, self._targets, self._wrench, self._current)
