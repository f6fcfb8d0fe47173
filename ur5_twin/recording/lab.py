"""The lab's folder of CSV files: one file a signal, no header, first column the seconds since the first sample.

The files of a run belong together row by row; they end at different rows, and each may be cut off in its last one.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ur5_twin.errors import RecordingError
from ur5_twin.recording import checks
from ur5_twin.recording.grid import REPAIR_HINT, Grid, read_grid, read_text
from ur5_twin.recording.lab_layout import CSV_FOLDER, NEEDED, ROBOT_FILES, START_TIME, RobotFile, parts
from ur5_twin.recording.lab_sensors import host_start, note_on_ft_clock, read_ft, read_imu
from ur5_twin.recording.table import Note, Recording, Table

FORMAT = "lab_csv"
#: The controller's period, for a log too short to tell its own, s.
_PERIOD = 0.008


def read_lab_folder(folder: Path, *, repair: bool = False) -> Recording:
    """Read a movement of the lab.

    Args:
        folder: the movement's folder or its ``csv_files``.
        repair: drop or leave out what is broken, with a note each, instead of refusing the log.

    Raises:
        RecordingError: a file is missing or broken and ``repair`` is off, or no positions can be saved.
    """
    csv_folder = folder / CSV_FOLDER if (folder / CSV_FOLDER).is_dir() else folder
    source = _movement_name(csv_folder)
    notes: list[Note] = []
    robot_start = host_start(csv_folder / START_TIME, source, notes)
    tables = {"robot": _read_robot(csv_folder, source, robot_start, repair, notes)}
    ft = read_ft(csv_folder, source, repair, notes)
    if ft is not None:
        tables["ft"] = ft
        note_on_ft_clock(ft, robot_start, source, notes)
    imu = read_imu(csv_folder, source, repair, notes)
    if imu is not None:
        tables["imu"] = imu
    return Recording(tables, source, FORMAT, tuple(notes))


def _movement_name(csv_folder: Path) -> str:
    absolute = csv_folder.resolve()
    return absolute.parent.name if absolute.name == CSV_FOLDER else absolute.name


# ---------------------------------------------------------------- the robot's files


def _read_robot(csv_folder: Path, source: str, robot_start: float | None, repair: bool, notes: list[Note]) -> Table:
    grids = _load_robot_grids(csv_folder, source, repair, notes)
    _note_cut_rows(grids, source, notes)
    try:
        rows, picked = _joined_by_row(grids, source, notes)
    except RecordingError:
        if not repair:
            raise
        grids, rows, picked = _joined_by_time(grids, source, notes)
    clock = grids[ROBOT_FILES[0].name].values[rows, 0]
    columns = {
        file.column: np.ascontiguousarray(grids[file.name].values[picked[file.name], 1:])
        for file in ROBOT_FILES
        if file.name in grids
    }
    table = Table("robot", clock, columns, robot_start)
    table, found = checks.settle(table, f"{source}/{ROBOT_FILES[0].name}", rows + 1, repair=repair)
    notes.extend(found)
    notes.extend(checks.clock_notes(table, f"{source}/robot"))
    return table


def _load_robot_grids(csv_folder: Path, source: str, repair: bool, notes: list[Note]) -> dict[str, Grid]:
    missing = [file.name for file in ROBOT_FILES if not (csv_folder / file.name).is_file()]
    lost_for_good = [name for name in missing if name in NEEDED]
    if missing and (lost_for_good or not repair):
        hint = (
            f"{' and '.join(NEEDED)} cannot be done without"
            if lost_for_good
            else "--repair (repair=True) leaves their signals out"
        )
        raise RecordingError(
            f"{source}: no {checks.listed(missing)}; the lab's layout has {len(ROBOT_FILES)} robot files; {hint}"
        )
    for name in missing:
        notes.append(Note(f"{source}/{name}", "the file is missing: its signal is left out", True))
    grids: dict[str, Grid] = {}
    for file in ROBOT_FILES:
        if file.name in missing:
            continue
        try:
            grids[file.name] = _read_robot_file(csv_folder, source, file, lenient=repair)
        except RecordingError as error:
            if not repair or file.name in NEEDED:
                raise
            what = str(error).removeprefix(f"{source}/{file.name}").lstrip(", :")
            notes.append(Note(f"{source}/{file.name}", f"{what}: its signal is left out", True))
    return grids


def _read_robot_file(csv_folder: Path, source: str, file: RobotFile, *, lenient: bool) -> Grid:
    name = f"{source}/{file.name}"
    text = read_text(csv_folder / file.name, name, lenient=lenient)
    grid = read_grid(text, name, separator=",", names=("time", *parts(file.column, file.width)))
    if not len(grid):
        raise RecordingError(f"{name}: no complete row; a row is time and {file.width} numbers")
    return grid


def _note_cut_rows(grids: Mapping[str, Grid], source: str, notes: list[Note]) -> None:
    cut = [file for file, grid in grids.items() if grid.cut_row is not None]
    if cut:
        notes.append(
            Note(
                source,
                f"the last row of {checks.count(len(cut), 'file')} is cut off in mid-row and left out: "
                f"{', '.join(f'{file} row {grids[file].cut_row}' for file in cut)}",
                True,
            )
        )


def _joined_by_row(
    grids: Mapping[str, Grid], source: str, notes: list[Note]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Rows that all files have, if every one is sound and stamped alike; otherwise the error that says which is not."""
    faulty = [grid for grid in grids.values() if grid.faults]
    if faulty:
        worst = min(faulty, key=lambda grid: grid.faults[0].row)
        raise worst.error(worst.faults[0])
    lengths = {name: len(grid) for name, grid in grids.items()}
    n = min(lengths.values())
    clocks = np.stack([grid.values[:n, 0] for grid in grids.values()])
    # The median over the files is the clock even if one file, whichever, has a row too many or too few.
    agreed = np.median(clocks, axis=0)
    period = float(np.median(np.diff(agreed))) if n > 1 else _PERIOD
    apart = np.abs(clocks - agreed)
    disagree = apart >= 0.5 * (period if period > 0 else _PERIOD)
    if disagree.any():
        row = int(np.argmax(disagree.any(axis=0)))
        which = list(grids)[int(np.argmax(apart[:, row]))]
        raise RecordingError(
            f"{source}/{which}, row {row + 1}: the stamp is {grids[which].values[row, 0]:.6f} s where the other files "
            f"have {agreed[row]:.6f} s; a row may be missing or too many; {REPAIR_HINT}"
        )
    most = max(lengths.values())
    if most > n:
        shortest, longest = min(lengths, key=lengths.__getitem__), max(lengths, key=lengths.__getitem__)
        notes.append(
            Note(
                source,
                f"the files end at different rows, from {n:,} ({shortest}) to {most:,} ({longest}): "
                f"all are cut to {checks.count(n, 'row')}",
                True,
            )
        )
    spread = float(np.ptp(clocks, axis=0).max())
    if spread > 0:
        notes.append(
            Note(
                source,
                f"the files stamp the same row up to {1e6 * spread:.0f} us apart: "
                f"the stamps of {next(iter(grids))} are taken",
            )
        )
    rows = np.arange(n)
    return rows, dict.fromkeys(grids, rows)


def _joined_by_time(
    grids: Mapping[str, Grid], source: str, notes: list[Note]
) -> tuple[dict[str, Grid], np.ndarray, dict[str, np.ndarray]]:
    """The repair: rows are matched by their stamps, and those that a file lacks or has broken go from all of them."""
    sound: dict[str, np.ndarray] = {}
    for name, grid in grids.items():
        readable = np.flatnonzero(grid.sound())
        sound[name] = readable[checks.longest_increasing(grid.values[readable, 0], strictly=True)]
    clock_name = ROBOT_FILES[0].name
    rows = sound[clock_name]
    if not len(rows):
        raise RecordingError(f"{source}/{clock_name}: no sound row; without positions there is nothing to repair")
    clock = grids[clock_name].values[rows, 0]
    period = float(np.median(np.diff(clock))) if len(clock) > 1 else _PERIOD
    partners: dict[str, np.ndarray] = {}
    for name, grid in grids.items():
        partner = _nearest(clock, grid.values[sound[name], 0], 0.5 * period)
        partners[name] = np.where(partner >= 0, sound[name][partner], -1) if len(sound[name]) else partner
    # Rows past the end of a file are no fault: the shortest file ends the run, as it does without a repair.
    end = int(np.searchsorted(clock, min(map(_last_stamp, grids.values())) + 0.5 * period))
    kept = dict(grids)
    for name, partner in partners.items():
        if not end or np.mean(partner[:end] < 0) > checks.MOST_ROWS:
            if name in NEEDED:
                raise RecordingError(
                    f"{source}/{name}: most rows are broken or stamped otherwise than {clock_name}; "
                    "without positions there is nothing to repair"
                )
            notes.append(Note(f"{source}/{name}", "most rows are broken: its signal is left out", True))
            del kept[name]
    whole = np.ones(end, dtype=bool)
    for name in kept:
        whole &= partners[name][:end] >= 0
    _note_repair(grids, kept, rows, whole, source, notes)
    index = np.flatnonzero(whole)
    if not len(index):
        raise RecordingError(f"{source}: no row is sound in every file; there is nothing to repair")
    return kept, rows[index], {name: partners[name][index] for name in kept}


def _note_repair(
    grids: Mapping[str, Grid],
    kept: Mapping[str, Grid],
    rows: np.ndarray,
    whole: np.ndarray,
    source: str,
    notes: list[Note],
) -> None:
    for name in kept:
        grid = grids[name]
        if grid.faults:
            bad = len({fault.row for fault in grid.faults})
            first = grid.faults[0]
            notes.append(
                Note(
                    f"{source}/{name}",
                    f"{checks.count(bad, 'row')} unreadable, the first is row {first.row} ({first.what})",
                    True,
                )
            )
    lost = int(np.sum(~whole))
    before = max(len(grid) for grid in kept.values())
    first = f", the first is row {rows[int(np.argmin(whole))] + 1}" if lost else ""
    notes.append(
        Note(
            source,
            f"rows matched by their stamps: {checks.count(int(whole.sum()), 'row')} of up to {before:,} kept; "
            f"{lost:,} broken or missing in a file and left out of all{first}",
            True,
        )
    )


def _last_stamp(grid: Grid) -> float:
    """Where a file ends, s; never, if it has no stamps: it is broken, not short."""
    stamps = grid.values[np.isfinite(grid.values[:, 0]), 0]
    return float(stamps[checks.longest_increasing(stamps, strictly=True)][-1]) if len(stamps) else np.inf


def _nearest(clock: np.ndarray, stamps: np.ndarray, tolerance: float) -> np.ndarray:
    """For each row of a clock, the index of the nearest of some increasing stamps; -1 if none is within tolerance."""
    if not len(stamps):
        return np.full(len(clock), -1)
    right = np.clip(np.searchsorted(stamps, clock), 0, len(stamps) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(np.abs(stamps[left] - clock) <= np.abs(stamps[right] - clock), left, right)
    return np.where(np.abs(stamps[nearest] - clock) < tolerance, nearest, -1)
