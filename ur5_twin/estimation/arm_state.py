"""The arm as the estimators on its momentum see it, from sample to sample."""

from __future__ import annotations

import numpy as np

from ur5_twin.estimation import _kernels as kernels
from ur5_twin.estimation.intake import Intake, Step
from ur5_twin.estimation.motor_torque import MotorTorque, PlantTorque
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.protocol import Sample


class ArmState:
    """Generalised momentum p = M qd and what drives it: p' = u + tau_ext, u = torque + C' qd - g.

    The mean external torque between two samples is (p_k - p_k-1) / dt - (u_k + u_k-1) / 2, with no acceleration in
    it. Samples that lack a signal are passed over; the next one's step then spans the gap.

    Args:
        nominal: rigid bodies and noise.
        motor: torque of the motors less friction.

    Attributes:
        sample: the last one that could be used, without NaN but for the IMU's and actual_TCP_force.
        dt: s since the one before it.
        q, qd: (6,) measured.
        M, C: (6, 6); g: (6,), at q and qd.
        rate: (6,) mean of p' since the last sample, Nm.
        drive: (6,) mean of u.
        mean: (6,) mean of tau_ext.
        qdd: (6,) mean acceleration since the last sample, rad/s^2.
        white: (6,) variance of the torque from sample to sample, Nm^2.
        bias: (6,) variance of what friction and model may be wrong by, Nm^2.
        momentum: (6,) variance of p, (Nm s)^2.
    """

    def __init__(self, nominal: NominalModel, motor: MotorTorque | None = None) -> None:
        self.motor: MotorTorque = PlantTorque(nominal) if motor is None else motor
        self._packed, self._velocity = nominal.packed, nominal.noise.velocity
        self._intake = Intake()
        self.sample = self._intake.sample
        self.q, self.qd = self.sample.actual_q, self.sample.actual_qd
        self.dt = 0.0
        self.M, self.C = np.zeros((6, 6)), np.zeros((6, 6))
        self.g, self.rate, self.drive, self.mean, self.qdd, self.momentum = (np.zeros(6) for _ in range(6))
        self._p, self._u, self._p_before, self._u_before, self._qd_before = (np.zeros(6) for _ in range(5))
        self.white, self.bias = self.motor.white, self.motor.bias

    def update(self, sample: Sample) -> Step:
        """Take in a sample."""
        step = self._intake.update(sample)
        if step is Step.NOTHING:
            return step
        self.sample, self.dt = self._intake.sample, self._intake.dt
        self.motor.update(self.sample, self.dt)
        kernels.momentum(self._packed, self.q, self.qd, self.motor.torque, self.M, self.C, self.g, self._p, self._u)
        kernels.momentum_variance(self.M, self._velocity, self.momentum)
        if step is Step.START:
            self._p_before[:] = self._p
            self._u_before[:] = self._u
            self._qd_before[:] = self.qd
        else:
            kernels.mean_torque(
                self.dt,
                self._p,
                self._u,
                self.qd,
                self._p_before,
                self._u_before,
                self._qd_before,
                self.rate,
                self.drive,
                self.mean,
                self.qdd,
            )
        return step
