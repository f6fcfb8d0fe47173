"""A robot's rows as they arrive: put on a clock that only goes forward, what is wrong with them counted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ur5_twin.recording.table import Table
from ur5_twin.sources.device import Rows
from ur5_twin.twin.lockstep import LONGEST_GAP

#: A row that comes so many periods later after the one before it than its stamp says is late.
_LATE = 0.75
#: Stamps that differ by less are the same, s.
_SAME = 1e-6
#: The shortest tick any controller has, s.
_SHORTEST = 0.002
#: A stamp that is ahead of what the host's clock allows by more than this is a jump, s.
_AHEAD = 1.0
#: After a jump the clock goes on by what the host's did, but at least by this, s: twin and estimators begin again.
_AFTER_A_JUMP = 2.0 * LONGEST_GAP
#: The two clocks may drift apart: the least delay is looked for among the rows of this long, twice, s.
_WINDOW = 5.0
#: A raw stamp beside the time that never jumps, and when the row was in by the host's clock (POSIX, s).
STAMP, ARRIVAL = "controller_stamp", "host_arrival"


@dataclass
class Counts:
    """What has come so far, and what was wrong with it.

    Attributes:
        rows: good ones.
        lost: ticks of the controller that never came, silences aside.
        late: rows that came three quarters of a period or more too late after the row before.
        repeated: rows that had the stamp of the row before; left out.
        broken: rows with a number that is not finite; left out.
        jumps: of the controller's clock, back (it was started again) or ahead.
        silences: of more than half a second.
        silent: how long they were together, s.
    """

    rows: int = 0
    lost: int = 0
    late: int = 0
    repeated: int = 0
    broken: int = 0
    jumps: int = 0
    silences: int = 0
    silent: float = 0.0


class Watch:
    """Lets sound rows through, on a clock that never goes back.

    The time of a row is the controller's stamp. After a jump of the controller's clock it goes on, on the controller's
    stamps again, from where the host's clock says, and at least a second after the row before.

    Args:
        posix: POSIX time at zero of the host's monotonic clock, s.
        period: the controller's, s; from the rows if not given.

    Attributes:
        counts: what has come.
        period: of the controller, s; NaN before it is known.
    """

    def __init__(self, posix: float, period: float | None = None) -> None:
        self.counts = Counts()
        self.period = math.nan if period is None else period
        self._told = period is not None
        self._posix = posix
        self._offset = 0.0
        self._stamp = self._time = self._arrival = math.nan
        # Stamp less arrival, at most: of the rows that came as fast as any.
        self._best, self._best_now, self._since = -math.inf, -math.inf, -math.inf

    def admit(self, rows: Rows) -> Table:
        """The sound ones of some rows: time, and the columns with ``STAMP`` and ``ARRIVAL`` beside them."""
        finite = np.isfinite(rows.time)
        for values in rows.columns.values():
            finite &= np.isfinite(values).all(axis=1)
        self.counts.broken += int((~finite).sum())
        kept, times = [], []
        for k in np.flatnonzero(finite).tolist():
            time = self._admit(float(rows.time[k]), float(rows.arrival[k]))
            if time is not None:
                kept.append(k)
                times.append(time)
        self.counts.rows += len(kept)
        beside = {STAMP: rows.time[kept][:, None], ARRIVAL: rows.arrival[kept][:, None] + self._posix}
        columns = {name: values[kept] for name, values in rows.columns.items()} | beside
        return Table("robot", np.array(times), columns)

    @property
    def host_start(self) -> float | None:
        """POSIX time at which the clock of the last rows was zero, s, by the fastest of them; None before any."""
        return None if math.isinf(self._best) else self._posix - self._best - self._offset

    def _admit(self, stamp: float, arrival: float) -> float | None:
        """Time of a row on the clock that never goes back; None for a row that repeats the last."""
        counts = self.counts
        if math.isnan(self._stamp):
            return self._take(stamp, arrival, stamp)
        step = stamp - self._stamp
        if 0.0 <= step < _SAME:
            counts.repeated += 1
            return None
        if step < 0.0 or stamp - arrival - self._best > _AHEAD:
            counts.jumps += 1
            time = self._time + max(arrival - self._arrival, _AFTER_A_JUMP)
            self._offset = time - stamp
            self._best = self._best_now = -math.inf
            return self._take(stamp, arrival, time)
        if not self._told and (math.isnan(self.period) or step < 0.9 * self.period):
            self.period = max(round(step, 4), _SHORTEST)
        if step > LONGEST_GAP:
            counts.silences += 1
            counts.silent += step
        elif step > 1.5 * self.period:
            counts.lost += round(step / self.period) - 1
        if arrival - self._arrival - step > _LATE * self.period:
            counts.late += 1
        return self._take(stamp, arrival, stamp + self._offset)

    def _take(self, stamp: float, arrival: float, time: float) -> float:
        if arrival - self._since > _WINDOW:
            self._best, self._best_now, self._since = self._best_now, -math.inf, arrival
        self._best_now = max(self._best_now, stamp - arrival)
        self._best = max(self._best, self._best_now)
        self._stamp, self._arrival, self._time = stamp, arrival, time
        return time
