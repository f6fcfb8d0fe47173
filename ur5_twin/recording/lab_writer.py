"""Writing a recording in the lab's layout."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from ur5_twin.errors import RecordingError
from ur5_twin.recording.lab_layout import (
    CSV_FOLDER,
    FT_FILE,
    FT_START_TIME,
    IMU_COLUMNS,
    IMU_FILE,
    KNOWN_FILES,
    ROBOT_FILES,
    START_TIME,
)
from ur5_twin.recording.table import Recording, Table


def write_lab_csv(recording: Recording, folder: Path | str) -> Path:
    """Write a recording as the lab did: ``folder/csv_files/log_*.csv``, six decimals, the imu's time in ms.

    Predicted columns (sim_, truth_, est_) and others the layout does not know are left out, and so is the host time of
    the imu's start. What is read back differs by rounding to 1e-6 at most. A force sensor that reads zero throughout
    is read back as not connected, as it is in the lab's logs.

    The folder appears in one piece; one written before in this layout is replaced.

    Args:
        recording: must have the twelve signals of the layout.
        folder: the movement's folder.

    Returns:
        The folder.

    Raises:
        RecordingError: a signal is missing or not finite, two stamps are less than 1 us apart, the folder holds
            something else, or it cannot be written.
    """
    folder = Path(folder).absolute()
    _check_signals(recording)
    _check_target(folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as name:
            made = Path(name) / "new"
            (made / CSV_FOLDER).mkdir(parents=True)
            _write_files(recording, made / CSV_FOLDER)
            if folder.exists():
                folder.rename(Path(name) / "old")
            made.rename(folder)
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be written ({error.strerror or error})") from None
    return folder


def _check_signals(recording: Recording) -> None:
    robot = recording.robot
    missing = [file.column for file in ROBOT_FILES if file.column not in robot]
    if missing:
        raise RecordingError(
            f"{recording.source}: no {', '.join(missing)} in the robot table; the lab's layout needs all of "
            f"{', '.join(file.column for file in ROBOT_FILES)}"
        )
    imu = recording.tables.get("imu")
    if imu is not None and any(column not in imu for column in IMU_COLUMNS):
        raise RecordingError(
            f"{recording.source}: the lab's layout needs all of {', '.join(IMU_COLUMNS)} in the imu table"
        )
    wanted = {
        "robot": {file.column: file.width for file in ROBOT_FILES},
        "ft": {"ft_wrench": 6},
        "imu": dict.fromkeys(IMU_COLUMNS, 3),
    }
    for device, widths in wanted.items():
        table = recording.tables.get(device)
        if table is not None:
            _check_table(recording.source, table, widths)


def _check_table(source: str, table: Table, widths: dict[str, int]) -> None:
    if not len(table):
        raise RecordingError(f"{source}: the {table.device} table has no rows")
    for column, width in widths.items():
        values = table[column]
        if values.shape[1] != width:
            raise RecordingError(f"{source}: {column} is {values.shape[1]} wide, the lab's layout has {width}")
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values).all(axis=1)))
            raise RecordingError(
                f"{source}: {column} is not finite in row {row + 1}; the lab's layout holds numbers only"
            )
    steps = np.diff(np.round(table.time, 6))
    if not np.isfinite(table.time).all() or (steps <= 0 if table.device == "robot" else steps < 0).any():
        raise RecordingError(f"{source}: the {table.device} clock does not increase by whole microseconds")


def _check_target(folder: Path) -> None:
    if not folder.exists():
        return
    if not folder.is_dir():
        raise RecordingError(f"{folder}: is a file; give a folder that is new, empty or in the lab's layout")
    foreign = [p.name for p in folder.iterdir() if not (p.name == CSV_FOLDER and p.is_dir())]
    if not foreign and (folder / CSV_FOLDER).is_dir():
        foreign = [f"{CSV_FOLDER}/{p.name}" for p in (folder / CSV_FOLDER).iterdir() if p.name not in KNOWN_FILES]
    if foreign:
        raise RecordingError(
            f"{folder}: holds '{sorted(foreign)[0]}', which is not of the lab's layout; nothing is written over it: "
            "give a folder that is new or empty"
        )


def _write_files(recording: Recording, csv_folder: Path) -> None:
    robot = recording.robot
    for file in ROBOT_FILES:
        _write_rows(csv_folder / file.name, robot.time, robot[file.column], file.decimals)
    if robot.host_start is not None:
        (csv_folder / START_TIME).write_text(f"{robot.host_start:.6f}\n" * len(robot), encoding="utf-8")
    ft = recording.tables.get("ft")
    if ft is not None:
        _write_rows(csv_folder / FT_FILE, ft.time, ft["ft_wrench"], 6)
        if ft.host_start is not None:
            (csv_folder / FT_START_TIME).write_text(f"{ft.host_start:.6f}\n", encoding="utf-8")
    imu = recording.tables.get("imu")
    if imu is not None:
        values = np.concatenate([imu[column] for column in IMU_COLUMNS], axis=1)
        _write_rows(csv_folder / IMU_FILE, 1000.0 * imu.time, values, 6)


def _write_rows(path: Path, time: np.ndarray, values: np.ndarray, decimals: int) -> None:
    np.savetxt(
        path,
        np.column_stack([time, values]),
        fmt=["%.6f"] + [f"%.{decimals}f"] * values.shape[1],
        delimiter=", ",
        encoding="utf-8",
    )
