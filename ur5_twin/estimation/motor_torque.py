"""What the motors' currents leave for the links: the one place where drives and friction enter an estimate.

An estimator asks a ``MotorTorque`` for torque = motor - dry - viscous at each sample. ``PlantTorque`` is the law of
``models/ur5_joints.toml``; a better law is anything else with these attributes, given to an estimator as ``motor``.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numba import njit

from ur5_twin.arm.friction import friction_torque, pack
from ur5_twin.control.tcp_force import viscous_ratio_of
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.protocol import Sample

#: Target speed above which a joint counts as moving, rad/s: published speeds at rest are below 1e-4.
MOVING = 1e-3


class MotorTorque(Protocol):
    """Torque of the motors less friction, with memory; each attribute (6,), overwritten by each ``update``.

    Attributes:
        torque: motor - dry - viscous, Nm: what accelerates links and rotors and carries the load.
        motor: what the currents give, less ripple.
        dry: friction that does not grow with speed.
        viscous: friction that does.
        white: variance of the torque's noise from sample to sample, Nm^2.
        bias: variance of what the law may be wrong by for long, Nm^2. A stuck gear hides up to its friction's level.
    """

    torque: np.ndarray
    motor: np.ndarray
    dry: np.ndarray
    viscous: np.ndarray
    white: np.ndarray
    bias: np.ndarray

    def update(self, sample: Sample, dt: float) -> None:
        """Take in a sample without NaN (but for the IMU's), dt s after the last; 0 for the first."""
        ...


class PlantTorque:
    """The law of ``arm.friction`` with the numbers that the nominal model has, causal.

    Per joint, with i, q measured and v = target_qd, which says the direction better than the measured speed::

        motor = k i + b - ripple(q)
        dry   = stiffness z,   |stiffness z| <= coulomb(+/-) + load |tau_l| + stribeck exp(-(v / v_s)^2)
        viscous = viscous * ratio * v

    While the target moves z goes with it and slips at once; at rest z goes with the measured angle: a push that moves
    the joint by less than a tenth of a millirad turns friction round, and the encoder sees it. ratio is the drive's
    temperature as the controller's target_current shows it (``control.tcp_force.viscous_ratio``), the last one known.

    Variances: white, of the current; bias, in motion (friction_share * level)^2, at rest level^2 / 3, as of a friction
    that may be anything up to its level; and (torque_share * torque)^2 for the rest of the model.
    """

    def __init__(self, nominal: NominalModel) -> None:
        drives, noise, spec = nominal.drives, nominal.noise, nominal.settings.motor_torque
        self.torque, self.motor, self.dry, self.viscous, self.white, self.bias = (np.zeros(6) for _ in range(6))
        self._ratio, self._z, self._q = np.ones(6), np.zeros(6), np.zeros(6)
        self._law = _Law(
            drives.torque_constant,
            drives.offset,
            drives.ripple.order,
            drives.ripple.amplitude,
            drives.ripple.phase,
            nominal.arm.rotor_inertia,
            nominal.law.torque_constant,
            nominal.law.load,
            nominal.law.viscous_driving,
            nominal.law.viscous_backdriven,
            (drives.torque_constant * noise.current) ** 2,
            (drives.torque_constant * noise.current_moving) ** 2,
            np.array([spec.friction_share, spec.torque_share]),
        )
        self._friction = pack(drives.friction, nominal.arm.rotor_inertia)

    def update(self, sample: Sample, dt: float) -> None:
        if dt == 0.0:
            self._q[:] = sample.actual_q
        _plant_torque(
            self._law,
            self._friction,
            dt,
            sample.target_qd,
            sample.target_qdd,
            sample.target_current,
            sample.target_moment,
            sample.actual_q,
            sample.actual_current,
            self._ratio,
            self._z,
            self._q,
            (self.torque, self.motor, self.dry, self.viscous, self.white, self.bias),
        )


class _Law(NamedTuple):
    constant: np.ndarray
    offset: np.ndarray
    order: np.ndarray
    amplitude: np.ndarray
    phase: np.ndarray
    rotor: np.ndarray
    own_constant: np.ndarray
    own_load: np.ndarray
    own_driving: np.ndarray
    own_backdriven: np.ndarray
    white: np.ndarray
    white_moving: np.ndarray
    share: np.ndarray


@njit(cache=True, nogil=True, error_model="numpy")
def _plant_torque(
    law, friction, dt, target_qd, target_qdd, target_current, target_moment, q, current, ratio, z, q_before, out
):  # pragma: no cover - compiled  # fmt: skip
    torque, motor, dry, viscous, white, bias = out
    for j in range(6):
        v = target_qd[j]
        moving = abs(v) > MOVING
        told = viscous_ratio_of(
            v, target_moment[j], target_current[j], law.own_constant[j], law.own_load[j], law.own_driving[j],
            law.own_backdriven[j],
        )  # fmt: skip
        if not math.isnan(told):
            ratio[j] = told
        motor[j] = law.constant[j] * current[j] + law.offset[j]
        for r in range(law.order.shape[0]):
            motor[j] -= law.amplitude[r, j] * math.cos(law.order[r] * q[j] + law.phase[r, j])
        # Load-dependent friction from the last sample's: it is some percent, and changes little in a tick.
        link = motor[j] - dry[j] - viscous[j] - law.rotor[j] * target_qdd[j]
        step = v * dt if moving else q[j] - q_before[j]
        speed = v if moving else 0.0
        viscous[j] = friction.viscous[j] * ratio[j] * speed
        total, z[j] = friction_torque(friction, j, z[j], step, speed, link, ratio[j])
        dry[j] = total - viscous[j]
        torque[j] = motor[j] - total
        level = friction.load[j] * abs(link) + max(friction.positive[j], friction.negative[j])
        if moving:
            white[j] = law.white[j] + law.white_moving[j]
            bias[j] = (law.share[0] * level) ** 2
        else:
            white[j] = law.white[j]
            bias[j] = max(level + friction.stribeck[j], 0.0) ** 2 / 3.0
        bias[j] += (law.share[1] * torque[j]) ** 2
        q_before[j] = q[j]
