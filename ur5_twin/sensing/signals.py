"""What the devices look at: the truth, at physics steps."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Signals:
    """A piece of a motion at evenly spaced times, each (n, 6) unless said otherwise.

    Attributes:
        time: (n,) s; a piece goes on where the one before it ended.
        q, qd, qdd: rad, rad/s, rad/s^2.
        current: A.
        wrench: contacts and pushes on what is bolted to the flange, on the arm, at the flange's origin in base axes.
    """

    time: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    current: np.ndarray
    wrench: np.ndarray


@dataclass(frozen=True)
class Load:
    """What hangs on the force sensor: kg, (3,) m in the flange frame, (3, 3) kg m^2 about its centre."""

    mass: float = 0.0
    center: np.ndarray = field(default_factory=lambda: np.zeros(3))
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
