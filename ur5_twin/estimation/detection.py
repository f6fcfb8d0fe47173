"""Whether there is a contact: a threshold that must be held for a while, and another one to let go."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ur5_twin.errors import ModelError
from ur5_twin.estimation.settings import Settings


@dataclass(frozen=True)
class Thresholds:
    """When contact begins and ends.

    Attributes:
        on: from this level on a contact begins ...
        rise: ... once it has lasted for so long, s.
        off: below this level it ends ...
        fall: ... once that has lasted for so long, s.
    """

    on: float
    off: float
    rise: float
    fall: float

    def __post_init__(self) -> None:
        if not self.off <= self.on:
            raise ModelError(f"detection: off ({self.off:g}) must not be above on ({self.on:g})")

    @classmethod
    def of(cls, settings: Settings) -> Thresholds:
        """Those of ``[detection]``, on the probability of contact."""
        spec = settings.detection
        return cls(spec.on, spec.off, spec.rise_s, spec.fall_s)


class ContactDetector:
    """Contact yes or no, from a level that grows with it: an estimate's probability, or a force in N.

    Attributes:
        contact: as told last.
        since: when the level first passed the threshold of the present answer, s; NaN at first.
    """

    def __init__(self, thresholds: Thresholds) -> None:
        self._thresholds = thresholds
        self.contact = False
        self.since = math.nan
        self._crossed: float | None = None

    def update(self, time: float, level: float) -> bool:
        """Contact at ``time`` s. A level of NaN changes nothing."""
        if math.isnan(level) or math.isnan(time):
            return self.contact
        limits = self._thresholds
        against = level < limits.off if self.contact else level >= limits.on
        if not against:
            self._crossed = None
            return self.contact
        if self._crossed is None:
            self._crossed = time
        # Stamps are sums of periods and rounded: a nanosecond is no delay.
        if time - self._crossed >= (limits.fall if self.contact else limits.rise) - 1e-9:
            self.contact, self.since, self._crossed = not self.contact, self._crossed, None
        return self.contact
