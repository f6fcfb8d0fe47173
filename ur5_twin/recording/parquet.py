"""Our own format: one Parquet file with the tables of all devices, and what is known of them in its metadata.

Column ``device`` and column ``time``, then every column of every device spread over ``name_0`` to ``name_<width - 1>``;
the rows of one device stand together, null where a column is another device's. The file's key-value metadata has one
entry ``ur5_twin``, JSON: schema version, source, format, and per device its host start, rows, columns with their widths
and a checksum of the numbers; and the notes.
"""

from __future__ import annotations

import io
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from ur5_twin.atomic import replacing
from ur5_twin.errors import RecordingError
from ur5_twin.recording import checks
from ur5_twin.recording.table import Note, Recording, Table

if TYPE_CHECKING:
    import polars as pl

MAGIC = b"PAR1"
KEY = "ur5_twin"
SCHEMA = 1
#: Tables that may repeat stamps: sensors' clocks do, and several things may touch the arm at once.
_REPEATING = ("ft", "imu", "contact")


class _Device(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    name: str
    rows: int
    columns: dict[str, int]
    host_start: float | None
    crc32: int


class _Note(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    where: str
    what: str
    repaired: bool


class _Header(msgspec.Struct, frozen=True):
    schema: int
    source: str
    format: str
    devices: tuple[_Device, ...]
    notes: tuple[_Note, ...]


def write_parquet(recording: Recording, path: Path | str, metadata: Mapping[str, str] | None = None) -> Path:
    """Write a recording to one Parquet file; reading it back gives the same recording, bit for bit.

    The file appears in one piece, or not at all.

    Args:
        recording: any.
        path: the file.
        metadata: further entries of the file's key-value metadata (what made the recording, with what options).

    Returns:
        The path.

    Raises:
        RecordingError: the file cannot be written, or ``metadata`` uses the name ``ur5_twin``.
    """
    path = Path(path)
    if metadata and KEY in metadata:
        raise RecordingError(f"{path.name}: metadata must not use the name '{KEY}'")
    header = _Header(
        schema=SCHEMA,
        source=recording.source,
        format=recording.format,
        devices=tuple(_describe(name, table) for name, table in recording.tables.items()),
        notes=tuple(_Note(note.where, note.what, note.repaired) for note in recording.notes),
    )
    entries = {**(metadata or {}), KEY: msgspec.json.encode(header).decode()}
    try:
        with replacing(path) as temporary:
            _frame(recording).write_parquet(temporary, metadata=entries)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror or error})") from None
    return path


def read_parquet_metadata(path: Path | str) -> dict[str, str]:
    """The key-value metadata that ``write_parquet`` was given.

    Raises:
        RecordingError: the file is damaged or not one of ours.
    """
    path = Path(path)
    entries = _entries(_bytes(path), path.name)
    _header(entries, path.name)
    return {key: value for key, value in entries.items() if key not in (KEY, "ARROW:schema")}


def read_parquet(path: Path, *, repair: bool = False) -> Recording:
    """Read a Parquet file of ours.

    Args:
        path: the file.
        repair: take numbers whose checksum differs, and drop rows that are broken, with a note each.

    Raises:
        RecordingError: the file is damaged or not one of ours, or something in it is broken and ``repair`` is off.
    """
    import polars as pl

    raw = _bytes(path)
    header = _header(_entries(raw, path.name), path.name)
    # Polars reports some damage as a panic, which is no Exception.
    try:
        frame = pl.read_parquet(io.BytesIO(raw))
    except (Exception, pl.exceptions.PanicException) as error:
        raise _damaged(path.name, error) from None
    notes = [Note(note.where, note.what, note.repaired) for note in header.notes]
    tables: dict[str, Table] = {}
    start = 0
    for device in header.devices:
        table = _table(frame, device, start, path.name)
        where = f"{path.name}/{device.name}"
        if _crc32(table) != device.crc32:
            if not repair:
                raise RecordingError(
                    f"{path.name}: the numbers of device '{device.name}' differ from their checksum: the file was "
                    "damaged or edited; write it again, or --repair (repair=True) takes them as they are"
                )
            notes.append(Note(where, "the numbers differ from their checksum: taken as they are", True))
        rows = np.arange(start, start + device.rows) + 1
        table, found = checks.settle(table, where, rows, repair=repair, repeats=device.name in _REPEATING)
        notes.extend(found)
        tables[device.name] = table
        start += device.rows
    if start != len(frame):
        raise RecordingError(f"{path.name}: {len(frame)} rows where its metadata has {start}: the file was edited")
    return Recording(tables, header.source, header.format, tuple(notes))


def _describe(name: str, table: Table) -> _Device:
    widths = {column: values.shape[1] for column, values in table.columns.items()}
    return _Device(name, len(table), widths, table.host_start, _crc32(table))


def _crc32(table: Table) -> int:
    crc = zlib.crc32(np.asarray(table.time, dtype="<f8").tobytes())
    for values in table.columns.values():
        crc = zlib.crc32(np.asarray(values, dtype="<f8").tobytes(), crc)
    return crc


def _frame(recording: Recording) -> pl.DataFrame:
    import polars as pl

    frames = []
    for device, table in recording.tables.items():
        series = {"device": pl.repeat(device, len(table), dtype=pl.String, eager=True), "time": _series(table.time)}
        for name, values in table.columns.items():
            series.update({f"{name}_{i}": _series(values[:, i]) for i in range(values.shape[1])})
        frames.append(pl.DataFrame(series))
    return pl.concat(frames, how="diagonal")


def _series(values: np.ndarray) -> pl.Series:
    import polars as pl

    return pl.Series(np.ascontiguousarray(values, dtype=np.float64), dtype=pl.Float64)


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path.name}: cannot be read ({error.strerror or error})") from None


def _entries(raw: bytes, name: str) -> dict[str, str]:
    import polars as pl

    try:
        return pl.read_parquet_metadata(io.BytesIO(raw))
    except (Exception, pl.exceptions.PanicException) as error:
        raise _damaged(name, error) from None


def _header(entries: Mapping[str, str], name: str) -> _Header:
    if KEY not in entries:
        raise RecordingError(
            f"{name}: a Parquet file, but not one of ours: its metadata has no entry '{KEY}'; "
            "write recordings with ur5_twin.recording.write_parquet"
        )
    try:
        header = msgspec.json.decode(entries[KEY], type=_Header)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RecordingError(f"{name}: the entry '{KEY}' of its metadata is damaged ({error})") from None
    if header.schema != SCHEMA:
        raise RecordingError(
            f"{name}: written in schema {header.schema}, this version reads {SCHEMA}: use a newer ur5-twin"
        )
    sizes = [size for device in header.devices for size in (device.rows, *device.columns.values())]
    if min(sizes, default=0) < 0:
        raise RecordingError(f"{name}: the entry '{KEY}' of its metadata is damaged (a negative size)")
    return header


def _table(frame: pl.DataFrame, device: _Device, start: int, name: str) -> Table:
    """The rows of one device."""
    import polars as pl

    wanted = ["time", *(f"{column}_{i}" for column, width in device.columns.items() for i in range(width))]
    missing = [column for column in ("device", *wanted) if column not in frame.columns]
    wrong = [column for column in wanted if column not in missing and frame.schema[column] != pl.Float64]
    if missing or wrong:
        raise RecordingError(
            f"{name}: device '{device.name}' should have column '{(missing or wrong)[0]}' of 64-bit floats; "
            "the file was damaged or edited"
        )
    part = frame[start : start + device.rows]
    if len(part) != device.rows or not (part["device"] == device.name).all():
        raise RecordingError(
            f"{name}: device '{device.name}' should have the rows {start + 1} to {start + device.rows}; "
            "the file was damaged or edited"
        )
    columns = {
        column: np.column_stack([part[f"{column}_{i}"].to_numpy() for i in range(width)])
        if width
        else np.empty((device.rows, 0))
        for column, width in device.columns.items()
    }
    return Table(device.name, part["time"].to_numpy().copy(), columns, device.host_start)


def _damaged(name: str, error: BaseException) -> RecordingError:
    reason = " ".join(str(error).split())[:120]
    return RecordingError(f"{name}: the Parquet file is damaged or cut off ({reason}); make it again from its source")
