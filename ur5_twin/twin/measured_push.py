"""A wrench that a force sensor measured, on the simulated arm again."""

from __future__ import annotations

import numpy as np

_FLANGE = np.zeros(3)


class MeasuredPush:
    """A wrench at the flange as it was measured, linear in between, none where it is not known.

    Args:
        time: (n,) s.
        wrench: (n, 6) on the arm in base axes, N and Nm.
        body, point: where it acts (``cell.Push``), by default at the flange.
    """

    turning = False

    def __init__(self, time: np.ndarray, wrench: np.ndarray, body: str = "tool", point: np.ndarray = _FLANGE) -> None:
        self._time, self._wrench = time, np.nan_to_num(wrench)
        self.body, self.point = body, point

    def acts_within(self, start: float, end: float) -> bool:
        return bool(self._time[0] < end and self._time[-1] > start)

    def wrench(self, time: np.ndarray) -> np.ndarray:
        columns = [np.interp(time, self._time, column, left=0.0, right=0.0) for column in self._wrench.T]
        return np.stack(columns, axis=-1)
