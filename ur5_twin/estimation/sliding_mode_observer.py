"""Second-order sliding mode momentum observer (Garofalo et al. 2019): converges in finite time, not exponentially.

With e = p^ - p::

    p^' = u + s - T2 e - T1 sqrt|e| sgn e,    s' = -S1 sgn e - S2 e,    T1 = 2 sqrt S1, T2 = 2 sqrt S2

s follows every external torque that changes by less than S1 per second. At 8 ms an explicit step would chatter by
S1 dt; here each step is implicit and solved in closed form. With the error that would stand without the correction,
e0 = p^ + dt (u + s) - p, and c = dt^2 S1::

    |e0| <= c:  e = 0,  s <- s - e0 / dt
    else:       (1 + dt T2 + dt^2 S2) x^2 + dt T1 x = |e0| - c,  e = x^2 sgn e0,  s <- s - dt (S1 sgn e0 + S2 e)

In the sliding mode s is the mean torque itself, noise and all, as far as that changes by less than S1 dt a sample.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ur5_twin.estimation.arm_state import ArmState
from ur5_twin.estimation.motor_torque import MotorTorque
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.skeleton import MomentumEstimator


class SlidingModeObserver(MomentumEstimator):
    """The observer above, with the gains of ``[sliding_mode_observer]``."""

    def __init__(self, nominal: NominalModel, motor: MotorTorque | None = None) -> None:
        super().__init__(nominal, motor)
        spec = nominal.settings.sliding_mode_observer
        self._s1, self._s2 = np.array(spec.s1_nm_s), np.array(spec.s2_1_s2)
        self._error = np.zeros(6)

    def observe(self, arm: ArmState) -> None:
        _slide(
            self._s1,
            self._s2,
            arm.dt,
            arm.mean,
            arm.white,
            arm.momentum,
            arm.bias,
            self._error,
            self.tau,
            self.variance,
        )


@njit(cache=True, nogil=True)
def _slide(s1, s2, dt, mean, white, momentum, bias, error, s, variance):  # pragma: no cover - compiled
    for j in range(6):
        # p^ + dt (u + s) - p of the error that the last step left: only the mean torque is needed.
        free = error[j] + dt * (s[j] - mean[j])
        dead = dt * dt * s1[j]
        if abs(free) <= dead:
            error[j] = 0.0
            s[j] -= free / dt
        else:
            a = 1.0 + 2.0 * dt * math.sqrt(s2[j]) + dt * dt * s2[j]
            b = 2.0 * dt * math.sqrt(s1[j])
            x = (math.sqrt(b * b + 4.0 * a * (abs(free) - dead)) - b) / (2.0 * a)
            sign = 1.0 if free > 0.0 else -1.0
            error[j] = sign * x * x
            s[j] -= dt * (s1[j] * sign + s2[j] * error[j])
        # No more than the mean torque's own noise, and no more than what the slope lets through in a few samples.
        variance[j] = min(0.5 * white[j] + 2.0 * momentum[j] / dt**2, (4.0 * dt * s1[j]) ** 2) + bias[j]
