"""What goes into the twin each tick, and what comes out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Sample(NamedTuple):
    """One row of what the robot reports, under RTDE's names.

    Attributes:
        time: seconds on the robot's own clock.
        actual_q, actual_qd: (6,) measured joint positions and velocities, rad and rad/s.
        target: (3, 6) target_q, target_qd, target_qdd: rad, rad/s, rad/s^2; None if the robot does not publish them.
        wrench: (6,) measured force and moment on the arm at the flange in base axes, N and Nm; None if the twin is not
            to feel it.
        current: (6,) actual_current, A; None if the robot does not publish it.
    """

    time: float
    actual_q: np.ndarray
    actual_qd: np.ndarray
    target: np.ndarray | None = None
    wrench: np.ndarray | None = None
    current: np.ndarray | None = None


class Prediction(NamedTuple):
    """What the twin says about the same instant.

    Attributes:
        q, qd: (6,) joint positions and velocities, rad and rad/s.
        moment: (6,) joint torque of the motors, Nm: what the control law asks for (servo replay) or what the measured
            motion needs (shadow replay).
    """

    q: np.ndarray
    qd: np.ndarray
    moment: np.ndarray
    current: np.ndarray | None = None
