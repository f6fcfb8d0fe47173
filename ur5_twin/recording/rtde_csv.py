"""RTDE data in one CSV with a header: ur_rtde's file recording (commas) and Universal Robots' record.py (spaces).

A vector is spread over columns ``name_0`` to ``name_5``; ``timestamp`` is the robot's clock.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ur5_twin.errors import RecordingError
from ur5_twin.recording import checks
from ur5_twin.recording.grid import Grid, read_grid, read_text
from ur5_twin.recording.table import COLUMN_WIDTHS, Note, Recording, Table

UR_RTDE = "ur_rtde_csv"
RECORD_PY = "record_py_csv"
CLOCK = "timestamp"
#: One of these must be there and whole: a log without positions is not a log of a motion.
_POSITIONS = ("actual_q", "target_q")
_PART = re.compile(r"(.+)_(\d+)", re.ASCII)
_QUOTED = re.compile(r"(?<![^,;\s])\"([^\"\n]*)\"(?![^,;\s])")
_BOOLEAN = re.compile(r"(?<![^,;\s])(True|False)(?![^,;\s])", re.IGNORECASE)


def read_rtde_csv(path: Path, *, repair: bool = False) -> Recording:
    """Read a CSV of RTDE data.

    Every numeric column is kept, also those this package does not know; all are columns of the robot's table.

    Args:
        path: the file.
        repair: drop or leave out what is broken, with a note each, instead of refusing the log.

    Raises:
        RecordingError: something is broken and ``repair`` is off, or there is no clock or no positions.
    """
    name = path.name
    notes: list[Note] = []
    text = read_text(path, name, lenient=repair)
    header, separator, body = _header(text, name)
    body = _BOOLEAN.sub(lambda m: "1" if m[1].lower() == "true" else "0", _QUOTED.sub(r"\1", body))
    if not body.strip():
        raise RecordingError(f"{name}: a header but no rows")
    header, body = _without_trailing_separators(header, body, separator)
    text_columns = _text_columns(header, body, separator)
    if text_columns:
        header, body = _without_columns(header, body, separator, text_columns)
        notes.append(Note(name, f"no numbers in {checks.listed(text_columns)}: left out", True))
    grid = read_grid(body, name, separator=separator, names=header, first_row=2)
    if grid.cut_row is not None:
        notes.append(Note(name, f"the last row ({grid.cut_row}) is cut off in mid-row and left out", True))
    layout = _layout(header, name, repair, notes)
    clock = header.index(CLOCK)
    keep, layout = _sound_rows(grid, clock, layout, repair, notes)
    values = grid.values[keep]
    columns = {column: np.ascontiguousarray(values[:, fields]) for column, fields in layout.items()}
    table = Table("robot", values[:, clock].copy(), columns)
    table, found = checks.settle(table, name, keep + grid.first_row, repair=repair)
    notes.extend(found)
    notes.extend(checks.clock_notes(table, name))
    return Recording({"robot": table}, path.stem, UR_RTDE if separator == "," else RECORD_PY, tuple(notes))


def _header(text: str, name: str) -> tuple[list[str], str | None, str]:
    """Column names, the separator and the rows below."""
    first, _, body = text.partition("\n")
    first = _QUOTED.sub(r"\1", first.strip())
    separator = next((s for s in (",", ";") if s in first), None)
    header = [field.strip() for field in first.split(separator)]
    if CLOCK not in header:
        raise RecordingError(
            f"{name}, row 1: no column '{CLOCK}' in the header; an RTDE log needs the robot's clock: record it too"
        )
    return header, separator, body


def _without_trailing_separators(header: list[str], body: str, separator: str | None) -> tuple[list[str], str]:
    """Some writers end every row with a separator, with or without one in the header."""
    while header[-1] == "":
        header = header[:-1]
    if separator is not None:
        lines = body.split("\n")
        if all(_ends_with_separator(line, separator, len(header)) for line in lines[:-1] if line.strip()):
            body = "\n".join(
                line.rstrip()[:-1] if _ends_with_separator(line, separator, len(header)) else line for line in lines
            )
    return header, body


def _ends_with_separator(line: str, separator: str, width: int) -> bool:
    return line.rstrip().endswith(separator) and line.count(separator) == width


def _text_columns(header: Sequence[str], body: str, separator: str | None) -> list[str]:
    """Columns this package does not know that begin and end with something that is not a number."""
    rows = [line.split(separator) for line in body.split("\n") if line.strip()]
    ends = [row for row in (rows[0], rows[-1]) if len(row) == len(header)]
    return [
        name
        for i, name in enumerate(header)
        if ends and name != CLOCK and _vector(name)[0] not in COLUMN_WIDTHS and not any(_is_number(r[i]) for r in ends)
    ]


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def _without_columns(
    header: list[str], body: str, separator: str | None, unwanted: Sequence[str]
) -> tuple[list[str], str]:
    places = {i for i, name in enumerate(header) if name in unwanted}
    lines = []
    for line in body.split("\n"):
        fields = line.split(separator)
        # Rows of another length keep it, for the reader to find.
        if len(fields) == len(header):
            fields = [field for i, field in enumerate(fields) if i not in places]
        lines.append((separator or " ").join(fields))
    return [name for i, name in enumerate(header) if i not in places], "\n".join(lines)


def _vector(name: str) -> tuple[str, int]:
    part = _PART.fullmatch(name)
    return (part[1], int(part[2])) if part else (name, 0)


def _layout(header: Sequence[str], name: str, repair: bool, notes: list[Note]) -> dict[str, list[int]]:
    """Column name -> the fields it is made of."""
    fields: dict[str, int] = {}
    for i, label in enumerate(header):
        if label in fields or not label:
            what = f"column {i + 1} has no name" if not label else f"column '{label}' appears twice"
            if not repair or label == CLOCK:
                raise RecordingError(f"{name}, row 1: {what}; names must be there and differ")
            notes.append(Note(f"{name}, row 1", f"{what}: left out", True))
        else:
            fields[label] = i
    parts: dict[str, dict[int, int]] = {}
    for label, i in fields.items():
        vector, part = _vector(label)
        parts.setdefault(vector, {})[part] = i
    layout: dict[str, list[int]] = {}
    for vector, found in parts.items():
        if vector == CLOCK:
            continue
        width = COLUMN_WIDTHS.get(vector)
        whole = sorted(found) == list(range(width or len(found)))
        if width is not None and not whole:
            what = (
                f"{vector} has the parts {', '.join(f'{vector}_{p}' for p in sorted(found))}; "
                f"it needs {vector}_0 to {vector}_{width - 1}"
            )
            if not repair:
                raise RecordingError(f"{name}, row 1: {what}")
            notes.append(Note(f"{name}, row 1", f"{what}: left out", True))
        elif whole and len(found) > 1:
            layout[vector] = [found[part] for part in sorted(found)]
        else:
            layout.update((label, [i]) for label, i in fields.items() if i in found.values())
    if not any(column in layout for column in _POSITIONS):
        raise RecordingError(
            f"{name}, row 1: no joint positions; a log needs actual_q_0 to actual_q_5 (or target_q_0 to target_q_5)"
        )
    return layout


def _sound_rows(
    grid: Grid, clock: int, layout: Mapping[str, list[int]], repair: bool, notes: list[Note]
) -> tuple[np.ndarray, dict[str, list[int]]]:
    """Rows to keep and columns to keep."""
    if not grid.faults:
        return np.arange(len(grid)), dict(layout)
    if not repair:
        raise grid.error(grid.faults[0])
    whole_rows = ~np.isnan(grid.values).all(axis=1)
    if not whole_rows.any():
        raise RecordingError(f"{grid.name}: no row can be read; there is nothing to repair")
    kept = {
        column: fields
        for column, fields in layout.items()
        if np.mean(~grid.sound(fields)[whole_rows]) <= checks.MOST_ROWS
    }
    lost = [column for column in layout if column not in kept]
    if lost:
        notes.append(Note(grid.name, f"{checks.listed(lost)} unreadable in most rows: left out", True))
    if not any(column in kept for column in _POSITIONS):
        raise RecordingError(f"{grid.name}: no joint positions can be read; there is nothing to repair")
    sound = grid.sound([clock, *(field for fields in kept.values() for field in fields)])
    if not sound.all():
        first = int(np.argmin(sound)) + grid.first_row
        what = next((fault.what for fault in grid.faults if fault.row == first), "not a finite number")
        notes.append(
            Note(
                grid.name,
                f"{checks.count(int(np.sum(~sound)), 'row')} unreadable and left out, "
                f"the first is row {first} ({what})",
                True,
            )
        )
    return np.flatnonzero(sound), kept
