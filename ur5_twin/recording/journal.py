"""A recording while it is made: a file that only grows, and can be read whenever the process that wrote it is killed.

``MAGIC``, then blocks: length of the body and its CRC-32 as 32-bit integers, then the body, a letter and

- ``H``: JSON with schema and source; the first block;
- ``D``: JSON with a device's name, host start and columns with their widths, before its first rows; counted from 0;
- ``R``: number of the device and of rows (two 32-bit integers), then time and each column, row by row, 64-bit floats;
- ``N``: JSON with a note.

All little-endian. A body that is cut off, or does not have its checksum, ends the file: what comes before it counts.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

import msgspec
import numpy as np

from ur5_twin.errors import RecordingError
from ur5_twin.recording import checks
from ur5_twin.recording.table import Note, Recording, Table

MAGIC = b"UR5TWINJ"
SCHEMA = 1
FORMAT = "journal"
_BLOCK = struct.Struct("<II")
_ROWS = struct.Struct("<II")
#: A body longer than this is no body but damage, bytes.
_LONGEST = 1 << 28


class _Header(msgspec.Struct, frozen=True):
    schema: int
    source: str


class _Device(msgspec.Struct, frozen=True):
    name: str
    host_start: float | None
    columns: dict[str, int]


class _Note(msgspec.Struct, frozen=True):
    where: str
    what: str
    repaired: bool


class Journal:
    """Writes a recording as it is made. What ``append`` has returned from survives the end of this process.

    Args:
        path: the file; there must be none yet.
        source: what the recording is called.
        host_start: POSIX time at zero of the devices' clocks, s: one for all, or by device.

    Raises:
        RecordingError: there is such a file already, or it cannot be written.
    """

    def __init__(
        self, path: Path | str, *, source: str, host_start: float | Mapping[str, float | None] | None = None
    ) -> None:
        self.path = Path(path)
        self._host_start = host_start
        self._devices: dict[str, tuple[int, dict[str, int]]] = {}
        try:
            self._file: BinaryIO | None = self.path.open("xb", buffering=0)
        except FileExistsError:
            raise RecordingError(f"{path}: exists already; a journal is never written over") from None
        except OSError as error:
            raise RecordingError(f"{path}: cannot be written ({error.strerror or error})") from None
        self._write(MAGIC)
        self._block(b"H", msgspec.json.encode(_Header(SCHEMA, source)))

    def append(self, device: str, time: np.ndarray, columns: Mapping[str, np.ndarray]) -> None:
        """Add rows of a device.

        Args:
            device: ``robot``, ``ft`` or ``imu``; its columns are those of its first rows.
            time: (n,) s on its clock.
            columns: name -> (n,) or (n, width).

        Raises:
            RecordingError: the columns are others than before, or the file cannot be written.
        """
        n = len(time)
        values = {name: np.asarray(column, dtype="<f8") for name, column in columns.items()}
        values = {name: column[:, None] if column.ndim == 1 else column for name, column in values.items()}
        if device not in self._devices:
            if n == 0:
                return
            widths = {name: column.shape[1] for name, column in values.items()}
            start = self._host_start
            started = start.get(device) if isinstance(start, Mapping) else start
            self._block(b"D", msgspec.json.encode(_Device(device, started, widths)))
            self._devices[device] = (len(self._devices), widths)
        number, widths = self._devices[device]
        if {name: column.shape[1] for name, column in values.items()} != widths and n:
            raise RecordingError(
                f"{self.path.name}: device '{device}' had the columns {', '.join(widths)} before, "
                f"now {', '.join(values)}; a device's columns stay the same"
            )
        if n:
            table = np.concatenate([np.asarray(time, dtype="<f8")[:, None], *(values[name] for name in widths)], axis=1)
            self._block(b"R", _ROWS.pack(number, n), np.ascontiguousarray(table).data.cast("B"))

    def note(self, note: Note) -> None:
        """Add a note."""
        self._block(b"N", msgspec.json.encode(_Note(note.where, note.what, note.repaired)))

    def flush(self) -> None:
        """Let what was appended survive a power cut too."""
        if self._file is not None:
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Finish the file."""
        if self._file is not None:
            self.flush()
            self._file.close()
            self._file = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _block(self, *parts: bytes | memoryview) -> None:
        crc = 0
        for part in parts:
            crc = zlib.crc32(part, crc)
        self._write(b"".join((_BLOCK.pack(sum(map(len, parts)), crc), *parts)))

    def _write(self, data: bytes) -> None:
        if self._file is None:
            raise RecordingError(f"{self.path}: the journal is closed")
        view = memoryview(data)
        try:
            while view:
                # A full disk may take a part; the rest is tried again and then says so.
                view = view[self._file.write(view) :]
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be written ({error.strerror or error})") from None


def read_journal(path: Path | str) -> Recording:
    """Read a journal, finished or not.

    Args:
        path: the file.

    Returns:
        What was appended; a last block that is cut off is left out, with a note.

    Raises:
        RecordingError: it is no journal, of a newer schema, or holds no rows of a robot.
    """
    path = Path(path)
    try:
        raw = memoryview(path.read_bytes())
    except OSError as error:
        raise RecordingError(f"{path.name}: cannot be read ({error.strerror or error})") from None
    if raw[: len(MAGIC)] != MAGIC:
        raise RecordingError(f"{path.name}: no journal of ours")
    try:
        header, devices, pieces, notes = _blocks(raw, path.name)
    except (msgspec.DecodeError, msgspec.ValidationError, struct.error, ValueError, IndexError) as error:
        raise RecordingError(f"{path.name}: whole, but not what a journal holds ({error})") from None
    tables = {
        device.name: _table(device, np.concatenate(found))
        for device, found in zip(devices, pieces, strict=True)
        if found
    }
    if header is None or "robot" not in tables:
        raise RecordingError(f"{path.name}: the journal ends before the first row of a robot")
    return Recording(tables, header.source, FORMAT, tuple(notes))


def _blocks(raw: memoryview, name: str) -> tuple[_Header | None, list[_Device], list[list[np.ndarray]], list[Note]]:
    """Everything in a journal up to where it is cut off: the header, and per device what it is and its rows."""
    header: _Header | None = None
    devices: list[_Device] = []
    pieces: list[list[np.ndarray]] = []
    notes: list[Note] = []
    at = len(MAGIC)
    while at + _BLOCK.size <= len(raw):
        length, crc = _BLOCK.unpack_from(raw, at)
        body = raw[at + _BLOCK.size : at + _BLOCK.size + length]
        if not 0 < length <= _LONGEST or len(body) < length or zlib.crc32(body) != crc:
            break
        at += _BLOCK.size + length
        kind, rest = bytes(body[:1]), body[1:]
        if kind == b"H":
            header = msgspec.json.decode(rest, type=_Header)
            if header.schema != SCHEMA:
                raise RecordingError(f"{name}: written in schema {header.schema}, this version reads {SCHEMA}")
        elif kind == b"D":
            devices.append(msgspec.json.decode(rest, type=_Device))
            pieces.append([])
        elif kind == b"N":
            note = msgspec.json.decode(rest, type=_Note)
            notes.append(Note(note.where, note.what, note.repaired))
        elif kind == b"R":
            number, n = _ROWS.unpack_from(rest)
            pieces[number].append(np.frombuffer(rest[_ROWS.size :], dtype="<f8").reshape(n, -1))
    if at < len(raw):
        notes.append(Note(name, f"the last {len(raw) - at} bytes are cut off in writing: left out", True))
    return header, devices, pieces, notes


def read_settled(path: Path | str, *, repair: bool = False) -> Recording:
    """Read a journal and check it as every log is checked (``checks.settle``).

    Raises:
        RecordingError: as ``read_journal``, or something in it is broken and ``repair`` is off.
    """
    recording = read_journal(path)
    tables, notes = {}, list(recording.notes)
    for name, table in recording.tables.items():
        where, rows = f"{Path(path).name}/{name}", np.arange(len(table)) + 1
        tables[name], found = checks.settle(table, where, rows, repair=repair, repeats=name != "robot")
        notes += found
    return Recording(tables, recording.source, recording.format, tuple(notes))


def _table(device: _Device, values: np.ndarray) -> Table:
    columns, first = {}, 1
    for name, width in device.columns.items():
        columns[name] = values[:, first : first + width].copy()
        first += width
    return Table(device.name, values[:, 0].copy(), columns, device.host_start)
