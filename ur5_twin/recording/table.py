"""A Recording: what devices reported, one table per device, each on the clock of that device."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ur5_twin.errors import RecordingError

#: Width of every column this package knows, by RTDE's name where RTDE has one. Units: rad, rad/s, rad/s^2, A, Nm;
#: a wrench is [N, N, N, Nm, Nm, Nm]; a pose [m, m, m] and a rotation vector [rad].
COLUMN_WIDTHS: Mapping[str, int] = {
    "target_q": 6,
    "target_qd": 6,
    "target_qdd": 6,
    "target_current": 6,
    "target_moment": 6,
    "actual_q": 6,
    "actual_qd": 6,
    "actual_current": 6,
    "actual_TCP_pose": 6,
    "actual_TCP_speed": 6,
    "actual_TCP_force": 6,
    "actual_tool_accelerometer": 3,
    "ft_wrench": 6,
    "imu_acc": 3,
    "imu_gyro": 3,
    "imu_mag": 3,
}


@dataclass(frozen=True)
class Note:
    """One thing a reader found or repaired, in words.

    Attributes:
        where: file, or file and row, or device.
        what: the finding, a sentence.
        repaired: True if data was cut, filled or dropped because of it.
    """

    where: str
    what: str
    repaired: bool = False

    def __str__(self) -> str:
        return f"{self.where}: {self.what}"


@dataclass(frozen=True)
class Table:
    """What one device reported.

    Attributes:
        device: ``robot``, ``ft`` or ``imu``.
        time: (n,) seconds on the device's own clock, strictly increasing unless the device repeats stamps.
        columns: name -> (n, width) float64.
        host_start: POSIX time in seconds of the host clock at ``time == 0``, None if the log does not tell.
    """

    device: str
    time: np.ndarray
    columns: Mapping[str, np.ndarray]
    host_start: float | None = None

    def __post_init__(self) -> None:
        for name, values in self.columns.items():
            if values.ndim != 2 or len(values) != len(self.time):
                raise RecordingError(
                    f"{self.device}: column '{name}' has shape {values.shape}, "
                    f"the table has {len(self.time)} rows of (n, width) columns"
                )

    def __len__(self) -> int:
        return len(self.time)

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> np.ndarray:
        try:
            return self.columns[name]
        except KeyError:
            raise RecordingError(
                f"the {self.device} table has no column '{name}' (it has: {', '.join(sorted(self.columns))})"
            ) from None

    def with_columns(self, columns: Mapping[str, np.ndarray]) -> Table:
        """The same table with columns added or replaced."""
        return replace(self, columns={**self.columns, **columns})


@dataclass(frozen=True)
class Recording:
    """Tables of one run, by device.

    Attributes:
        tables: device name -> Table; ``robot`` is always there.
        source: what it was read from, for reports (no absolute path: the folder's or file's own name).
        format: name of the format it was read from.
        notes: what the reader found or repaired.
    """

    tables: Mapping[str, Table]
    source: str
    format: str
    notes: tuple[Note, ...] = field(default=())

    def __post_init__(self) -> None:
        if "robot" not in self.tables:
            raise RecordingError(f"{self.source}: no robot table (found: {', '.join(self.tables) or 'nothing'})")

    @property
    def robot(self) -> Table:
        return self.tables["robot"]

    def with_table(self, table: Table) -> Recording:
        """The same recording with one table added or replaced."""
        return replace(self, tables={**self.tables, table.device: table})

    def with_notes(self, notes: Iterable[Note]) -> Recording:
        return replace(self, notes=(*self.notes, *notes))
