"""Momentum observer whose friction and torque constants are learnt while nothing touches the arm.

Per joint the link gets a motor - c dry - v viscous + o, with motor, dry and viscous of ``motor_torque``; a, c, v are 1
and o is 0 as far as the nominal model knows. Unloaded, what the motion needs says what they are:

    L (p' - C' qd + g) = a L motor - c L dry - v L viscous + o,    L the observer's own low-pass

so no acceleration is needed, and the external torque is the difference of both sides. Recursive least squares with a
prior (``constant_share`` of a, ``friction_share`` of c and v, ``offset_nm``) brings the four up to date at a sample
only if

- the probability of contact has been below ``contact`` for ``quiet_s``,
- the joint moves, since at rest friction may be anything,
- the sample tells something: phi' P phi is more than ``excitation`` of the noise. It forgets only then, back towards
  the nominal model within ``forgetting_s``: a long rest wipes nothing out, and an even motion cannot carry it away.

The noise is that of the filtered torque and, over ``correlation_s``, what the law may be wrong by for long: a push too
weak to be told from friction is learnt as friction, but slowly.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ur5_twin.estimation._kernels import averaged_variance
from ur5_twin.estimation.arm_state import ArmState
from ur5_twin.estimation.motor_torque import MOVING, MotorTorque
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.protocol import Estimate, Sample
from ur5_twin.estimation.skeleton import MomentumEstimator

#: Torque constant, dry friction, viscous friction, offset.
_N = 4


class AdaptiveObserver(MomentumEstimator):
    """The observer above, with the numbers of ``[adaptive_observer]``.

    Attributes:
        scale: (6, 4) a, c, v and o of each joint as learnt so far; o in Nm.
    """

    def __init__(self, nominal: NominalModel, motor: MotorTorque | None = None) -> None:
        super().__init__(nominal, motor)
        spec = nominal.settings.adaptive_observer
        self._gain = np.array(spec.gain_1_s)
        self._spec = spec
        self.scale = np.tile([1.0, 1.0, 1.0, 0.0], (6, 1))
        self._prior = np.empty((6, _N))
        self._prior[:, 0] = spec.constant_share**2
        self._prior[:, 1:3] = spec.friction_share**2
        self._prior[:, 3] = np.square(spec.offset_nm)
        self._P = np.stack([np.diag(row) for row in self._prior])
        # Low-passed: need, motor, dry, viscous; and the last sample's motor, dry, viscous, of which means are taken.
        self._smooth, self._before = np.zeros((4, 6)), np.zeros((3, 6))
        self._begun = False
        self._quiet = 0.0

    def update(self, sample: Sample) -> Estimate:
        estimate = super().update(sample)
        self._quiet = self._quiet + self.arm.dt if estimate.contact < self._spec.contact else 0.0
        return estimate

    def observe(self, arm: ArmState) -> None:
        motor = arm.motor
        if not self._begun:
            self._before[:] = motor.motor, motor.dry, motor.viscous
            self._begun = True
        _learn(
            self._gain,
            arm.dt,
            arm.rate,
            arm.drive,
            motor.motor,
            motor.dry,
            motor.viscous,
            arm.white,
            arm.momentum,
            arm.bias,
            arm.sample.target_qd,
            self._quiet >= self._spec.quiet_s,
            self._spec.correlation_s,
            math.exp(-arm.dt / self._spec.forgetting_s),
            self._spec.excitation,
            self._prior,
            self._before,
            self._smooth,
            self.scale,
            self._P,
            self.tau,
            self.variance,
        )


@njit(cache=True, nogil=True)
def _learn(
    gain, dt, rate, drive, motor, dry, viscous, white, momentum, bias, target_qd, quiet, correlation, kept, excitation,
    prior, before, smooth, scale, P, tau, variance,
):  # pragma: no cover - compiled  # fmt: skip
    phi, gains = np.empty(_N), np.empty(_N)
    for j in range(6):
        share = 1.0 - math.exp(-gain[j] * dt)
        means = (0.5 * (motor[j] + before[0, j]), 0.5 * (dry[j] + before[1, j]), 0.5 * (viscous[j] + before[2, j]))
        before[0, j], before[1, j], before[2, j] = motor[j], dry[j], viscous[j]
        # The torque is part of the mean drive; without it the rest is what the motion needs.
        need = rate[j] - drive[j] + means[0] - means[1] - means[2]
        smooth[0, j] += share * (need - smooth[0, j])
        for i in range(3):
            smooth[i + 1, j] += share * (means[i] - smooth[i + 1, j])
        phi[0], phi[1], phi[2], phi[3] = smooth[1, j], -smooth[2, j], -smooth[3, j], 1.0
        tau[j] = smooth[0, j]
        for i in range(_N):
            tau[j] -= phi[i] * scale[j, i]
        noise = averaged_variance(share, dt, white[j], momentum[j])
        variance[j] = noise + bias[j]
        if not quiet or abs(target_qd[j]) <= MOVING:
            continue
        told = 0.0
        for i in range(_N):
            gains[i] = 0.0
            for k in range(_N):
                gains[i] += P[j, i, k] * phi[k]
            told += gains[i] * phi[i]
        # What the law is wrong by lasts: samples of a whole correlation time say no more of it than one.
        level = noise + bias[j] * max(correlation / dt, 1.0)
        if told <= excitation * level:
            continue
        for i in range(_N):
            # Each parameter wanders about what was believed at first, and never becomes less certain than that.
            nominal = 1.0 if i < _N - 1 else 0.0
            scale[j, i] = nominal + kept * (scale[j, i] + gains[i] / (level + told) * tau[j] - nominal)
            for k in range(_N):
                P[j, i, k] = kept * kept * (P[j, i, k] - gains[i] * gains[k] / (level + told))
            P[j, i, i] += (1.0 - kept * kept) * prior[j, i]
