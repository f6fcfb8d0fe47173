"""A recording while it is made: a file that only grows, and that can be read whenever its writer is killed.

After ten bytes of magic come blocks: kind (one byte), length and CRC-32 of what follows (two little-endian uint32), and
that. ``H`` is JSON with schema and source; ``S`` JSON with a device's name, host start, columns and widths; ``D`` one
byte with the device's number in the order of the ``S`` blocks, a uint32 with the number of rows, and those as float64,
little-endian: time, then column by column; ``N`` JSON with a note. A block that is cut off or whose checksum differs
ends what is read.
"""

from __future__ import annotations

import os
import struct
import time
import zlib
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

import msgspec
import numpy as np

from ur5_twin.errors import RecordingError
from ur5_twin.recording import checks
from ur5_twin.recording.table import Note, Recording, Table

MAGIC = b"UR5TWIN-J\n"
#: The journal in a folder of ``ur5-twin live`` or ``record``.
JOURNAL_FILE = "recording.journal"
FORMAT = "journal"
SCHEMA = 1
_BLOCK = struct.Struct("<cII")
_DATA = struct.Struct("<BI")
#: Rows wait in memory no longer than this, s.
_FLUSH = 0.5
#: Devices whose clocks may repeat stamps.
_SENSORS = ("ft", "imu")


class _Header(msgspec.Struct, frozen=True):
    schema: int
    source: str


class _Device(msgspec.Struct, frozen=True):
    name: str
    columns: dict[str, int]
    host_start: float | None


class _Note(msgspec.Struct, frozen=True):
    where: str
    what: str


class Journal:
    """The file, being written.

    Rows reach the file half a second after they were given at the latest, and the disk (``fsync``) at ``close``: what a
    kill of the process costs is half a second, what a power cut costs is up to the operating system.

    Args:
        path: the file; it must not exist.
        source: what the recording is called.

    Raises:
        RecordingError: it exists, or cannot be written.
    """

    def __init__(self, path: Path | str, *, source: str) -> None:
        self.path = Path(path)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("xb")
        except FileExistsError:
            raise RecordingError(f"{self.path}: there is a recording already; give another folder (--out)") from None
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be written ({error.strerror or error})") from None
        self._devices: dict[str, _Device] = {}
        self._waiting: dict[str, list[tuple[np.ndarray, Mapping[str, np.ndarray]]]] = {}
        self._flushed = time.monotonic()
        self.rows: dict[str, int] = {}
        self._file.write(MAGIC)
        self._write(b"H", msgspec.json.encode(_Header(SCHEMA, source)))
        self._file.flush()

    def begin(self, device: str, columns: Mapping[str, int], host_start: float | None = None) -> None:
        """Announce a device.

        Args:
            device: ``robot``, ``ft`` or ``imu``.
            columns: name -> width.
            host_start: POSIX time in s of the host's clock at the device's time 0, if it is known.

        Raises:
            RecordingError: it was announced before.
        """
        if device in self._devices:
            raise RecordingError(f"{self.path.name}: device '{device}' has begun already")
        self._devices[device] = _Device(device, dict(columns), host_start)
        self._waiting[device], self.rows[device] = [], 0
        self._write(b"S", msgspec.json.encode(self._devices[device]))

    def append(self, device: str, time: np.ndarray, columns: Mapping[str, np.ndarray]) -> None:
        """Add rows of a device: times (n,) s on its clock, and its columns (n, width).

        Raises:
            RecordingError: the device was not announced, or its columns are others.
        """
        known = self._devices.get(device)
        if known is None or columns.keys() != known.columns.keys():
            raise RecordingError(
                f"{self.path.name}: device '{device}' has not begun"
                if known is None
                else f"{self.path.name}: device '{device}' began with other columns ({', '.join(known.columns)})"
            )
        self._waiting[device].append((time, columns))
        self.rows[device] += len(time)
        self.flush_if_due()

    def note(self, where: str, what: str) -> None:
        """Add a finding, for the recording's notes."""
        self._write(b"N", msgspec.json.encode(_Note(where, what)))

    def flush_if_due(self) -> None:
        """Bring what has waited long enough to the file."""
        if time.monotonic() - self._flushed >= _FLUSH:
            self.flush()

    def flush(self) -> None:
        """Bring all rows to the file."""
        self._flushed = time.monotonic()
        for number, (device, pieces) in enumerate(self._waiting.items()):
            if not pieces:
                continue
            stamps = np.concatenate([piece[0] for piece in pieces])
            body = [_DATA.pack(number, len(stamps)), np.asarray(stamps, dtype="<f8").tobytes()]
            for name, width in self._devices[device].columns.items():
                values = np.concatenate([np.reshape(piece[1][name], (-1, width)) for piece in pieces])
                body.append(np.ascontiguousarray(values, dtype="<f8").tobytes())
            self._write(b"D", b"".join(body))
            pieces.clear()
        try:
            self._file.flush()
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be written ({error.strerror or error})") from None

    def close(self) -> None:
        """Bring all to the disk; after that nothing more can be added."""
        if self._file.closed:
            return
        self.flush()
        os.fsync(self._file.fileno())
        self._file.close()

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self.close()

    def _write(self, kind: bytes, body: bytes) -> None:
        # One write a block: a kill cuts between blocks wherever the system does not split a write.
        try:
            self._file.write(_BLOCK.pack(kind, len(body), zlib.crc32(body)) + body)
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be written ({error.strerror or error})") from None


def read_journal(path: Path | str, *, repair: bool = False) -> Recording:
    """Read a journal, also one that is still being written or whose writer was killed.

    Args:
        path: the file.
        repair: drop rows that are broken, with a note each.

    Raises:
        RecordingError: it is none, holds no row of the robot, or something in it is broken and ``repair`` is off.
    """
    path = Path(path)
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path.name}: cannot be read ({error.strerror or error})") from None
    if not raw.startswith(MAGIC):
        raise RecordingError(f"{path.name}: not a journal of ur5-twin")
    source = path.stem
    devices: list[_Device] = []
    parts: list[list[np.ndarray]] = []
    notes: list[Note] = []
    at, complete = len(MAGIC), True
    while at < len(raw):
        block = _block(raw, at)
        if block is None:
            complete = False
            break
        kind, body, at = block
        try:
            if kind == b"H":
                header = msgspec.json.decode(body, type=_Header)
                if header.schema != SCHEMA:
                    raise RecordingError(
                        f"{path.name}: written in schema {header.schema}, this version reads {SCHEMA}: use a newer "
                        "ur5-twin"
                    )
                source = header.source
            elif kind == b"S":
                devices.append(msgspec.json.decode(body, type=_Device))
                parts.append([])
            elif kind == b"N":
                note = msgspec.json.decode(body, type=_Note)
                notes.append(Note(note.where, note.what))
            elif kind == b"D":
                number, rows = _DATA.unpack_from(body)
                width = 1 + sum(devices[number].columns.values())
                values = np.frombuffer(body, dtype="<f8", offset=_DATA.size)
                if len(values) != rows * width:
                    raise ValueError
                parts[number].append(_columns(values, rows, devices[number]))
        except (msgspec.DecodeError, IndexError, ValueError, struct.error):
            raise RecordingError(
                f"{path.name}: a block that makes no sense at byte {at}: the file was edited"
            ) from None
    if not complete:
        left = len(raw) - at
        notes.append(Note(path.name, f"its end is cut off or still being written: {left} bytes left out", True))
    return _recording(path, source, devices, parts, notes, repair)


def _block(raw: bytes, at: int) -> tuple[bytes, bytes, int] | None:
    """Kind, body and end of the block at a place; None if it is not whole."""
    if at + _BLOCK.size > len(raw):
        return None
    kind, length, crc = _BLOCK.unpack_from(raw, at)
    end = at + _BLOCK.size + length
    if end > len(raw):
        return None
    body = raw[at + _BLOCK.size : end]
    return (kind, body, end) if zlib.crc32(body) == crc else None


def _columns(values: np.ndarray, rows: int, device: _Device) -> np.ndarray:
    """Time and all columns of a block side by side (rows, 1 + widths)."""
    found, at = [values[:rows, None]], rows
    for width in device.columns.values():
        found.append(values[at : at + rows * width].reshape(rows, width))
        at += rows * width
    return np.concatenate(found, axis=1)


def _recording(
    path: Path,
    source: str,
    devices: list[_Device],
    parts: list[list[np.ndarray]],
    notes: list[Note],
    repair: bool,
) -> Recording:
    tables: dict[str, Table] = {}
    for device, blocks in zip(devices, parts, strict=True):
        if not blocks:
            continue
        values = np.concatenate(blocks)
        columns, at = {}, 1
        for name, width in device.columns.items():
            columns[name] = np.ascontiguousarray(values[:, at : at + width])
            at += width
        table = Table(device.name, values[:, 0].copy(), columns, device.host_start)
        table, found = checks.settle(
            table,
            f"{path.name}/{device.name}",
            np.arange(len(table)) + 1,
            repair=repair,
            repeats=device.name in _SENSORS,
        )
        notes.extend(found)
        tables[device.name] = table
    if "robot" not in tables:
        raise RecordingError(f"{path.name}: no row of the robot in it (devices: {', '.join(tables) or 'none'})")
    return Recording(tables, source, FORMAT, tuple(notes))
