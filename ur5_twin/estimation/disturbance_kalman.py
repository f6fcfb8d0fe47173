"""Kalman filter with the external torque as a random walk: x = [p, w] per joint.

p_k+1 = p_k + dt (u + w_k) + noise (dt^2 white), w_k+1 = w_k + noise (walk^2 dt), and p is measured with the noise of
M qd. Joints are taken one by one: what M couples in the noise of p is left out. Noise levels follow the signals, so the
filter is quick at rest and careful in motion.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ur5_twin.estimation.arm_state import ArmState
from ur5_twin.estimation.motor_torque import MotorTorque
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.skeleton import MomentumEstimator

#: Variance of a momentum that is not measured at all, (Nm s)^2: that of the least encoder step at the least inertia.
_LEAST = 1e-12


class DisturbanceKalman(MomentumEstimator):
    """The filter above, with the walk of ``[disturbance_kalman]``."""

    def __init__(self, nominal: NominalModel, motor: MotorTorque | None = None) -> None:
        super().__init__(nominal, motor)
        self._walk = np.array(nominal.settings.disturbance_kalman.walk_nm_root_s) ** 2
        self._error = np.zeros(6)
        # Variance of p, covariance, variance of w.
        self._P = np.zeros((3, 6))
        self._P[2] = self.variance

    def observe(self, arm: ArmState) -> None:
        kalman(
            self._walk,
            arm.dt,
            arm.mean,
            arm.white,
            arm.momentum,
            self._error,
            self._P,
            self.tau,
        )
        np.add(self._P[2], arm.bias, out=self.variance)


@njit(cache=True, nogil=True)
def kalman(walk, dt, mean, white, momentum, error, P, w):  # pragma: no cover - compiled
    """One step of every joint's filter.

    Args:
        walk: (6,) variance of w that a second adds, Nm^2/s.
        dt: s.
        mean, white: (6,) mean external torque in the step, Nm, and the variance of torque, Nm^2.
        momentum: (6,) variance of p, (Nm s)^2.
        error: (6,) p less its estimate after the last step, Nm s; moved on.
        P: (3, 6) variance of p, covariance, variance of w; moved on.
        w: (6,) external torque, Nm; moved on.
    """
    for j in range(6):
        pp = P[0, j] + dt * (2.0 * P[1, j] + dt * (P[2, j] + white[j]))
        pw = P[1, j] + dt * P[2, j]
        ww = P[2, j] + walk[j] * dt
        # p - p^ - dt (u + w) of the error that the last step left.
        e = error[j] + dt * (mean[j] - w[j])
        total = pp + momentum[j] + _LEAST
        gain_p, gain_w = pp / total, pw / total
        error[j] = (1.0 - gain_p) * e
        w[j] += gain_w * e
        P[0, j] = (1.0 - gain_p) * pp
        P[1, j] = (1.0 - gain_p) * pw
        P[2, j] = ww - gain_w * pw
