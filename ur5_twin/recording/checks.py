"""Checks and repairs that all formats share: clocks that run backwards, rows that repeat, values without a number."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence

import numpy as np

from ur5_twin.errors import RecordingError
from ur5_twin.recording.grid import REPAIR_HINT
from ur5_twin.recording.table import Note, Table

#: Columns the twin or an estimator added; they may hold NaN (an estimator that has not settled yet).
PREDICTED_PREFIXES = ("sim_", "truth_", "est_")
#: A column broken in more than this share of the rows is left out rather than all these rows.
MOST_ROWS = 0.5
#: A step of the clock longer than this many median periods is a gap.
_GAP = 1.5
#: A stamp beyond this is no time in seconds.
_LONGEST = 1e11
#: Steps that stray from the median by less than this share of it are not worth a word.
_JITTER = 0.01


def count(n: int, noun: str) -> str:
    """A number with its noun: ``1 row``, ``3,229 rows``."""
    return f"{n:,} {noun}{'' if n == 1 else 's'}"


def listed(names: Sequence[str], most: int = 4) -> str:
    """Names in a sentence, the first few if they are many."""
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def longest_increasing(time: np.ndarray, *, strictly: bool) -> np.ndarray:
    """Indices of the largest set of rows whose stamps increase: the fewest rows to drop from a clock that runs back."""
    find = bisect_left if strictly else bisect_right
    tails: list[float] = []
    tail_rows: list[int] = []
    before = np.full(len(time), -1, dtype=np.intp)
    for row, stamp in enumerate(time.tolist()):
        place = find(tails, stamp)
        if place:
            before[row] = tail_rows[place - 1]
        if place == len(tails):
            tails.append(stamp)
            tail_rows.append(row)
        else:
            tails[place], tail_rows[place] = stamp, row
    kept = np.empty(len(tails), dtype=np.intp)
    row = tail_rows[-1] if tail_rows else -1
    for place in range(len(tails) - 1, -1, -1):
        kept[place] = row
        row = int(before[row])
    return kept


def backwards(time: np.ndarray, *, strictly: bool) -> int | None:
    """Index of the first row whose stamp does not follow the one before; None if all do."""
    steps = np.diff(time)
    wrong = np.flatnonzero(steps <= 0 if strictly else steps < 0)
    return int(wrong[0]) + 1 if len(wrong) else None


def backwards_message(time: np.ndarray, index: int) -> str:
    """What is wrong with the stamp of a row."""
    stamp, before = time[index], time[index - 1]
    if stamp == before:
        return f"the stamp {stamp:.6f} s repeats that of the row before, with other values; stamps must increase"
    return f"time runs backwards ({stamp:.6f} s after {before:.6f} s); stamps must increase"


def settle(
    table: Table, where: str, rows: np.ndarray, *, repair: bool, repeats: bool = False
) -> tuple[Table, list[Note]]:
    """Check the clock and the values of one device's table, and repair it if asked.

    Rows that repeat the row before, stamp and values, say nothing twice and are always dropped, with a note.

    Args:
        table: as read.
        where: file or device, for messages.
        rows: (n,) 1-based row of the file for each row of the table.
        repair: drop what is broken instead of refusing it.
        repeats: the device's clock may repeat stamps (a sensor with a clock in whole milliseconds).

    Returns:
        The table and what was found.

    Raises:
        RecordingError: something is broken and ``repair`` is off, or nothing is left after the repair.
    """
    notes: list[Note] = []
    table, rows = _settle_values(table, where, rows, repair, notes)
    if not repeats:
        table, rows = _drop_repeated_rows(table, where, rows, notes)
    index = backwards(table.time, strictly=not repeats)
    if index is not None:
        if not repair:
            raise RecordingError(f"{where}, row {rows[index]}: {backwards_message(table.time, index)}; {REPAIR_HINT}")
        kept = longest_increasing(table.time, strictly=not repeats)
        dropped = np.setdiff1d(rows, rows[kept])
        notes.append(
            Note(where, f"time ran backwards or stood still: {_dropped(dropped)} so that stamps increase", True)
        )
        table = take(table, kept)
    if not len(table):
        raise RecordingError(f"{where}: no sound row; a recording needs at least one")
    return table, notes


def take(table: Table, index: np.ndarray) -> Table:
    """Some rows of a table."""
    columns = {name: values[index] for name, values in table.columns.items()}
    return Table(table.device, table.time[index], columns, table.host_start)


def _dropped(rows: np.ndarray) -> str:
    return f"{count(len(rows), 'row')} left out, the first is row {rows[0]},"


def _settle_values(
    table: Table, where: str, rows: np.ndarray, repair: bool, notes: list[Note]
) -> tuple[Table, np.ndarray]:
    measured = {name: v for name, v in table.columns.items() if not name.startswith(PREDICTED_PREFIXES)}
    sound = {name: np.isfinite(values).all(axis=1) for name, values in measured.items()}
    # NaN compares as false; no clock, whatever it counts from, reads thousands of years in seconds.
    sound["time"] = np.abs(table.time) < _LONGEST
    broken = {name: ok for name, ok in sound.items() if not ok.all()}
    if not broken:
        return table, rows
    if not repair:
        first = min(broken, key=lambda name: int(np.argmin(broken[name])))
        kind = "time in seconds" if first == "time" else "number"
        row = rows[int(np.argmin(broken[first]))]
        raise RecordingError(f"{where}, row {row}: {first} is no finite {kind}; {REPAIR_HINT}")
    lost = [name for name, ok in broken.items() if name != "time" and np.mean(~ok) > MOST_ROWS]
    if lost:
        notes.append(Note(where, f"{listed(lost)} not finite in most rows: left out", True))
    keep = np.ones(len(table), dtype=bool)
    for name, ok in broken.items():
        if name not in lost:
            keep &= ok
    if not keep.all():
        notes.append(Note(where, f"values that are not finite: {_dropped(rows[~keep])} in all columns", True))
    left = {name: values for name, values in table.columns.items() if name not in lost}
    return take(Table(table.device, table.time, left, table.host_start), np.flatnonzero(keep)), rows[keep]


def _drop_repeated_rows(table: Table, where: str, rows: np.ndarray, notes: list[Note]) -> tuple[Table, np.ndarray]:
    same = np.diff(table.time) == 0
    if not same.any():
        return table, rows
    for values in table.columns.values():
        same &= ((values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))).all(axis=1)
    if not same.any():
        return table, rows
    keep = np.flatnonzero(np.concatenate(([True], ~same)))
    gone = rows[1:][same]
    notes.append(
        Note(
            where,
            f"{count(len(gone), 'row')} repeat the row before, stamp and values (the first is row {gone[0]}): dropped",
            True,
        )
    )
    return take(table, keep), rows[keep]


def clock_notes(table: Table, where: str) -> list[Note]:
    """What is worth saying about the clock of the robot: jitter, gaps, missing rows. Nothing if it is regular."""
    steps = np.diff(table.time)
    if len(steps) < 2:
        return []
    period = float(np.median(steps))
    gaps = steps > _GAP * period
    regular = steps[~gaps]
    jitter = float(np.abs(regular - period).max()) if len(regular) else 0.0
    said: list[str] = []
    if jitter > _JITTER * period:
        said.append(f"steps stray from the median by up to {1e3 * jitter:.3g} ms")
    if gaps.any():
        missing = int(np.sum(np.rint(steps[gaps] / period) - 1))
        said.append(
            f"{count(int(gaps.sum()), 'gap')} longer than {_GAP} periods, the longest {1e3 * steps.max():.4g} ms: "
            f"about {count(missing, 'row')} missing"
        )
    if not said:
        return []
    return [Note(where, f"the clock is uneven (median period {1e3 * period:.4g} ms): {'; '.join(said)}")]


def sensor_notes(table: Table, where: str, *, column: str | None = None) -> list[Note]:
    """Rate of a sensor with its own clock, repeated stamps, and how many of its values are new."""
    span = float(table.time[-1] - table.time[0])
    rate = f" at {(len(table) - 1) / span:.1f} Hz" if span > 0 else ""
    said = [f"{count(len(table), 'row')}{rate}, on its own clock"]
    stamps = int(np.sum(np.diff(table.time) == 0))
    if stamps:
        said.append(f"{count(stamps, 'stamp')} repeated")
    if column is not None:
        values = table[column]
        distinct = len(np.unique(values, axis=0))
        repeated = int(np.sum((values[1:] == values[:-1]).all(axis=1)))
        per_axis = [len(np.unique(values[:, axis])) / len(values) for axis in range(values.shape[1])]
        if distinct < len(values):
            said.append(
                f"{100 * distinct / len(values):.1f} % of the rows are distinct "
                f"({100 * min(per_axis):.0f} to {100 * max(per_axis):.0f} % by axis), "
                f"{count(repeated, 'row')} repeat the values before"
            )
    return [Note(where, "; ".join(said))]
