"""A recording while it is made: a file that only grows, and can be read whenever the process that wrote it is killed.

``MAGIC``, then blocks: ``MARK``, length of the body and its CRC-32 as 32-bit integers, then the body, a letter and

- ``H``: JSON with schema and source; the first block;
- ``D``: JSON with a device's number, name, host start and columns with their widths, before its first rows;
- ``C``: JSON with a device's name and a host start that is known better by now; the last one counts;
- ``R``: number of the device and of rows (two 32-bit integers), then time and each column, row by row, 64-bit floats;
- ``N``: JSON with a note.

All little-endian. What is cut off at the end is left out with a note. Damage before whole blocks is no accident of
writing but of the disk: it is refused, or with ``repair`` what stands between two marks is left out.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

import msgspec
import numpy as np

from ur5_twin.errors import RecordingError
from ur5_twin.recording import checks
from ur5_twin.recording.grid import REPAIR_HINT
from ur5_twin.recording.table import Note, Recording, Table

MAGIC = b"UR5TWINJ"
MARK = b"\xf1blk"
SCHEMA = 1
FORMAT = "journal"
_BLOCK = struct.Struct("<II")
_FRONT = len(MARK) + _BLOCK.size
_ROWS = struct.Struct("<II")
#: A body longer than this is no body but damage, bytes.
_LONGEST = 1 << 28


class _Header(msgspec.Struct, frozen=True):
    schema: int
    source: str


class _Device(msgspec.Struct, frozen=True):
    number: int
    name: str
    host_start: float | None
    columns: dict[str, int]


class _Clock(msgspec.Struct, frozen=True):
    name: str
    host_start: float


class _Note(msgspec.Struct, frozen=True):
    where: str
    what: str
    repaired: bool


class Journal:
    """Writes a recording as it is made.

    Each ``append`` is one block and one write to the operating system, with no buffer before it: what it has returned
    from survives the end of this process, however it ends. A power cut costs what came after the last ``flush``
    (fsync) and what the disk itself had not kept; ``close`` does one. Who writes often appends some rows at once: a
    block costs 21 bytes and some microseconds. One thread writes; a reader may read at any time.

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

    def append(
        self, device: str, time: np.ndarray, columns: Mapping[str, np.ndarray], *, host_start: float | None = None
    ) -> None:
        """Add rows of a device.

        Args:
            device: ``robot``, ``ft`` or ``imu``; its columns are those of its first rows.
            time: (n,) s on its clock.
            columns: name -> (n,) or (n, width).
            host_start: POSIX time at zero of this device's clock, s, where it was not known before; counts at the
                device's first rows, later ``set_host_start`` tells it.

        Raises:
            RecordingError: the columns are others than before, their lengths differ, or the file cannot be written.
        """
        n = len(time)
        if not n:
            return
        values = {}
        for name, column in columns.items():
            if len(column) != n:
                raise RecordingError(f"{self.path.name}: {n} stamps of '{device}' but {len(column)} rows of '{name}'")
            array = np.asarray(column, dtype="<f8")
            values[name] = array[:, None] if array.ndim == 1 else array
        widths = {name: column.shape[1] for name, column in values.items()}
        if device not in self._devices:
            start = self._host_start
            known = start.get(device) if isinstance(start, Mapping) else start
            number = len(self._devices)
            described = _Device(number, device, known if host_start is None else host_start, widths)
            self._block(b"D", msgspec.json.encode(described))
            self._devices[device] = (number, widths)
        number, before = self._devices[device]
        if widths != before:
            raise RecordingError(
                f"{self.path.name}: device '{device}' had the columns {_described(before)} before, "
                f"now {_described(widths)}; a device's columns stay the same"
            )
        table = np.concatenate([np.asarray(time, dtype="<f8")[:, None], *(values[name] for name in before)], axis=1)
        self._block(b"R", _ROWS.pack(number, n), np.ascontiguousarray(table).data.cast("B"))

    def set_host_start(self, device: str, host_start: float) -> None:
        """Tell POSIX time at zero of a device's clock, s, as it is known by now; the last one told counts."""
        self._block(b"C", msgspec.json.encode(_Clock(device, host_start)))

    def note(self, note: Note) -> None:
        """Add a note: a gap, a connection made again, a jump of a clock."""
        self._block(b"N", msgspec.json.encode(_Note(note.where, note.what, note.repaired)))

    def flush(self) -> None:
        """Let what was appended survive a power cut too.

        Raises:
            RecordingError: the disk does not take it.
        """
        if self._file is not None:
            try:
                os.fsync(self._file.fileno())
            except OSError as error:
                raise RecordingError(f"{self.path}: cannot be written ({error.strerror or error})") from None

    def close(self) -> None:
        """Finish the file; may be called again."""
        if self._file is not None:
            try:
                self.flush()
            finally:
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
        self._write(b"".join((MARK, _BLOCK.pack(sum(map(len, parts)), crc), *parts)))

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


def read_journal(path: Path | str, *, repair: bool = False) -> Recording:
    """Read a journal, finished or not, also while it is written.

    Args:
        path: the file.
        repair: leave out what is damaged between whole blocks, with a note, instead of refusing the file.

    Returns:
        What was appended, as it was; a last block that is cut off is left out, with a note.

    Raises:
        RecordingError: it is no journal, of a newer schema, damaged, or holds no rows.
    """
    path = Path(path)
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path.name}: cannot be read ({error.strerror or error})") from None
    if not raw.startswith(MAGIC):
        raise RecordingError(f"{path.name}: no journal of ours")
    content = _Content(path.name)
    try:
        for kind, rest in _blocks(raw, content, repair):
            content.take(kind, rest)
    except (msgspec.DecodeError, struct.error, ValueError) as error:
        raise RecordingError(f"{path.name}: whole, but not what a journal holds ({error})") from None
    return content.recording()


def read_settled(path: Path | str, *, repair: bool = False) -> Recording:
    """Read a journal and check it as every log is checked (``checks.settle``).

    Raises:
        RecordingError: as ``read_journal``, or something in it is broken and ``repair`` is off.
    """
    recording = read_journal(path, repair=repair)
    tables, notes = {}, list(recording.notes)
    for name, table in recording.tables.items():
        where, rows = f"{Path(path).name}/{name}", np.arange(len(table)) + 1
        tables[name], found = checks.settle(table, where, rows, repair=repair, repeats=name != "robot")
        notes += found
    return Recording(tables, recording.source, recording.format, tuple(notes))


class _Content:
    """What has been read of a journal so far."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.notes: list[Note] = []
        self._header: _Header | None = None
        self._devices: dict[int, _Device] = {}
        self._pieces: dict[int, list[np.ndarray]] = {}
        self._orphans = 0
        self._clocks: dict[str, float] = {}

    def take(self, kind: bytes, rest: memoryview) -> None:
        match kind:
            case b"H":
                self._header = msgspec.json.decode(rest, type=_Header)
                if self._header.schema != SCHEMA:
                    raise RecordingError(
                        f"{self.name}: written in schema {self._header.schema}, this version reads {SCHEMA}: "
                        "use a newer ur5-twin"
                    )
            case b"D":
                device = msgspec.json.decode(rest, type=_Device)
                self._devices[device.number], self._pieces[device.number] = device, []
            case b"C":
                clock = msgspec.json.decode(rest, type=_Clock)
                self._clocks[clock.name] = clock.host_start
            case b"N":
                note = msgspec.json.decode(rest, type=_Note)
                self.notes.append(Note(note.where, note.what, note.repaired))
            case b"R":
                number, n = _ROWS.unpack_from(rest)
                if number not in self._devices:
                    self._orphans += n
                    return
                width = 1 + sum(self._devices[number].columns.values())
                self._pieces[number].append(np.frombuffer(rest[_ROWS.size :], dtype="<f8").reshape(n, width))
            case _:
                raise ValueError(f"a block of the unknown kind {kind!r}")

    def recording(self) -> Recording:
        if self._orphans:
            rows = checks.count(self._orphans, "row")
            self.notes.append(
                Note(self.name, f"{rows} of a device whose columns are in a damaged block: left out", True)
            )
        tables = {
            self._devices[number].name: self._table(self._devices[number], np.concatenate(pieces))
            for number, pieces in self._pieces.items()
            if pieces
        }
        if self._header is None or not tables:
            raise RecordingError(f"{self.name}: the journal ends before the first row of any device")
        return Recording(tables, self._header.source, FORMAT, tuple(self.notes))

    def _table(self, device: _Device, values: np.ndarray) -> Table:
        columns, first = {}, 1
        for name, width in device.columns.items():
            columns[name] = values[:, first : first + width].copy()
            first += width
        start = self._clocks.get(device.name, device.host_start)
        return Table(device.name, values[:, 0].copy(), columns, start)


def _blocks(raw: bytes, content: _Content, repair: bool) -> Iterator[tuple[bytes, memoryview]]:
    """Kind and content of each whole block."""
    at = len(MAGIC)
    while at < len(raw):
        end = _end(raw, at)
        if end is not None:
            body = memoryview(raw)[at + _FRONT : end]
            yield bytes(body[:1]), body[1:]
            at = end
            continue
        following = _next_whole(raw, at + 1)
        if following is None:
            content.notes.append(
                Note(content.name, f"the last {len(raw) - at} bytes are cut off in writing: left out", True)
            )
            return
        what = f"{following - at} bytes from byte {at} on are damaged"
        if not repair:
            raise RecordingError(f"{content.name}: {what}, with whole blocks behind them; {REPAIR_HINT}")
        content.notes.append(Note(content.name, f"{what}: left out", True))
        at = following


def _end(raw: bytes, at: int) -> int | None:
    """Where the block that begins at a place ends; None if no whole one does."""
    if raw[at : at + len(MARK)] != MARK or len(raw) < at + _FRONT:
        return None
    length, crc = _BLOCK.unpack_from(raw, at + len(MARK))
    end = at + _FRONT + length
    if not 0 < length <= _LONGEST or end > len(raw):
        return None
    return end if zlib.crc32(memoryview(raw)[at + _FRONT : end]) == crc else None


def _next_whole(raw: bytes, at: int) -> int | None:
    """Where the next whole block begins."""
    at = raw.find(MARK, at)
    while at >= 0:
        if _end(raw, at) is not None:
            return at
        at = raw.find(MARK, at + 1)
    return None


def _described(widths: Mapping[str, int]) -> str:
    return ", ".join(f"{name} ({width})" for name, width in widths.items())
