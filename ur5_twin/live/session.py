"""One run beside a robot: every sound row through twin and estimators, into the ring and into the journal."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ur5_twin.errors import WireError
from ur5_twin.estimation.protocol import Estimator
from ur5_twin.estimation.samples import samples_from, stacked
from ur5_twin.evaluation.estimate_report import estimate_columns
from ur5_twin.live.ring import Ring
from ur5_twin.live.watch import ARRIVAL, Counts, Watch
from ur5_twin.recording import checks, write_parquet
from ur5_twin.recording.journal import Journal, read_journal
from ur5_twin.recording.reading import JOURNAL_FILE, RECORDING_FILE
from ur5_twin.recording.table import Note, Recording, Table
from ur5_twin.sources.device import Rows
from ur5_twin.twin.live import LiveTwin

#: Without these nothing can be said of a row.
_NEEDED = ("actual_q", "actual_qd", "actual_current")
#: Rows whose latency is remembered: some seconds.
_LATENCIES = 4096
#: Between two times at which the journal is made safe against a power cut, s.
_SAFE = 2.0
_NOTED_BY = "live"


@dataclass(frozen=True)
class Status:
    """How it goes, for a line on a terminal.

    Attributes:
        counts: what has come so far.
        rate: rows in the last second.
        latency: s from a row's arrival to its estimate, median and 99th percentile of the last seconds; NaN before any.
        wrench, deviation: of the first estimator, (6,) each; None without one or before any.
        error: (6,) mean size of actual_q less sim_actual_q in the last second, rad; None without a twin.
        restarts: how often the twin began again.
    """

    counts: Counts
    rate: float
    latency: tuple[float, float]
    wrench: np.ndarray | None
    deviation: np.ndarray | None
    error: np.ndarray | None
    restarts: int


class Session:
    """What a live run makes of a robot's rows.

    The columns are those of the first rows: a signal that comes later is left out. Rows go to the estimators just as
    they are recorded, so that an estimator says the same of the recording.

    Args:
        name: what the recording is called.
        estimators: by name, new.
        twin: the twin; None for none.
        folder: where the journal goes, and the recording in the end; None keeps nothing but the ring.
        seconds: how much the ring keeps.
        period: of the controller, s, if it is known.

    Attributes:
        watch: what was wrong with the rows so far.
        ring: the last rows with their ``sim_`` and ``est_`` columns; None before the second row.
    """

    def __init__(
        self,
        name: str,
        *,
        estimators: Mapping[str, Estimator] | None = None,
        twin: LiveTwin | None = None,
        folder: Path | None = None,
        seconds: float = 120.0,
        period: float | None = None,
    ) -> None:
        self.name = name
        self.ring: Ring | None = None
        self._posix = time.time() - time.monotonic()
        self.watch = Watch(self._posix, period)
        self._estimators = dict(estimators or {})
        self._failed: dict[str, str] = {}
        self._first = next(iter(self._estimators), None)
        self._twin = twin
        self._folder = folder
        self._journal: Journal | None = None
        self._seconds = seconds
        self._columns: tuple[str, ...] | None = None
        self._notes: list[Note] = []
        self._latencies: deque[float] = deque(maxlen=_LATENCIES)
        self._safe = time.monotonic()
        self._closed = False

    def note(self, what: str) -> None:
        """Keep a sentence on what happened with the recording."""
        note = Note(_NOTED_BY, what)
        self._notes.append(note)
        if self._journal is not None:
            self._journal.note(note)

    @property
    def notes(self) -> Sequence[Note]:
        """What happened so far."""
        return tuple(self._notes)

    def take(self, pieces: Iterable[Rows]) -> Table | None:
        """Take in what the source has; gives the sound rows with all columns, or None if there are none.

        Raises:
            WireError: the robot's rows lack what they had, or what everything needs.
            RecordingError: the journal cannot be written.
            ReplayError: the twin lacks what it follows.
        """
        tables = [self._admitted(rows) for rows in pieces]
        tables = [table for table in tables if len(table)]
        if not tables:
            return None
        table = _joined(tables)
        columns = dict(table.columns)
        if self._twin is not None:
            columns |= self._twin.follow(table.time, table.columns)
        for name in self._estimators:
            columns |= self._estimated(name, table)
        told = time.monotonic()
        self._latencies.extend((told + self._posix - table[ARRIVAL][:, 0]).tolist())
        table = replace(table, columns=columns)
        self._keep(table)
        return table

    def status(self) -> Status:
        """How it goes."""
        recent = self.ring.last(1.0) if self.ring is not None and len(self.ring) else None
        wrench = deviation = error = None
        rate = math.nan
        if recent is not None:
            arrived = recent[ARRIVAL][:, 0]
            # Rows of the last second by the host's clock: of a robot that fell silent there are none.
            rate = float((arrived > time.monotonic() + self._posix - 1.0).sum())
            if self._first is not None:
                wrench, deviation = (recent[f"est_{self._first}_{what}"][-1] for what in ("wrench", "deviation"))
            if "sim_actual_q" in recent:
                off = np.abs(recent["actual_q"] - recent["sim_actual_q"])
                known = np.isfinite(off).all(axis=1)
                error = off[known].mean(axis=0) if known.any() else None
        waits = np.percentile(list(self._latencies), (50.0, 99.0)) if self._latencies else (math.nan, math.nan)
        twin = self._twin
        return Status(
            counts=replace(self.watch.counts),
            rate=rate,
            latency=(float(waits[0]), float(waits[1])),
            wrench=wrench,
            deviation=deviation,
            error=error,
            restarts=0 if twin is None else twin.restarts + twin.failures,
        )

    def close(self) -> None:
        """Finish the journal: what was taken is on the disk then."""
        if self._closed:
            return
        for what in self._last_words():
            self.note(what)
        self._closed = True
        if self._journal is not None:
            self._journal.close()

    def finish(self, metadata: Mapping[str, str] | None = None) -> Path | None:
        """Make the recording of the journal, which is then removed; its path, or None if nothing was to be kept.

        Args:
            metadata: for the file (``write_parquet``).

        Raises:
            WireError: no row ever came.
        """
        self.close()
        if self._folder is None:
            return None
        if self._journal is None:
            raise WireError(f"{self.name}: no sound row came, so there is no recording")
        recording = read_journal(self._journal.path)
        table, found = checks.settle(
            recording.robot, self._journal.path.name, np.arange(len(recording.robot)) + 1, repair=True
        )
        notes = (*recording.notes, *found, *checks.clock_notes(table, _NOTED_BY))
        finished = Recording({"robot": table}, recording.source, "live", notes)
        path = write_parquet(finished, self._folder / RECORDING_FILE, metadata)
        self._journal.path.unlink()
        return path

    def _admitted(self, rows: Rows) -> Table:
        """The sound rows, under the columns of the first rows."""
        missing = [name for name in _NEEDED if name not in rows.columns]
        if missing:
            raise WireError(f"the robot's rows lack {', '.join(missing)}")
        if self._columns is not None:
            gone = [name for name in self._columns if name not in rows.columns]
            if gone:
                raise WireError(f"the robot no longer publishes {', '.join(gone)}; start again for a recording without")
            rows = rows._replace(columns={name: rows.columns[name] for name in self._columns})
        table = self.watch.admit(rows)
        if self._columns is None and len(table):
            self._columns = tuple(rows.columns)
        return table

    def _estimated(self, name: str, table: Table) -> dict[str, np.ndarray]:
        """The columns of one estimator. One that fails is NaN from there on: the recording goes on without it."""
        rows = []
        if name not in self._failed:
            try:
                update = self._estimators[name].update
                rows = [update(sample) for sample in samples_from(table.time, table.columns)]
            except Exception as error:
                self._failed[name] = f"{type(error).__name__}: {error}"
                self.note(f"estimator {name} failed at {table.time[0]:.3f} s and is left out from there on: {error}")
        found = stacked(table.time[: len(rows)], rows)
        columns = estimate_columns(name, found)
        if rows:
            return columns
        return {column: np.full((len(table), values.shape[1]), np.nan) for column, values in columns.items()}

    def _keep(self, table: Table) -> None:
        if self.ring is None and math.isfinite(self.watch.period):
            self.ring = Ring(max(1, round(self._seconds / self.watch.period)))
        if self.ring is not None:
            self.ring.append(table)
        if self._folder is None:
            return
        if self._journal is None:
            self._folder.mkdir(parents=True, exist_ok=True)
            path = self._folder / JOURNAL_FILE
            self._journal = Journal(path, source=self.name, host_start=self.watch.host_start)
            for note in self._notes:
                self._journal.note(note)
        self._journal.append("robot", table.time, table.columns)
        if time.monotonic() - self._safe > _SAFE:
            self._safe = time.monotonic()
            self._journal.flush()

    def _last_words(self) -> list[str]:
        """What a reader of the recording should know of how it was made."""
        counts = self.watch.counts
        said = [
            f"{count:,} {what}"
            for count, what in (
                (counts.lost, "ticks of the controller that never came"),
                (counts.late, "rows that came late"),
                (counts.repeated, "rows with the stamp of the row before, left out"),
                (counts.broken, "rows with a number that is not finite, left out"),
                (counts.jumps, "jumps of the controller's clock, after each of which the time goes on"),
            )
            if count
        ]
        if counts.silences:
            said.append(f"{counts.silences} silences of {counts.silent:.1f} s together")
        if self._twin is not None and self._twin.failure is not None:
            said.append(
                f"the twin failed {self._twin.failures} times and began again, last because {self._twin.failure}"
            )
        return said

    def facts(self) -> dict[str, object]:
        """What came, for a report."""
        status = self.status()
        return {
            "name": self.name,
            "period_s": None if math.isnan(self.watch.period) else self.watch.period,
            "counts": asdict(status.counts),
            "latency_s": {"median": status.latency[0], "percentile_99": status.latency[1]},
            "twin_restarts": status.restarts,
            "failed_estimators": dict(self._failed),
            "notes": [str(note) for note in self._notes],
        }


def _joined(tables: Sequence[Table]) -> Table:
    if len(tables) == 1:
        return tables[0]
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0].columns}
    return Table("robot", np.concatenate([table.time for table in tables]), columns)
