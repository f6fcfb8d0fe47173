"""Torque constants and friction of the arm's own joints, from the currents of moving logs.

    k i = tau + (coulomb(+/-) + load |tau_l| + rise (1 - exp(-(qd / rise_speed)^2))) sgn(qd) + viscous w qd

with tau the joint's torque by the plant's rigid-body model less J' F of contacts, tau_l its part beyond the rotor, and
w the controller's correction of viscous friction for the drive's temperature (``control.tcp_force.viscous_ratio``).
``rise`` is friction that fades at creeping speed, a Stribeck term of negative sign. Bounded least squares in the
current.

A sensor's offset cannot be told from friction that differs with the direction; it counts as the latter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import N_JOINTS, ArmModel
from ur5_twin.control.target_current import TargetCurrentLaw
from ur5_twin.control.tcp_force import viscous_ratio
from ur5_twin.errors import IdentificationError
from ur5_twin.recording.table import Recording

#: Target speed above which a joint counts as moving, rad/s.
_MOVING = 0.01
#: Speeds tried for the fading of friction, rad/s.
_RISE_SPEEDS = (0.01, 0.02, 0.03, 0.05, 0.08)
#: Torque behind the gear whose spread is too small to tell load-dependent friction, Nm.
_LEAST_LOAD = 0.8
#: No UR5 has a torque constant beyond, Nm/A; the controller's own law takes 0.015 A/Nm for load-dependent friction.
_LARGEST_CONSTANT, _LARGEST_LOAD = 30.0, 0.03


@dataclass(frozen=True)
class Ride:
    """What the fit needs of one log, each (n, 6).

    Attributes:
        source: the log's name.
        torque: Nm the joint needs, rotor included, contacts taken off.
        link: its part beyond the rotor, Nm.
        qd: target speed, rad/s.
        ratio: viscous friction over the controller's law, a number.
        current: A measured.
    """

    source: str
    torque: np.ndarray
    link: np.ndarray
    qd: np.ndarray
    ratio: np.ndarray
    current: np.ndarray


def ride(recording: Recording, plant: ArmModel, law: TargetCurrentLaw, tau_ext: np.ndarray | None = None) -> Ride:
    """A log for the fit.

    Args:
        recording: with the targets and actual_current.
        plant: the arm with whatever is bolted to it.
        law: the controller's drive law.
        tau_ext: (n, 6) J' F of contacts in Nm, positive accelerates.
    """
    robot = recording.robot
    motion = [robot[name] for name in ("target_q", "target_qd", "target_qdd")]
    without_rotors = replace(plant, rotor_inertia=np.zeros(N_JOINTS))
    contact = np.zeros((len(robot), N_JOINTS)) if tau_ext is None else tau_ext
    ratio = viscous_ratio(law, robot["target_qd"], robot["target_moment"], robot["target_current"])
    usual = np.where(np.isnan(ratio).all(axis=0), 1.0, np.nanmean(np.vstack([ratio, np.ones(N_JOINTS)]), axis=0))
    return Ride(
        source=recording.source,
        torque=Dynamics(plant).inverse(*motion) - contact,
        link=Dynamics(without_rotors).inverse(*motion) - contact,
        qd=robot["target_qd"],
        ratio=np.where(np.isnan(ratio), usual, ratio),
        current=robot["actual_current"],
    )


@dataclass(frozen=True)
class FrictionFit:
    """Coefficients of the law above, each (6,).

    Attributes:
        torque_constant: Nm/A.
        coulomb_positive, coulomb_negative: Nm at creeping speed.
        load: Nm/Nm.
        rise: Nm by which sliding friction exceeds it.
        rise_speed: rad/s.
        viscous: Nm s/rad at ratio 1.
    """

    torque_constant: np.ndarray
    coulomb_positive: np.ndarray
    coulomb_negative: np.ndarray
    load: np.ndarray
    rise: np.ndarray
    rise_speed: np.ndarray
    viscous: np.ndarray

    def current(self, of: Ride) -> np.ndarray:
        """(n, 6) A that the law expects; without friction where the target rests."""
        sign = np.sign(of.qd)
        coulomb = np.where(of.qd > 0, self.coulomb_positive, self.coulomb_negative)
        level = coulomb + self.load * np.abs(of.link) + self.rise * -np.expm1(-((of.qd / self.rise_speed) ** 2))
        return (of.torque + level * sign + self.viscous * of.ratio * of.qd) / self.torque_constant


def fit_friction(rides: Sequence[Ride], torque_constant: np.ndarray | None = None) -> FrictionFit:
    """The law's coefficients by least squares over the moving rows of all rides, none of them negative.

    Args:
        rides: logs in which every joint moves.
        torque_constant: (6,) Nm/A to be taken as given; NaN or None: fitted.

    Raises:
        IdentificationError: a joint moves in no log.
    """
    given = np.full(N_JOINTS, np.nan) if torque_constant is None else np.asarray(torque_constant, dtype=float)
    found = np.empty((N_JOINTS, 7))
    for j in range(N_JOINTS):
        moving = [np.abs(r.qd[:, j]) > _MOVING for r in rides]
        if not any(m.sum() > 100 for m in moving):
            raise IdentificationError(
                f"joint {j + 1} does not move in {', '.join(r.source for r in rides) or 'no logs'}"
            )
        torque, link, qd, ratio, current = (
            np.concatenate([getattr(r, name)[m, j] for r, m in zip(rides, moving, strict=True)])
            for name in ("torque", "link", "qd", "ratio", "current")
        )
        sign = np.sign(qd)
        low, high = np.zeros(6), np.full(6, np.inf)
        low[0] = 1.0 / _LARGEST_CONSTANT
        if not np.isnan(given[j]):
            low[0], high[0] = (1.0 - 1e-9) / given[j], (1.0 + 1e-9) / given[j]
        high[3] = _LARGEST_LOAD if link.std() > _LEAST_LOAD else 1e-12
        tried = []
        for speed in _RISE_SPEEDS:
            rise = -np.expm1(-((qd / speed) ** 2)) * sign
            columns = np.stack([torque, sign > 0, -1.0 * (sign < 0), np.abs(link) * sign, rise, ratio * qd], axis=1)
            result = lsq_linear(columns, current, bounds=(low, high))
            tried.append((result.cost, speed, result.x))
        _, speed, x = min(tried, key=lambda t: t[0])
        found[j] = [1.0 / x[0], *(x[1:5] / x[0]), speed, x[5] / x[0]]
    return FrictionFit(*found.T)


def errors(fit: FrictionFit, of: Ride) -> np.ndarray:
    """(2, 6) MAE of the current in A while a joint moves, and while it rests; NaN where it does neither."""
    moving = np.abs(of.qd) > _MOVING
    error = np.abs(fit.current(of) - of.current)
    count = np.stack([moving.sum(axis=0), (~moving).sum(axis=0)])
    total = np.stack([np.where(moving, error, 0.0).sum(axis=0), np.where(moving, 0.0, error).sum(axis=0)])
    return np.divide(total, count, out=np.full((2, N_JOINTS), np.nan), where=count > 0)
