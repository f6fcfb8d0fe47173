"""Momentum with an accelerometer's help: the flange's acceleration makes the joints' acceleration better.

The mean external torque of ``arm_state`` has the acceleration a0 = (qd_k - qd_k-1) / dt in it. An accelerometer at
p in the flange feels R_BF acc = J_p qdd + J_p' qd + g e_z + noise (thesis equation 5.9), and least squares with what is
known of a0 gives::

    qdd = a0 + S J_p' (J_p (S + N) J_p' + s^2 I)^-1 (R_BF acc - g e_z - J_p' qd - J_p a0 - R_BF bias)

with S = diag(2 velocity^2 / dt^2), the noise of a0, s that of the device, and N = diag(joint_noise^2): the device sees
an instant, and a0 is the mean over a tick, in which the gears' ripple swings. The external torque is then mean +
M (qdd - a0), behind a low-pass of first order. Where speeds are known well, S is small and so is the help. bias is what
the device shows while the arm rests, averaged. Without the device, or where its signal is missing, qdd is a0 and this
is the momentum observer.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ur5_twin.arm._kinematics_kernels import frames_into, jacobian_dot_into, jacobian_into
from ur5_twin.arm.parameters import IMU_SENSOR
from ur5_twin.estimation.arm_state import ArmState
from ur5_twin.estimation.momentum_observer import first_order
from ur5_twin.estimation.motor_torque import MOVING, MotorTorque
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.skeleton import MomentumEstimator


class AccelerometerAided(MomentumEstimator):
    """The estimator above, with the numbers of ``[accelerometer_aided]``."""

    def __init__(self, nominal: NominalModel, motor: MotorTorque | None = None) -> None:
        super().__init__(nominal, motor)
        spec = nominal.settings.accelerometer_aided
        self._cutoff = np.array(spec.cutoff_1_s)
        self._noise, self._joint_noise = spec.acceleration_noise_m_s2, np.array(spec.joint_noise_rad_s2)
        self._bias_time = spec.bias_s
        tool = nominal.arm.tool
        self._place = None if tool is None else tool.sensors.get(IMU_SENSOR)
        self._velocity, self._gravity, self._dh = nominal.noise.velocity, nominal.arm.gravity, nominal.dh
        self._bias, self._mean = np.zeros(3), np.zeros(6)
        self._rested = 0.0
        self._variance = np.zeros(6)

    def observe(self, arm: ArmState) -> None:
        self._mean[:] = arm.mean
        self._variance[:] = arm.momentum
        acc = arm.sample.imu_acc
        if self._place is not None and np.isfinite(acc).all():
            resting = not (np.abs(arm.sample.target_qd) > MOVING).any()
            self._rested = self._rested + arm.dt if resting else 0.0
            # The first rest is averaged evenly, a long one slowly forgotten.
            share = arm.dt / min(max(self._rested, arm.dt), self._bias_time) if resting else 0.0
            _aid(
                self._dh,
                arm.q,
                arm.qd,
                arm.qdd,
                arm.dt,
                arm.M,
                self._place,
                np.ascontiguousarray(acc, dtype=float),
                self._gravity,
                self._noise,
                self._joint_noise,
                self._velocity,
                self._bias,
                share,
                self._mean,
                self._variance,
            )
        first_order(self._cutoff, arm.dt, self._mean, arm.white, self._variance, arm.bias, self.tau, self.variance)


@njit(cache=True, nogil=True)
def _aid(
    dh, q, qd, qdd, dt, M, place, acc, gravity, noise, joint_noise, velocity, bias, share, mean, momentum
):  # pragma: no cover - compiled
    """Add M (qdd - a0) to ``mean``; ``momentum`` becomes the variance of p that makes qdd as uncertain as it is."""
    frames, J, J_dot = np.empty((7, 4, 4)), np.empty((6, 6)), np.empty((6, 6))
    frames_into(dh, q, frames)
    jacobian_into(frames, 6, place, J)
    jacobian_dot_into(J, qd, 6, J_dot)
    S, z, SJ = np.empty(6), np.empty(3), np.empty((6, 3))
    for j in range(6):
        S[j] = 2.0 * (velocity[j] / dt) ** 2
    for i in range(3):
        z[i] = -gravity if i == 2 else 0.0
        for k in range(3):
            z[i] += frames[6, i, k] * (acc[k] - bias[k])
        for j in range(6):
            z[i] -= J_dot[i, j] * qd[j] + J[i, j] * qdd[j]
            SJ[j, i] = S[j] * J[i, j]
    inner = np.empty((3, 3))
    for i in range(3):
        for k in range(3):
            inner[i, k] = noise**2 if i == k else 0.0
            for j in range(6):
                inner[i, k] += J[i, j] * (S[j] + joint_noise[j] ** 2) * J[k, j]
    gain = SJ @ np.linalg.inv(inner)
    left = np.empty((6, 6))
    for j in range(6):
        for k in range(6):
            left[j, k] = S[j] if j == k else 0.0
            for i in range(3):
                left[j, k] -= gain[j, i] * SJ[k, i]
    spread = M @ left @ M.T
    turned = gain @ z
    for j in range(6):
        for k in range(6):
            mean[j] += M[j, k] * turned[k]
        momentum[j] = 0.5 * dt * dt * max(spread[j, j], 0.0)
    if share > 0.0:
        for k in range(3):
            seen = 0.0
            for i in range(3):
                seen += frames[6, i, k] * z[i]
            bias[k] += share * seen
