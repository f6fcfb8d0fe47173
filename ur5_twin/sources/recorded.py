"""A recording as a source: its robot table, row by row."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import repeat

import numpy as np

from ur5_twin.control.held import commanded, given_up
from ur5_twin.errors import ReplayError
from ur5_twin.recording.table import Recording
from ur5_twin.twin.lockstep import LONGEST_GAP
from ur5_twin.twin.sample import Sample

_TARGETS = ("target_q", "target_qd", "target_qdd")
_STATE = ("actual_q", "actual_qd")


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
            # The twin starts again after a silence or a path given up, from what is published then.
            begins = np.diff(robot.time, prepend=robot.time[0]) > LONGEST_GAP
            begins[1:] |= given_up(targets[:-1, 0], targets[1:, 0], self._q[:-1])
            self._targets = commanded(targets, begins) if held else targets
        self._wrench = repeat(None) if wrench is None else wrench
        self._current = robot["actual_current"] if "actual_current" in robot else repeat(None)

    def __len__(self) -> int:
        return len(self._time)

    def __iter__(self) -> Iterator[Sample]:
        yield from map(Sample, self._time, self._q, self._qd, self._targets, self._wrench, self._current)
