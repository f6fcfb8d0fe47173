"""Wrenches that somebody puts on the arm, as functions of time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

Profile = Literal["half_sine", "ramp", "step"]


@dataclass(frozen=True)
class Push:
    """A wrench on one body of the arm.

    Attributes:
        body: name of the body in MuJoCo.
        point: (3,) where it acts, in the body's frame (of a link its DH frame, of the tool the flange frame), m.
        turning: given in the body's axes, and turning with it; otherwise in the base's.
        profile: its course over time: half a sine; a rise in ``rise``, a plateau and a fall in ``rise``; or a step.
        at: when it begins, s.
        duration: s.
        rise: s, of a ramp.
        peak: (6,) force and moment about the point at the profile's top, N and Nm, on the arm.
    """

    body: str
    point: np.ndarray
    turning: bool
    profile: Profile
    at: float
    duration: float
    rise: float
    peak: np.ndarray

    @property
    def end(self) -> float:
        """When it is over, s."""
        return self.at + self.duration

    def acts_within(self, start: float, end: float) -> bool:
        """Whether it is more than nothing anywhere from ``start`` to ``end``, s."""
        return self.at < end and self.end > start

    def wrench(self, time: ArrayLike) -> np.ndarray:
        """(..., 6) force and moment about the point at times (...) in s."""
        return self.share(time)[..., None] * self.peak

    def share(self, time: ArrayLike) -> np.ndarray:
        """The profile (...), 0 to 1, at times (...) in s."""
        s = np.asarray(time, dtype=float) - self.at
        inside = (s >= 0) & (s < self.duration)
        if self.profile == "half_sine":
            return np.where(inside, np.sin(np.pi * s / self.duration), 0.0)
        if self.profile == "ramp":
            return np.where(inside, np.clip(np.minimum(s, self.duration - s) / self.rise, 0.0, 1.0), 0.0)
        return inside.astype(float)


@dataclass(frozen=True)
class LogPush:
    """The wrench that a real log's force sensor felt, put on the arm again: tared and moved to the flange.

    Attributes:
        body, point: as of ``Push``; the wrench is about this point.
        at: when it begins, s.
        path: the log.
        first, last: the piece of the log's time that acts, s; ``last`` is None for its end.
        scale: factor on the wrench.
    """

    body: str
    point: np.ndarray
    at: float
    path: Path
    first: float
    last: float | None
    scale: float
