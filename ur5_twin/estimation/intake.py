"""Samples as they come, made fit for use: what is missing, what is late, and how long it has been."""

from __future__ import annotations

from enum import Enum

import numpy as np

from ur5_twin.estimation import _kernels as kernels
from ur5_twin.estimation.protocol import Sample

#: The joints' signals among a sample's fields.
_FIRST, _LAST = 1, 9
JOINT_SIGNALS = Sample._fields[_FIRST:_LAST]
#: Without these there is no torque and no motion.
TORQUE_SIGNALS = ("target_qd", "target_qdd", "actual_q", "actual_qd", "actual_current")
#: Longer than this between two samples nobody knows what the torque was in between, s.
_LONGEST = 0.1


class Step(Enum):
    """What a sample was good for: nothing, a new start, or a step from the sample before."""

    NOTHING = 0
    START = 1
    STEP = 2


class Intake:
    """Takes samples whole or not at all: what a broken row still holds may belong to another tick.

    Args:
        needed: signals without which a row is passed over; the next one's step then spans the gap.

    Attributes:
        sample: the last good one. Joint signals that are not needed keep their last value, or zero, where they are
            missing; actual_TCP_force and the IMU's stay NaN.
        dt: s since the good one before it; 0 at a start.
    """

    def __init__(self, needed: tuple[str, ...] = TORQUE_SIGNALS) -> None:
        self._needed = sum(1 << JOINT_SIGNALS.index(name) for name in needed)
        self._new, self._held = np.empty((len(JOINT_SIGNALS), 6)), np.zeros((len(JOINT_SIGNALS), 6))
        self.sample = Sample(np.nan, *self._held, *(np.full(n, np.nan) for n in (6, 3, 3)))
        self.dt = 0.0

    def update(self, sample: Sample) -> Step:
        """Take in a sample."""
        new = self._new
        for i in range(len(JOINT_SIGNALS)):
            new[i] = sample[_FIRST + i]
        lacking = kernels.lacking(new)
        first = np.isnan(self.sample.time)
        dt = sample.time - self.sample.time
        if lacking & self._needed or not (np.isfinite(sample.time) if first else dt > 0.0):
            return Step.NOTHING
        kernels.take(new, self._held, lacking)
        self.sample = Sample(sample.time, *self.sample[_FIRST:_LAST], *sample[_LAST:])
        continues = not first and dt <= _LONGEST
        self.dt = dt if continues else 0.0
        return Step.STEP if continues else Step.START
