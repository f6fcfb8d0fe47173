"""The lab's test stand (thesis section 4.4): robot, force sensor and accelerometer recorded in parallel.

Each device is received in a thread of its own; one loop takes what has come and appends it to a journal. Every row
keeps its device's own stamp and the host's time of its arrival, so that the clocks can be brought together afterwards.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from ur5_twin.errors import RecordingError, WireError
from ur5_twin.live.watch import ARRIVAL, STAMP, Watch
from ur5_twin.recording import checks, write_lab_csv, write_parquet
from ur5_twin.recording.journal import Journal, read_journal
from ur5_twin.recording.reading import JOURNAL_FILE, RECORDING_FILE
from ur5_twin.recording.table import Note, Recording, Table
from ur5_twin.sources.device import Rows

#: The lab's layout in the output folder.
LAB_FOLDER = "log"
#: A sensor's own stamp beside its time, which never goes back.
DEVICE_STAMP = "device_stamp"
FORMAT = "record"
#: Between two looks at what has come, two times at which the journal is made safe against a power cut, and two status
#: lines, s.
_STEP, _SAFE, _TELL = 0.02, 2.0, 0.5
#: The rate of a device is that of its rows of the last so many seconds.
_RATE = 2.0
#: What a clock gained is told by its fastest rows in the first and last so many seconds.
_ENDS = 5.0
#: A clock that gained less than this over a recording is worth no word, s.
_GAIN = 1e-3
_WHO = "record"


class Stream(Protocol):
    """A live source as the stand uses it (``sources.link.Link``)."""

    connected: bool

    @property
    def device(self) -> str: ...
    def describe(self) -> str: ...
    def rows(self) -> list[Rows]: ...
    def news(self) -> list[str]: ...
    def close(self) -> None: ...


class Task(Protocol):
    """Something that goes on beside a recording."""

    def step(self, now: float, newest: Mapping[str, np.ndarray] | None) -> str | None:
        """Do what is due.

        Args:
            now: the host's monotonic clock, s.
            newest: the robot's newest row; None before any.

        Returns:
            What happened, for the notes; None for nothing.
        """
        ...

    @property
    def finished(self) -> bool:
        """Whether nothing more is to come."""
        ...

    def close(self) -> None:
        """End it, at whatever point it is."""
        ...


@dataclass(frozen=True)
class DeviceStatus:
    """How a device goes.

    Attributes:
        device: its table.
        connected: whether it is there now.
        rate: rows a second.
        rows: kept so far.
        lost: rows that it sent and that never came.
        disturbed: rows repeated or broken, and jumps of its clock.
    """

    device: str
    connected: bool
    rate: float
    rows: int
    lost: int
    disturbed: int


class TestStand:
    """Records some devices into one folder.

    Args:
        devices: what connects to each and gives its stream, started, by what a message calls it (``--ft 10.0.0.3``).
        folder: where the recording goes; it must hold none.
        name: what the recording is called.

    Raises:
        WireError: there is no device.
        RecordingError: there is a recording already.
    """

    #: pytest takes classes of this name for tests.
    __test__ = False

    def __init__(self, devices: Mapping[str, Callable[[], Stream]], folder: Path, *, name: str) -> None:
        if not devices:
            raise WireError("nothing to record: give the robot's HOST, --ft or --imu")
        self.folder, self.name = folder, name
        _check_folder(folder)
        self._devices = dict(devices)
        self._streams: list[Stream] = []
        self._posix = time.time() - time.monotonic()
        self._watches: dict[str, Watch] = {}
        self._recent: dict[str, deque[tuple[float, int]]] = {}
        self._journal: Journal | None = None
        self._safe = 0.0
        self._newest: dict[str, np.ndarray] | None = None
        self._columns: dict[str, tuple[str, ...]] = {}

    def connect(self) -> None:
        """Connect to all devices; what they report from then on is thrown away until ``run``.

        Raises:
            WireError: one cannot be reached; the message says which, and none is left connected.
        """
        try:
            for label, connect in self._devices.items():
                try:
                    self._streams.append(connect())
                except WireError as error:
                    raise WireError(f"{label}: {error}") from None
        except BaseException:
            self.disconnect()
            raise
        self._watches = {stream.device: Watch(self._posix) for stream in self._streams}
        self._recent = {device: deque() for device in self._watches}

    def disconnect(self) -> None:
        """Leave all devices; what they reported until then can still be taken."""
        for stream in self._streams:
            stream.close()

    def describe(self) -> list[str]:
        """The devices in words, once connected."""
        return [stream.describe() for stream in self._streams]

    def newest(self, within: float = 3.0) -> Mapping[str, np.ndarray]:
        """The robot's next row, before the recording begins.

        Raises:
            WireError: there is no robot, or it sends nothing.
        """
        end = time.monotonic() + within
        self._newest = None
        while self._newest is None:
            if time.monotonic() > end:
                raise WireError(f"no row of the robot within {within:g} s")
            for stream in self._streams:
                for rows in stream.rows():
                    if stream.device == "robot":
                        self._remember(rows)
            time.sleep(_STEP)
        return self._newest

    def run(
        self,
        *,
        stop: threading.Event,
        duration: float | None = None,
        task: Task | None = None,
        tell: Callable[[Sequence[DeviceStatus], Sequence[str]], object] | None = None,
    ) -> None:
        """Record until ``stop`` is set, ``duration`` seconds are over, or the task is finished; then disconnect.

        Args:
            stop: whoever sets it ends the recording.
            duration: s.
            task: goes on meanwhile; it is closed at the end.
            tell: called twice a second with how it goes and what has happened since.

        Raises:
            RecordingError: the journal cannot be written; what came before is in it.
        """
        try:
            self._open()
            end = None if duration is None else time.monotonic() + duration
            told, news = 0.0, list[str]()
            while not stop.is_set():
                now = time.monotonic()
                if end is not None and now >= end:
                    break
                news += self._take()
                if task is not None:
                    happened = task.step(now, self._newest)
                    if happened:
                        news.append(happened)
                        self.note(happened)
                    if task.finished and end is None:
                        break
                if tell is not None and now - told >= _TELL:
                    told = now
                    tell(self.status(), news)
                    news = []
                if now - self._safe >= _SAFE:
                    self._make_safe(now)
                stop.wait(max(0.0, _STEP - (time.monotonic() - now)))
        finally:
            self._end(task, tell)

    def note(self, what: str) -> None:
        """Keep a sentence with the recording."""
        assert self._journal is not None
        self._journal.note(Note(_WHO, what))

    def status(self) -> list[DeviceStatus]:
        """How each device goes."""
        found, now = [], time.monotonic()
        for stream in self._streams:
            device = stream.device
            counts, recent = self._watches[device].counts, self._recent[device]
            while recent and recent[0][0] < now - _RATE:
                recent.popleft()
            rate = sum(n for _, n in recent) / _RATE
            # A sensor numbers what it sends and so knows better than its stamps do.
            lost = getattr(stream, "lost", counts.lost)
            disturbed = counts.repeated + counts.broken + counts.jumps
            found.append(DeviceStatus(device, stream.connected, rate, counts.rows, lost, disturbed))
        return found

    def finish(self, metadata: Mapping[str, str] | None = None) -> Recording:
        """Make Parquet and the lab's layout of the journal, which is then removed.

        Args:
            metadata: for the Parquet file.

        Returns:
            The recording; its notes say so if the lab's layout cannot hold it.

        Raises:
            WireError: no row ever came.
            RecordingError: the recording cannot be written; the journal stays.
        """
        assert self._journal is not None
        path = self._journal.path
        if not any(watch.counts.rows for watch in self._watches.values()):
            path.unlink()
            raise WireError(f"{self.name}: no row came of any device, so there is no recording")
        recording = finished(read_journal(path))
        try:
            write_lab_csv(for_lab(recording), self.folder / LAB_FOLDER)
        except RecordingError as error:
            recording = recording.with_notes([Note(_WHO, f"not written in the lab's layout: {error}")])
        write_parquet(recording, self.folder / RECORDING_FILE, metadata)
        path.unlink()
        return recording

    def _open(self) -> None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(f"{self.folder}: cannot be made ({error.strerror or error})") from None
        self._journal = Journal(self.folder / JOURNAL_FILE, source=self.name)
        for stream in self._streams:
            stream.rows()
            self._journal.note(Note(_WHO, f"from {stream.describe()}"))
        self._safe = time.monotonic()

    def _take(self) -> list[str]:
        """Append what has come; what has happened to the connections."""
        assert self._journal is not None
        news = []
        for stream in self._streams:
            for rows in stream.rows():
                table = self._admitted(stream.device, rows)
                if len(table):
                    start = self._watches[stream.device].host_start
                    self._journal.append(stream.device, table.time, table.columns, host_start=start)
            for what in stream.news():
                self.note(f"{stream.device}: {what}")
                news.append(f"{stream.device}: {what}")
        return news

    def _admitted(self, device: str, rows: Rows) -> Table:
        """The sound rows, under the columns of the device's first ones."""
        columns = self._columns.setdefault(device, tuple(rows.columns))
        gone = [name for name in columns if name not in rows.columns]
        if gone:
            raise WireError(f"the {device} no longer publishes {', '.join(gone)}; start again for a recording without")
        rows = rows._replace(columns={name: rows.columns[name] for name in columns})
        if device == "robot":
            self._remember(rows)
        watch = self._watches[device]
        jumps = watch.counts.jumps
        table = replace(watch.admit(rows), device=device)
        if watch.counts.jumps > jumps:
            self.note(
                f"{device}: its clock jumped; from {table.time[-1]:.3f} s on its time goes on by the host's clock"
            )
        if device != "robot":
            names = {name: DEVICE_STAMP if name == STAMP else name for name in table.columns}
            table = replace(table, columns={names[name]: values for name, values in table.columns.items()})
        self._recent[device].append((time.monotonic(), len(table)))
        return table

    def _remember(self, rows: Rows) -> None:
        if rows:
            self._newest = {name: values[-1] for name, values in rows.columns.items()}

    def _make_safe(self, now: float) -> None:
        """What a power cut may not take: the rows, and what is known of the clocks by now."""
        assert self._journal is not None
        self._safe = now
        for device, watch in self._watches.items():
            if watch.counts.rows and watch.host_start is not None:
                self._journal.set_host_start(device, watch.host_start)
        self._journal.flush()

    def _end(self, task: Task | None, tell: Callable[[Sequence[DeviceStatus], Sequence[str]], object] | None) -> None:
        try:
            if task is not None:
                task.close()
        finally:
            self.disconnect()
            if self._journal is not None:
                try:
                    # What the devices have until here still counts.
                    news = self._take()
                    for status in self.status():
                        self._last_words(status)
                    if tell is not None:
                        tell(self.status(), news)
                finally:
                    self._journal.close()

    def _last_words(self, status: DeviceStatus) -> None:
        counts = self._watches[status.device].counts
        said = (
            (status.lost, "rows that it sent never came"),
            (counts.late if status.device == "robot" else 0, "rows came late"),
            (counts.repeated, "rows with the stamp of the row before, left out"),
            (counts.broken, "rows with a number that is not finite, left out"),
        )
        for count, what in said:
            if count:
                self.note(f"{status.device}: {count:,} {what}")
        if not status.rows:
            self.note(f"{status.device}: no row came")


def finished(recording: Recording) -> Recording:
    """A journal's recording with its rows checked, and each clock's beginning on the host's by all of its rows.

    A device's clock and the host's run apart; a recording holds one offset. It is the mean of those at the recording's
    two ends, each told by the fastest of some seconds of rows, and how far they are apart is noted.
    """
    tables, notes = {}, list(recording.notes)
    for device, table in recording.tables.items():
        rows = np.arange(len(table)) + 1
        table, found = checks.settle(table, device, rows, repair=True, repeats=device != "robot")
        notes += found
        notes += checks.clock_notes(table, device) if device == "robot" else checks.sensor_notes(table, device)
        if ARRIVAL in table:
            table, lost = _on_host(table)
            if abs(lost) > _GAIN:
                span = float(table.time[-1] - table.time[0])
                notes.append(
                    Note(
                        device,
                        f"its clock {'lost' if lost > 0.0 else 'gained'} {1e3 * abs(lost):.1f} ms on the host's in "
                        f"{span:.0f} s ({1e6 * abs(lost) / span:.0f} ppm): its offset is right in the middle",
                    )
                )
        tables[device] = table
    return Recording(tables, recording.source, FORMAT, tuple(notes))


def _on_host(table: Table) -> tuple[Table, float]:
    """The table with its clock's beginning on the host's, and what its clock lost on the host's, s."""
    behind = table[ARRIVAL][:, 0] - table.time
    first = float(behind[table.time <= table.time[0] + _ENDS].min())
    last = float(behind[table.time >= table.time[-1] - _ENDS].min())
    return replace(table, host_start=0.5 * (first + last)), last - first


def for_lab(recording: Recording) -> Recording:
    """The recording as the lab's layout tells it: the robot's clock begins at 0, the IMU's zero is the robot's.

    The layout has a host time for robot and force sensor; its reader takes the IMU's zero for the robot's.
    """
    tables = dict(recording.tables)
    robot = recording.robot
    offset = {device: recording.offset(device) or 0.0 for device in tables}
    for device, table in tables.items():
        # By the robot's clock, its first row at 0.
        zero = float(robot.time[0]) - offset[device] if device == "imu" else float(table.time[0])
        start = None if table.host_start is None else table.host_start + zero
        tables[device] = replace(table, time=table.time - zero, host_start=start)
    return replace(recording, tables=tables)


def _check_folder(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise RecordingError(f"--out {folder} is a file; give a folder")
    for name in (RECORDING_FILE, JOURNAL_FILE, LAB_FOLDER):
        if (folder / name).exists():
            raise RecordingError(f"{folder / name} exists already, and what was measured is never written over")
