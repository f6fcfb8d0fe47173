"""What the controller publishes at a tick."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

#: What a signal is worth: a number, or a vector as an array.
Value = float | int | bool | np.ndarray


@dataclass(frozen=True)
class State:
    """One tick, for all ports alike.

    Attributes:
        tick: number of the tick.
        timestamp: the controller's clock, s: it was switched on some time ago (see ``VirtualController``).
        signals: RTDE's name -> value, in RTDE's units, the vectors (3,) or (6,). What the cell does not know is not
            among them: a port publishes zeros of the signal's type for it.
        moving: whether the arm's target moves.
        readings: device (``ft``, ``imu``) -> column -> rows that the device reported during this tick, ``time`` among
            the columns, on the device's own clock.
    """

    tick: int
    timestamp: float
    signals: Mapping[str, Value]
    moving: bool
    readings: Mapping[str, Mapping[str, np.ndarray]] = field(default_factory=dict)
