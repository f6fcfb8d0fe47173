"""The last rows, in memory that does not grow."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ur5_twin.recording.table import Table


class Ring:
    """Rows of one device; a new one takes the oldest one's place.

    Args:
        columns: name -> width.
        rows: how many are kept.
    """

    def __init__(self, columns: Mapping[str, int], rows: int) -> None:
        self._time = np.empty(rows)
        self._columns = {name: np.empty((rows, width)) for name, width in columns.items()}
        #: Rows taken so far, those that are gone included.
        self.count = 0

    def append(self, time: float, columns: Mapping[str, np.ndarray]) -> None:
        """Take a row."""
        k = self.count % len(self._time)
        self._time[k] = time
        for name, values in self._columns.items():
            values[k] = columns[name]
        self.count += 1

    def last(self, rows: int, device: str = "robot") -> Table:
        """The last rows, the oldest first; as many as there are."""
        size = len(self._time)
        n = min(rows, self.count, size)
        at = np.arange(self.count - n, self.count) % size
        return Table(device, self._time[at], {name: values[at] for name, values in self._columns.items()})
