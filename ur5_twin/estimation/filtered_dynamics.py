"""Filtered dynamics: both sides of the equation of motion through the same low-pass, which takes the acceleration out.

With L = (w / (s + w))^n and p' = u + tau_ext::

    L tau_ext = L p' - L u,    L p' = (w / (s + w))^(n-1) w (p - w / (s + w) p)

Each side has a filter of its own. For n = 1 the result is the momentum observer's with K = w, whatever the step.
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


class FilteredDynamics(MomentumEstimator):
    """The filters above, with order and cut-off of ``[filtered_dynamics]``."""

    def __init__(self, nominal: NominalModel, motor: MotorTorque | None = None) -> None:
        super().__init__(nominal, motor)
        spec = nominal.settings.filtered_dynamics
        self._cutoff = np.array(spec.cutoff_1_s)
        self._inertial, self._driving = np.zeros((spec.order, 6)), np.zeros((spec.order, 6))

    def observe(self, arm: ArmState) -> None:
        _filter(
            self._cutoff,
            arm.dt,
            arm.rate,
            arm.drive,
            arm.white,
            arm.momentum,
            arm.bias,
            self._inertial,
            self._driving,
            self.tau,
            self.variance,
        )


@njit(cache=True, nogil=True)
def _filter(
    cutoff, dt, rate, drive, white, momentum, bias, inertial, driving, tau, variance
):  # pragma: no cover - compiled
    for j in range(6):
        share = 1.0 - math.exp(-cutoff[j] * dt)
        left, right = rate[j], drive[j]
        for n in range(inertial.shape[0]):
            inertial[n, j] += share * (left - inertial[n, j])
            driving[n, j] += share * (right - driving[n, j])
            left, right = inertial[n, j], driving[n, j]
        tau[j] = left - right
        # Of the first section; the others only lower it.
        variance[j] = averaged_variance(share, dt, white[j], momentum[j]) + bias[j]
