"""Recursive least squares on the wrench itself, the past forgotten by a factor lambda per tick.

F = argmin of sum over i of lambda^(k - i) |tau_i - J_i' F|^2_(R_i^-1) (1 - lambda) + |F|^2_(S0^-1), kept as
information::

    A <- lambda A + (1 - lambda) J R^-1 J',    b <- lambda b + (1 - lambda) J R^-1 tau,    F = (A + S0^-1)^-1 b

The weights sum to one, so that the covariance is that of a single sample: friction's error does not average away.
A step over a gap forgets as many ticks as it spans.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ur5_twin.estimation import _kernels as kernels
from ur5_twin.estimation.arm_state import ArmState
from ur5_twin.estimation.motor_torque import MotorTorque
from ur5_twin.estimation.nominal import PERIOD, NominalModel
from ur5_twin.estimation.protocol import Estimate
from ur5_twin.estimation.skeleton import MomentumEstimator


class RecursiveLeastSquares(MomentumEstimator):
    """The recursion above, with the forgetting factor of ``[recursive_least_squares]``."""

    def __init__(self, nominal: NominalModel, motor: MotorTorque | None = None) -> None:
        super().__init__(nominal, motor)
        self._forgetting = nominal.settings.recursive_least_squares.forgetting
        self._A, self._b = np.zeros((6, 6)), np.zeros(6)
        self._new_A, self._new_b = np.zeros((6, 6)), np.zeros(6)

    def observe(self, arm: ArmState) -> None:
        kept = self._forgetting ** (arm.dt / PERIOD)
        _one_sample(kept, arm.dt, arm.white, arm.momentum, arm.bias, self.variance)
        kernels.information(self.solver.J, arm.mean, self.variance, self._new_A, self._new_b)
        _gather(kept, self._new_A, self._new_b, self._A, self._b)

    def solved(self) -> Estimate:
        return self.solver.of_information(self._A, self._b)


@njit(cache=True, nogil=True)
def _one_sample(kept, dt, white, momentum, bias, variance):  # pragma: no cover - compiled
    """Variance of a torque that is averaged with these weights: noise goes with it, and bias stays."""
    for j in range(6):
        variance[j] = kernels.averaged_variance(1.0 - kept, dt, white[j], momentum[j]) + bias[j]


@njit(cache=True, nogil=True)
def _gather(kept, new_A, new_b, A, b):  # pragma: no cover - compiled
    for i in range(6):
        b[i] = kept * b[i] + (1.0 - kept) * new_b[i]
        for k in range(6):
            A[i, k] = kept * A[i, k] + (1.0 - kept) * new_A[i, k]
