"""Linear extended-state observer: momentum and external torque together, both from the momentum's error.

p^' = u + w + 2 b (p - p^), w' = b^2 (p - p^): two poles at the bandwidth b. Over a step with z = exp(-b dt)::

    e = p - p^ - dt (u + w),    p^ <- p^ + dt (u + w) + (1 - z^2) e,    w <- w + (1 - z)^2 / dt e

which puts both poles at z whatever the step. A torque that grows evenly is followed without an error in p^, and w lags
behind it by 2 / b.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ur5_twin.estimation.arm_state import ArmState
from ur5_twin.estimation.motor_torque import MotorTorque
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.skeleton import MomentumEstimator


class ExtendedStateObserver(MomentumEstimator):
    """The observer above, with the bandwidths of ``[extended_state_observer]``."""

    def __init__(self, nominal: NominalModel, motor: MotorTorque | None = None) -> None:
        super().__init__(nominal, motor)
        self._bandwidth = np.array(nominal.settings.extended_state_observer.bandwidth_1_s)
        self._error = np.zeros(6)

    def observe(self, arm: ArmState) -> None:
        _observe(
            self._bandwidth, arm.dt, arm.mean, arm.white, arm.momentum, arm.bias, self._error, self.tau, self.variance
        )


@njit(cache=True, nogil=True)
def _observe(bandwidth, dt, mean, white, momentum, bias, error, w, variance):  # pragma: no cover - compiled
    for j in range(6):
        z = math.exp(-bandwidth[j] * dt)
        # p - p^ - dt (u + w) of the error that the last step left: only the mean torque is needed.
        e = error[j] + dt * (mean[j] - w[j])
        error[j] = z * z * e
        w[j] += (1.0 - z) ** 2 / dt * e
        # w is the mean torque through (1 - z)^2 / (1 - z q)^2, q the shift by a sample: the sum of the squared weights
        # that this gives to each sample's torque, half of it in each of two means, and to the momentum's differences.
        ring = (1.0 - z) / (1.0 + z)
        variance[j] = 0.5 * ring * white[j] + 2.0 * ring**3 / dt**2 * momentum[j] + bias[j]
