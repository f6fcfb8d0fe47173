"""The time law of a way: speed rises at the given acceleration, stays, falls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Rounding of times of up to some minutes, s.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Trapezoid:
    """A way of ``length`` from rate ``start`` to rate ``end``, never faster than ``speed``: the quickest such law.

    The peak is w with w^2 = min(speed^2, acceleration length + (start^2 + end^2) / 2): a trapezoid of speed, or a
    triangle where the way is too short to reach ``speed``. Units are those of the way (rad, m) and s. The planner only
    asks for rates that this way can join.

    Attributes:
        length: of the way, not negative.
        speed, acceleration: bounds, positive.
        start, end: rates at the ends, 0 to ``speed``.
    """

    length: float
    speed: float
    acceleration: float
    start: float = 0.0
    end: float = 0.0

    @property
    def peak(self) -> float:
        """The highest rate."""
        square = self.acceleration * self.length + 0.5 * (self.start**2 + self.end**2)
        return max(min(self.speed, float(np.sqrt(square))), self.start, self.end)

    @property
    def rise(self) -> float:
        """Time of accelerating, s."""
        return (self.peak - self.start) / self.acceleration

    @property
    def fall(self) -> float:
        """Time of braking, s."""
        return (self.peak - self.end) / self.acceleration

    @property
    def duration(self) -> float:
        """s."""
        if self.peak == 0.0:
            return 0.0
        ramps = 0.5 * (self.rise * (self.peak + self.start) + self.fall * (self.peak + self.end))
        return self.rise + self.fall + max(self.length - ramps, 0.0) / self.peak

    def at(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Way, rate and its derivative (n,) at times t (n,) in s from the start; at rest at the goal after the end."""
        left = np.maximum(self.duration - t, 0.0)
        rise, fall, a = self.rise, self.fall, self.acceleration
        # A time that rounding alone puts before a change of the rate's derivative counts as after it.
        rising, falling = t < rise - _ROUNDING, left < fall + _ROUNDING
        cruised = self.start * rise + 0.5 * a * rise**2 + self.peak * (t - rise)
        # Braking is counted back from the goal, so that rounding does not add up to a miss.
        s = np.where(
            rising,
            self.start * t + 0.5 * a * t**2,
            np.where(falling, self.length - self.end * left - 0.5 * a * left**2, cruised),
        )
        sd = np.where(rising, self.start + a * t, np.where(falling, self.end + a * left, self.peak))
        sdd = np.where(rising, a, np.where(falling, -a, 0.0))
        arrived = left <= 0.0
        return (
            np.where(arrived, self.length, s),
            np.where(arrived, self.end, sd),
            np.where(arrived & (self.end == 0.0), 0.0, sdd),
        )


def ticks(duration: float, period: float) -> int:
    """Ticks that a motion takes: the first tick at or after its end; rounding of the quotient does not add one."""
    return int(np.ceil(duration / period - 1e-9))
