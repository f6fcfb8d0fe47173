"""First-order momentum observer (De Luca and Mattone 2003).

r = K (p - integral of (tau_m - tau_f + C' qd - g + r) - p0), so that r' = K (tau_ext - r): the external torque behind a
low-pass of first order. Here that is solved over each step as if the external torque were constant in it::

    r <- r + (1 - exp(-K dt)) (mean - r),    mean = (p_k - p_k-1) / dt - (u_k + u_k-1) / 2

It is stable for every K dt, and a missing row costs what happened in it and no more.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ur5_twin.estimation._kernels import averaged_variance
from ur5_twin.estimation.arm_state import ArmState
from ur5_twin.estimation.motor_torque import MotorTorque
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.skeleton import MomentumEstimator


class MomentumObserver(MomentumEstimator):
    """The observer above, with the gains of ``[momentum_observer]``."""

    def __init__(self, nominal: NominalModel, motor: MotorTorque | None = None) -> None:
        super().__init__(nominal, motor)
        self._gain = np.array(nominal.settings.momentum_observer.gain_1_s)

    def observe(self, arm: ArmState) -> None:
        first_order(self._gain, arm.dt, arm.mean, arm.white, arm.momentum, arm.bias, self.tau, self.variance)


@njit(cache=True, nogil=True)
def first_order(gain, dt, mean, white, momentum, bias, r, variance):  # pragma: no cover - compiled
    """One step of r' = K (mean - r) per joint, and its variance."""
    for j in range(6):
        share = 1.0 - math.exp(-gain[j] * dt)
        r[j] += share * (mean[j] - r[j])
        variance[j] = averaged_variance(share, dt, white[j], momentum[j]) + bias[j]


def delay(gain: float, threshold: float, torque: float) -> float:
    """Seconds until r of a torque step passes a threshold: -ln(1 - threshold / torque) / K.

    Infinite for a torque that never does. It is 18 ms for K = 50 1/s and 3 of 5 Nm.
    """
    if abs(torque) <= threshold:
        return math.inf
    return -math.log(1.0 - threshold / abs(torque)) / gain
