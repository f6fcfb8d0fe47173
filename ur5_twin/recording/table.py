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
        tables: device name -> Table; of a test stand's sensors alone there is no ``robot``.
        source: what it was read from, for reports (no absolute path: the folder's or file's own name).
        format: name of the format it was read from.
        notes: what the reader found or repaired.
    """

    tables: Mapping[str, Table]
    source: str
    format: str
    notes: tuple[Note, ...] = field(default=())

    def __post_init__(self) -> None:
        if not self.tables:
            raise RecordingError(f"{self.source}: a recording without any table")

    @property
    def robot(self) -> Table:
        """The robot's table.

        Raises:
            RecordingError: only sensors were recorded.
        """
        try:
            return self.tables["robot"]
        except KeyError:
            raise RecordingError(f"{self.source}: no robot table (found: {', '.join(self.tables)})") from None

    def with_table(self, table: Table) -> Recording:
        """The same recording with one table added or replaced."""
        return replace(self, tables={**self.tables, table.device: table})

    def with_notes(self, notes: Iterable[Note]) -> Recording:
        return replace(self, notes=(*self.notes, *notes))

    def aligned(self) -> Table:
        """All devices' columns on the robot's clock.

        The robot's columns are as they are; those of the other devices are interpolated linearly (only wrenches,
        accelerations, rates and fields, no poses). A device's time is shifted by the offset of the host's stamps,
        ``host_start - robot.host_start``; where one of the two is unknown the clocks are taken to start together, as
        the reader's notes say. Of a stamp that a device repeats the last value counts. Outside a device's range its
        columns are NaN. A column that the robot has too is the robot's. The list of a
        simulated cell's contacts is no signal and stays out.

        Returns:
            A table ``robot`` with the robot's clock and the columns of all devices.
        """
        robot = self.robot
        columns = dict(robot.columns)
        for device, table in self.tables.items():
            if device in ("robot", "contact"):
                continue
            offset = self.offset(device) or 0.0
            last = np.append(np.diff(table.time) > 0, True)[: len(table)]
            time = table.time[last] + offset
            for name, values in table.columns.items():
                if name not in robot:
                    columns[name] = _interpolated(robot.time, time, values[last])
        return replace(robot, columns=columns)

    def offset(self, device: str) -> float | None:
        """Seconds to add to a device's time to get the robot's; None if the host's stamps do not tell."""
        start, robot_start = self.tables[device].host_start, self.robot.host_start
        return None if start is None or robot_start is None else start - robot_start


def _interpolated(at: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    if not len(time):
        return np.full((len(at), values.shape[1]), np.nan)
    columns = [np.interp(at, time, column, left=np.nan, right=np.nan) for column in values.T]
    return np.stack(columns, axis=1) if columns else np.empty((len(at), 0))
