"""Rows of numbers in a text file: read fast where the file is sound, and slowly, to say what is wrong, where not."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ur5_twin.errors import RecordingError

#: What every message about a broken row ends with.
REPAIR_HINT = "--repair (repair=True) leaves such rows out"
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity)", re.ASCII | re.IGNORECASE)
#: Rows before a row without a newline that tell how many decimals the file writes.
_ROWS_FOR_DECIMALS = 20


@dataclass(frozen=True)
class Fault:
    """One thing that makes a row unreadable.

    Attributes:
        row: 1-based row of the file, header included.
        what: what is wrong and what would be right.
        field: 0-based field in the row; None if the whole row is meant.
    """

    row: int
    what: str
    field: int | None = None


@dataclass(frozen=True)
class Grid:
    """The numbers of one file.

    Attributes:
        name: the file, for messages.
        values: (n, width); what could not be read is NaN, and listed in ``faults``.
        first_row: 1-based row of the file that ``values[0]`` stands in.
        faults: in the order of the rows.
        cut_row: 1-based row that was cut off in writing and is not in ``values``, if there is one.
    """

    name: str
    values: np.ndarray
    first_row: int = 1
    faults: tuple[Fault, ...] = ()
    cut_row: int | None = None

    def __len__(self) -> int:
        return len(self.values)

    def error(self, fault: Fault) -> RecordingError:
        """The exception for a fault of this file."""
        return RecordingError(f"{self.name}, row {fault.row}: {fault.what}; {REPAIR_HINT}")

    def sound(self, fields: Sequence[int] | None = None) -> np.ndarray:
        """(n,) which rows have no fault, looking only at some fields if they are given."""
        values = self.values if fields is None else self.values[:, fields]
        return np.asarray(np.isfinite(values).all(axis=1))


def read_text(path: Path, name: str, *, lenient: bool = False) -> str:
    """The text of a file with newlines as newlines.

    Args:
        path: the file.
        name: what messages call it.
        lenient: put a replacement character where the file is not UTF-8, so that only the rows around it are lost.

    Raises:
        RecordingError: the file cannot be opened, is empty or is not UTF-8.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{name}: cannot be read ({error.strerror or error})") from None
    if not raw.strip():
        raise RecordingError(f"{name}: the file is empty; it should hold rows of numbers")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if not lenient:
            row = raw.count(b"\n", 0, error.start) + 1
            raise RecordingError(
                f"{name}, row {row}: byte 0x{raw[error.start]:02x} is not text; a log is plain text in UTF-8; "
                f"{REPAIR_HINT}"
            ) from None
        text = raw.decode("utf-8-sig", errors="replace")
    # csv writers on Windows end rows with "\r\n" or, opened in text mode, "\r\r\n".
    return re.sub(r"\r+\n", "\n", text) if "\r" in text else text


def read_grid(text: str, name: str, *, separator: str | None, names: Sequence[str], first_row: int = 1) -> Grid:
    """Numbers out of text, one row a line.

    A last row without a newline that was cut off in writing is left out and named in ``Grid.cut_row``.

    Args:
        text: the rows, without a header.
        name: the file, for messages.
        separator: what stands between numbers; None for any white space.
        names: what each field of a row is called.
        first_row: 1-based row of the file that the text begins with.
    """
    width = len(names)
    lines = text.split("\n")
    cut = None
    if lines[-1].strip() and _is_cut_off(lines, separator, width):
        cut = first_row + len(lines) - 1
        lines.pop()
    while lines and not lines[-1].strip():
        lines.pop()
    values = _read_fast(lines, separator, width)
    if values is not None:
        return Grid(name, values, first_row, cut_row=cut)
    values, faults = _read_carefully(lines, separator, names, first_row)
    return Grid(name, values, first_row, tuple(faults), cut)


def _split(line: str, separator: str | None) -> list[str]:
    return [field.strip() for field in line.split(separator)]


def _decimals(field: str) -> int:
    return len(field.partition(".")[2])


def _is_cut_off(lines: list[str], separator: str | None, width: int) -> bool:
    """Whether the last line, which has no newline, was cut off in writing.

    A number cut in its middle may still be a number, only a wrong one. Where a file writes a fixed number of decimals,
    fewer of them tell; where it does not, nothing does, and the row is given up.
    """
    last = _split(lines[-1], separator)
    if len(last) != width:
        return len(last) < width
    before = [_split(line, separator)[-1:] for line in lines[-1 - _ROWS_FOR_DECIMALS : -1]]
    written = {_decimals(field[0]) for field in before if field}
    if len(written) > 1:
        return True
    return bool(written) and _decimals(last[-1]) < written.pop()


def _read_fast(lines: list[str], separator: str | None, width: int) -> np.ndarray | None:
    """The numbers if every row is sound, else None."""
    if not lines:
        return np.empty((0, width))
    try:
        values = np.loadtxt(lines, delimiter=separator, ndmin=2, comments=None)
    except ValueError:
        return None
    # loadtxt passes over empty lines, which would shift every row after them.
    return values if values.shape == (len(lines), width) and np.isfinite(values).all() else None


def _read_carefully(
    lines: list[str], separator: str | None, names: Sequence[str], first_row: int
) -> tuple[np.ndarray, list[Fault]]:
    values = np.full((len(lines), len(names)), np.nan)
    faults: list[Fault] = []
    for i, line in enumerate(lines):
        fields = _split(line, separator)
        if len(fields) != len(names):
            count = 0 if not line.strip() else len(fields)
            faults.append(Fault(first_row + i, f"{count} columns where {len(names)} belong"))
            continue
        for j, field in enumerate(fields):
            number = float(field) if _NUMBER.fullmatch(field) else np.nan
            if np.isfinite(number):
                values[i, j] = number
            else:
                faults.append(Fault(first_row + i, _unreadable(field, names[j]), j))
    return values, faults


def _unreadable(field: str, name: str) -> str:
    if _NOT_FINITE.fullmatch(field) or _NUMBER.fullmatch(field):
        return f"'{field}' in {name} is not a finite number"
    shown = field if len(field) <= 40 else f"{field[:37]}..."
    return f"{shown!r} in {name} is not a number"
