"""Drives: the map between joint torque, joint velocity and motor current."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ur5_twin.arm import files
from ur5_twin.arm.friction import Friction
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.errors import ModelError


@dataclass(frozen=True)
class LinearDrive:
    """A constant current-torque ratio with offset, Coulomb and viscous friction (thesis equations 3.12 to 3.14, 6.7).

    The motor's torque is tau = tau_link + tau_friction = k i + b, with
    tau_friction = coulomb * s(qd) + viscous * qd and s = sgn outside the dead zone, 0 inside it (equation 6.4).

    Attributes:
        torque_constant: k, (6,) Nm/A at the joint.
        offset: b, (6,) Nm.
        coulomb: (6,) Nm.
        viscous: (6,) Nm s/rad.
        dead_zone: rad/s.
    """

    name: str
    source: str
    torque_constant: np.ndarray
    offset: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    dead_zone: float

    def friction(self, qd: np.ndarray) -> np.ndarray:
        """Friction torque (..., 6) in Nm at joint velocities (..., 6) in rad/s; it opposes the motion."""
        direction = np.where(np.abs(qd) > self.dead_zone, np.sign(qd), 0.0)
        return self.coulomb * direction + self.viscous * qd

    def current(self, torque: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Motor current (..., 6) in A that gives the links ``torque`` (..., 6) in Nm at velocity ``qd``."""
        return (torque + self.friction(qd) - self.offset) / self.torque_constant

    def torque(self, current: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Torque (..., 6) in Nm that ``current`` (..., 6) in A leaves for the links at velocity ``qd``."""
        return self.torque_constant * current + self.offset - self.friction(qd)


@dataclass(frozen=True)
class Ripple:
    """Torque that motor and gear take and give back with the joint's angle, one row a term: sum of A cos(n q + phi).

    The motor and the gear's wave generator turn 101 times as fast as the joint, so n is a multiple of that.

    Attributes:
        order: n, (terms,).
        amplitude: A, (terms, 6) Nm.
        phase: phi, (terms, 6) rad.
    """

    order: np.ndarray
    amplitude: np.ndarray
    phase: np.ndarray

    def torque(self, q: np.ndarray) -> np.ndarray:
        """(..., 6) Nm at joint positions (..., 6) rad."""
        angle = self.order[:, None] * np.asarray(q)[..., None, :] + self.phase
        return (self.amplitude * np.cos(angle)).sum(axis=-2)


#: Motors and gears that run evenly.
NO_RIPPLE = Ripple(np.zeros(0), np.zeros((0, 6)), np.zeros((0, 6)))


@dataclass(frozen=True)
class JointDrives:
    """The plant's motors and gears: tau_motor = k_t i + b - ripple(q), and what friction takes of it.

    Attributes:
        torque_constant: k_t, (6,) Nm/A at the joint.
        offset: b, (6,) Nm.
        friction: of the joints.
        ripple: of the torque with the joint's angle.
        source: where the numbers come from.
    """

    torque_constant: np.ndarray
    offset: np.ndarray
    friction: Friction
    ripple: Ripple
    source: str


@dataclass(frozen=True)
class ManufacturerDrive:
    """What the manufacturer says of the drives (thesis table 4.1), each (6,), in units the table does not give."""

    source: str
    static_friction: np.ndarray
    dynamic_friction: np.ndarray
    viscous_friction: np.ndarray
    dynamic_friction_backdrive: np.ndarray
    viscous_friction_backdrive: np.ndarray
    torque_constant: np.ndarray


def load_manufacturer_drive() -> ManufacturerDrive:
    """Table 4.1's friction and torque constants, from ``models/ur5.toml``."""
    spec = files.read(files.model_path("ur5.toml"), files.BaseFile).manufacturer_drive
    return ManufacturerDrive(
        source=spec.source,
        static_friction=np.array(spec.static_friction),
        dynamic_friction=np.array(spec.dynamic_friction),
        viscous_friction=np.array(spec.viscous_friction),
        dynamic_friction_backdrive=np.array(spec.dynamic_friction_backdrive),
        viscous_friction_backdrive=np.array(spec.viscous_friction_backdrive),
        torque_constant=np.array(spec.torque_constant),
    )


def load_drive(name: str | Path = "thesis") -> LinearDrive:
    """A drive by name (``models/drives.toml``) or from a file with one table of the same keys.

    Raises:
        ModelError: the name is unknown or the file is wrong.
    """
    key, spec = files.choose(name, "drives.toml", files.DriveSpec, "drive")
    return LinearDrive(
        name=key,
        source=spec.source,
        torque_constant=np.array(spec.torque_constant_nm_a),
        offset=np.array(spec.offset_nm),
        coulomb=np.array(spec.coulomb_nm),
        viscous=np.array(spec.viscous_nm_s_rad),
        dead_zone=spec.dead_zone_rad_s,
    )


def drives_of(model: ArmModel) -> JointDrives:
    """The motors and gears of an arm model, the plant's where its file names none."""
    return load_joint_drives() if model.joints is None else load_joint_drives(model.joints)


def load_joint_drives(name: str | Path = "plant") -> JointDrives:
    """Motors and gears by name (``models/ur5_joints.toml``) or from a file with one table of the same keys.

    Raises:
        ModelError: the name is unknown or the file is wrong.
    """
    key, spec = files.choose(name, "ur5_joints.toml", files.JointDrivesSpec, "joints")
    if spec.cold_viscous_ratio < 1.0:
        raise ModelError(f"{key}: cold_viscous_ratio is {spec.cold_viscous_ratio}; a cold drive rubs more, not less")
    least = np.minimum(spec.coulomb_positive_nm, spec.coulomb_negative_nm) + spec.stribeck_nm
    if (least < 0).any():
        raise ModelError(
            f"{key}: stribeck_nm of joint {int(np.argmin(least)) + 1} takes more than coulomb friction gives: no joint "
            "drives itself"
        )
    friction = Friction(
        coulomb_positive=np.array(spec.coulomb_positive_nm),
        coulomb_negative=np.array(spec.coulomb_negative_nm),
        stribeck=np.array(spec.stribeck_nm),
        stribeck_speed=np.array(spec.stribeck_speed_rad_s),
        load=np.array(spec.load_nm_nm),
        viscous=np.array(spec.viscous_nm_s_rad),
        presliding=np.array(spec.presliding_mrad) * 1e-3,
        cold=spec.cold_viscous_ratio,
        warming_time=spec.warming_time_s,
        source=spec.source,
    )
    ripple = Ripple(
        order=np.array([term.order for term in spec.ripple]),
        amplitude=np.array([term.amplitude_nm for term in spec.ripple]).reshape(-1, 6),
        phase=np.array([term.phase_rad for term in spec.ripple]).reshape(-1, 6),
    )
    return JointDrives(np.array(spec.torque_constant_nm_a), np.array(spec.offset_nm), friction, ripple, spec.source)
