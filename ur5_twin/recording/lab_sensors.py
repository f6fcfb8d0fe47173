"""The sensors' files in the lab's folder, and the host times of when the devices started."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ur5_twin.errors import RecordingError
from ur5_twin.recording import checks
from ur5_twin.recording.grid import read_grid, read_text
from ur5_twin.recording.lab_layout import (
    FT_FILE,
    FT_START_TIME,
    IMU_COLUMNS,
    IMU_FILE,
    NO_VALUES,
    START_TIME,
    parts,
)
from ur5_twin.recording.table import Note, Table

#: Below this the force sensor's file says that nothing was connected (the lab's program wrote -0.000001), N and Nm.
_NOTHING = 1.5e-6
#: A stamp, up to its end or up to where it repeats itself.
_STAMP = re.compile(r"(\d+\.\d+?)(?=\1|\s|$)", re.ASCII)


def read_ft(csv_folder: Path, source: str, repair: bool, notes: list[Note]) -> Table | None:
    """The force sensor's table; None, with a note, if none was connected."""
    name = f"{source}/{FT_FILE}"
    if not (csv_folder / FT_FILE).is_file():
        notes.append(Note(source, f"no {FT_FILE}: no force sensor in this run"))
        return None
    found = _read_sensor(csv_folder / FT_FILE, name, parts("ft_wrench", 6), repair, notes)
    if found is None:
        return None
    values, rows = found
    if np.abs(values[:, 1:]).max() <= _NOTHING:
        notes.append(
            Note(
                name,
                f"all {checks.count(len(values), 'row')} are zero (within 0.000001): no sensor was connected",
            )
        )
        return None
    start = host_start(csv_folder / FT_START_TIME, source, notes)
    table = Table("ft", values[:, 0].copy(), {"ft_wrench": np.ascontiguousarray(values[:, 1:])}, start)
    table, found_notes = checks.settle(table, name, rows, repair=repair, repeats=True)
    notes.extend(found_notes)
    notes.extend(checks.sensor_notes(table, name, column="ft_wrench"))
    return table


def read_imu(csv_folder: Path, source: str, repair: bool, notes: list[Note]) -> Table | None:
    """The accelerometer's table; None, with a note, if none was mounted."""
    name = f"{source}/{IMU_FILE}"
    if not (csv_folder / IMU_FILE).is_file():
        notes.append(Note(source, f"no {IMU_FILE}: no accelerometer in this run"))
        return None
    fields = tuple(part for column in IMU_COLUMNS for part in parts(column, 3))
    found = _read_sensor(csv_folder / IMU_FILE, name, fields, repair, notes)
    if found is None:
        return None
    values, rows = found
    columns = {column: np.ascontiguousarray(values[:, 1 + 3 * i : 4 + 3 * i]) for i, column in enumerate(IMU_COLUMNS)}
    # The device writes whole milliseconds.
    table, found_notes = checks.settle(
        Table("imu", values[:, 0] / 1000.0, columns), name, rows, repair=repair, repeats=True
    )
    notes.extend(found_notes)
    notes.extend(checks.sensor_notes(table, name))
    notes.append(
        Note(
            name,
            "its start is known only on a counter of the device: aligned() takes its time 0 for the robot's time 0",
        )
    )
    return table


def _read_sensor(
    path: Path, name: str, fields: Sequence[str], repair: bool, notes: list[Note]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Rows of a sensor's file and their 1-based numbers; None, with a note, if there is no sensor in it."""
    try:
        text = read_text(path, name, lenient=repair)
        silent = _silent_rows(text)
        if len(silent) == sum(bool(line.strip()) for line in text.split("\n")):
            rows = checks.count(len(silent), "row")
            notes.append(Note(name, f"all {rows} read '{NO_VALUES}': no sensor was connected"))
            return None
        grid = read_grid(text, name, separator=",", names=("time", *fields))
        if grid.cut_row is not None:
            notes.append(Note(name, f"the last row ({grid.cut_row}) is cut off in mid-row and left out", True))
        faults = [fault for fault in grid.faults if fault.row not in silent]
        if faults and not repair:
            raise grid.error(faults[0])
        keep = np.flatnonzero(grid.sound())
        if not len(keep):
            raise RecordingError(f"{name}: no complete row; a row is time and {len(fields)} numbers")
    except RecordingError as error:
        if not repair:
            raise
        notes.append(Note(name, f"{str(error).removeprefix(name).lstrip(', :')}: the sensor is left out", True))
        return None
    if silent:
        rows = checks.count(len(silent), "row")
        notes.append(Note(name, f"{rows} read '{NO_VALUES}' and are left out, the first is row {min(silent)}", True))
    if faults:
        first, bad = faults[0], len({fault.row for fault in faults})
        notes.append(
            Note(
                name,
                f"{checks.count(bad, 'row')} unreadable and left out, the first is row {first.row} ({first.what})",
                True,
            )
        )
    return grid.values[keep], keep + 1


def _silent_rows(text: str) -> set[int]:
    """1-based rows that say that no value came; the last may be cut off in saying so."""
    if NO_VALUES[:2] not in text:
        return set()
    rows = [line.strip() for line in text.split("\n")]
    return {
        i + 1
        for i, row in enumerate(rows)
        if row == NO_VALUES or (row[:1] == "n" and i + 1 == len(rows) and NO_VALUES.startswith(row))
    }


# ---------------------------------------------------------------- host clocks


def host_start(path: Path, source: str, notes: list[Note]) -> float | None:
    """POSIX time of the host at the device's time 0: the first stamp of a start time file.

    The lab's robot files repeat it in every row; in No3 without anything between two stamps.
    """
    where = f"{source}/{path.name}"
    if not path.is_file():
        notes.append(Note(source, f"no {path.name}: the host time of this device's start is unknown"))
        return None
    try:
        text = path.read_bytes()[:4096].decode("ascii").lstrip()
    except (OSError, UnicodeDecodeError):
        text = ""
    stamp = _STAMP.match(text)
    if stamp is None:
        notes.append(Note(where, "no POSIX time in it: the host time of this device's start is unknown"))
        return None
    if stamp.end() < len(text) and not text[stamp.end()].isspace():
        notes.append(Note(where, "its stamps stand without anything between them; the first is taken"))
    return float(stamp[1])


def note_on_ft_clock(ft: Table, robot_start: float | None, source: str, notes: list[Note]) -> None:
    """How far the clocks of force sensor and robot are apart."""
    where = f"{source}/{FT_FILE}"
    if ft.host_start is None or robot_start is None:
        notes.append(Note(where, "the offset between the two clocks is unknown: aligned() takes it for 0"))
        return
    offset = ft.host_start - robot_start
    rounded = f"; {START_TIME} is rounded to 10 ms" if robot_start == round(robot_start, 2) else ""
    notes.append(
        Note(
            where,
            f"by the host's stamps its clock starts {1e3 * abs(offset):.1f} ms {'after' if offset >= 0 else 'before'} "
            f"the robot's{rounded}",
        )
    )
