"""The last minutes of a stream, in memory that does not grow."""

from __future__ import annotations

import numpy as np

from ur5_twin.errors import RecordingError
from ur5_twin.recording.table import Table


class Ring:
    """Keeps the newest rows of one table; its columns are those of the first rows.

    Args:
        rows: how many.
    """

    def __init__(self, rows: int) -> None:
        if rows < 1:
            raise RecordingError(f"a ring of {rows} rows keeps nothing; give at least 1")
        self._size = rows
        self._time = np.empty(rows)
        self._columns: dict[str, np.ndarray] = {}
        self._next = 0
        self._count = 0
        self._device = "robot"

    def __len__(self) -> int:
        return self._count

    def append(self, table: Table) -> None:
        """Add rows; the oldest make room."""
        if not self._columns:
            self._device = table.device
            self._columns = {name: np.empty((self._size, v.shape[1])) for name, v in table.columns.items()}
        n = min(len(table), self._size)
        places = (self._next + np.arange(n)) % self._size
        self._time[places] = table.time[len(table) - n :]
        for name, kept in self._columns.items():
            kept[places] = table[name][len(table) - n :]
        self._next = (self._next + n) % self._size
        self._count = min(self._count + n, self._size)

    def last(self, seconds: float | None = None) -> Table:
        """A copy of the rows of the last seconds, oldest first; None for all that is kept."""
        places = (self._next - self._count + np.arange(self._count)) % self._size
        time = self._time[places]
        if seconds is not None and len(time):
            first = int(np.searchsorted(time, time[-1] - seconds))
            places, time = places[first:], time[first:]
        return Table(self._device, time, {name: values[places] for name, values in self._columns.items()})
