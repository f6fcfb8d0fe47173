"""The robot's clock as it arrives over a network, made one time that only goes forward."""

from __future__ import annotations

from dataclasses import dataclass

#: Controllers' ticks, s, and the step of stamps below which it is the shorter one.
_PERIODS, _BETWEEN = (0.002, 0.008), 0.005
#: A step of the stamps that is longer than the host's by so much is a clock that was set, s.
_SET = 5.0
#: More than so many periods between two rows is one too many.
_LATE = 1.5


@dataclass
class Counts:
    """What became of the rows.

    Attributes:
        rows: taken.
        lost: ticks that never came, by the stamps.
        late: rows that came more than half a period late after the one before.
        repeated: rows whose stamp had come already.
        not_numbers: rows with a value that is none.
        jumps: of the robot's clock: a restarted controller, a clock that was set.
        reconnects: times the connection was lost and found again.
    """

    rows: int = 0
    lost: int = 0
    late: int = 0
    repeated: int = 0
    not_numbers: int = 0
    jumps: int = 0
    reconnects: int = 0


class Clock:
    """Stamps in, time out.

    The time is the robot's stamp, until that jumps: back, since the controller was started anew, or far ahead. From
    there on it is the stamp with an offset that lets the time go on as the host's clock did.

    Attributes:
        counts: of what it has seen.
        period: the robot's tick, s; None before two rows.
        said: what the last row made worth a note; None if nothing.
    """

    def __init__(self) -> None:
        self.counts = Counts()
        self.period: float | None = None
        self.said: str | None = None
        self._stamp = self._host = self._offset = 0.0
        self._begun = False

    def take(self, stamp: float, host: float) -> float | None:
        """Time of a row, s; None if it has come before.

        Args:
            stamp: the robot's, s.
            host: when it came, s.
        """
        self.said = None
        if not self._begun:
            self._begun, self._stamp, self._host = True, stamp, host
            self.counts.rows += 1
            return stamp
        step, waited = stamp - self._stamp, max(host - self._host, 0.0)
        if step == 0.0:
            self.counts.repeated += 1
            return None
        period = self.period or _PERIODS[-1]
        if step < 0.0 or step > waited + _SET:
            self.counts.jumps += 1
            # As long as the host says, but not less than a tick.
            passed = max(waited, period)
            self.said = (
                f"the robot's clock went from {self._stamp:.3f} to {stamp:.3f} s within {waited:.3f} s: "
                f"{'was the controller started anew?' if step < 0.0 else 'it was set'}; the recording goes on in time"
            )
            self._offset += self._stamp + passed - stamp
        else:
            if self.period is None or step < 0.75 * self.period:
                self.period = _PERIODS[0] if step < _BETWEEN else _PERIODS[1]
                period = self.period
            missing = round(step / period) - 1
            if missing > 0:
                self.counts.lost += missing
                if step > 0.1:
                    self.said = f"{missing} rows did not come before {stamp:.3f} s"
            elif waited > _LATE * period:
                self.counts.late += 1
        self._stamp, self._host = stamp, host
        self.counts.rows += 1
        return stamp + self._offset
