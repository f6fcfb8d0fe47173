"""How much a motion tells of a joint's drive, of a payload and of the servo, before anybody has moved.

With the law of ``identification.drive_plant``, per joint and with its natural parameters,

    i = (tau_l + J_r qdd + level sgn(qd) + viscous qd + ripple(q)) / k
    level = coulomb(+/-) + load |tau_l| + stribeck exp(-(qd / v_s)^2),    tau_l = arm + Y(q, qd, qdd) phi

a row of a log says of a parameter theta what di/dtheta is beside the current's noise S. The sum of
(di/dtheta)' (di/dtheta) / S over the rows in which a joint slides is Fisher's information; its inverse holds the
squared standard errors that no unbiased fit can beat (Cramer and Rao). phi are the ten inertial parameters of what
hangs on the flange: mass, first moments and the tensor about the flange's origin, in flange axes.

The servo's gains show in its own answer to what the controller does not know (friction, the rotors' acceleration):

    k_c (i - i_target) = -M_jj (kappa0 e + kappa1 e' + kappa_i int e),    e''' + kappa1 e'' + kappa0 e' + kappa_i e = d'

with d the acceleration that is missing. All of it is linear about the numbers that the twin has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from ur5_twin.arm import _dynamics_kernels as kernels
from ur5_twin.arm import inertia
from ur5_twin.arm.drive import JointDrives
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import N_JOINTS, ArmModel
from ur5_twin.control.gains import Gains
from ur5_twin.control.target_current import TargetCurrentLaw
from ur5_twin.drives.terms import Ride, ripple_columns
from ur5_twin.identification.drive_plant import DELAY, LAG, ORDERS, SLIDING
from ur5_twin.sensing import SensorSuite

#: What a trajectory can be for.
PURPOSES = ("drive", "plant", "payload", "servo", "all")
#: Per joint, with unit and what a number that is known not at all would be wrong by, where the twin's own is zero.
_DRIVE = (
    ("torque_constant", "Nm/A", 1.0),
    ("coulomb_positive", "Nm", 1.0),
    ("coulomb_negative", "Nm", 1.0),
    ("stribeck", "Nm", 0.5),
    ("load", "Nm/Nm", 0.05),
    ("viscous", "Nm s/rad", 1.0),
)
_ROTOR = ("rotor_inertia", "kg m^2", 0.1)
_SERVO = (("kappa0", "1/s^2", 1.0), ("kappa1", "1/s", 1.0), ("kappai", "1/s^3", 1.0))
#: Of the payload, with what counts as all of it: a kilogram 0.1 m away.
_BODY = (
    ("mass", "kg", 1.0),
    *((f"mass_{axis}", "kg m", 0.1) for axis in "xyz"),
    *((f"inertia_{axes}", "kg m^2", 0.01) for axes in ("xx", "xy", "xz", "yy", "yz", "zz")),
)
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
#: Standard error, as a share of a parameter's size, that stands for "unknown" so that no sum is singular.
_UNKNOWN = 1e3


@dataclass(frozen=True)
class Parameter:
    """One number that a trajectory shall tell.

    Attributes:
        name: what.
        joint: 1 to 6; 0 for the payload.
        unit: its unit.
        value: the twin's number.
        scale: what it is measured against: its size, or what it could be where the twin has none.
    """

    name: str
    joint: int
    unit: str
    value: float
    scale: float

    @property
    def label(self) -> str:
        return f"payload {self.name}" if self.joint == 0 else f"joint {self.joint} {self.name}"


@dataclass(frozen=True)
class Information:
    """Fisher's information of a motion about scaled parameters (each over its ``scale``); motions' add up.

    Attributes:
        joint: (6, m, m) each joint's drive; m may hold nuisance columns behind the parameters.
        cross: (6, m, b) joint and payload, b = 10, or 0 where the payload is known.
        body: (b, b) payload.
        servo: (6, 3, 3).
    """

    joint: np.ndarray
    cross: np.ndarray
    body: np.ndarray
    servo: np.ndarray

    def __add__(self, other: Information) -> Information:
        return Information(
            self.joint + other.joint, self.cross + other.cross, self.body + other.body, self.servo + other.servo
        )

    def __sub__(self, other: Information) -> Information:
        return self + other.times(-1.0)

    def times(self, factor: float) -> Information:
        return Information(factor * self.joint, factor * self.cross, factor * self.body, factor * self.servo)


class Question:
    """What is to be known, of which arm, by which sensors.

    Args:
        purpose: one of ``PURPOSES``.
        plant: the arm as it is, with what is on its flange.
        controller: what the controller linearises with.
        drives: the plant's motors and gears.
        law: the controller's drive law.
        gains: its servo.
        suite: the sensors, of which the current's noise counts.

    Attributes:
        parameters: what is wanted, joint by joint, then the payload's.
        plant: as given.
        wants_servo: whether the servo's gains are among them.
    """

    def __init__(
        self,
        purpose: str,
        plant: ArmModel,
        controller: ArmModel,
        drives: JointDrives,
        law: TargetCurrentLaw,
        gains: Gains,
        suite: SensorSuite,
    ) -> None:
        self.purpose, self.plant = purpose, plant
        self._drives, self._law, self._gains = drives, law, gains
        self._wants_drive = purpose in ("drive", "plant", "all")
        self._wants_body = purpose in ("payload", "all")
        self.wants_servo = purpose in ("servo", "all")
        self._has_rotor = purpose in ("plant", "all")
        self._dynamics, self._bare = Dynamics(plant), Dynamics(replace(plant, rotor_inertia=np.zeros(N_JOINTS)))
        self._controller = Dynamics(controller)
        # A fit sees noise at the motion's own low frequencies, where that of the motors, x_k = p x_k-1 + w_k, is
        # (1 + p) / (1 - p) times as strong as its variance says.
        p = suite.current_pole
        still = _variance(suite.current.noise) + _variance(suite.current.step) / 12.0
        self._weight = 1.0 / (still + suite.current_moving**2 * (1.0 + p) / (1.0 - p) + 1e-12)
        self._bodies = [_unit_body(plant, k) for k in range(len(_BODY))] if self._wants_body else []
        friction = drives.friction
        values = [
            drives.torque_constant,
            friction.coulomb_positive,
            friction.coulomb_negative,
            friction.stribeck,
            friction.load,
            friction.viscous,
            plant.rotor_inertia,
        ]
        kinds = (*_DRIVE, _ROTOR) if self._has_rotor else _DRIVE
        self._joint_values = np.stack(values[: len(kinds)], axis=1)
        self._joint_scale = np.where(self._joint_values == 0.0, [kind[2] for kind in kinds], np.abs(self._joint_values))
        gain_values = np.stack([gains.kappa0, gains.kappa1, gains.kappai], axis=1)
        self._servo_scale = np.where(gain_values == 0.0, 1.0, gain_values)
        self._body_scale = np.array([kind[2] for kind in _BODY])
        wanted: list[Parameter] = []
        for joints, all_values, scales in (
            (kinds if self._wants_drive else (), self._joint_values, self._joint_scale),
            (_SERVO if self.wants_servo else (), gain_values, self._servo_scale),
        ):
            for j in range(N_JOINTS):
                wanted += [
                    Parameter(kind[0], j + 1, kind[1], float(all_values[j, c]), float(scales[j, c]))
                    for c, kind in enumerate(joints)
                ]
        if self._wants_body:
            known = _body_numbers(plant)
            wanted += [Parameter(kind[0], 0, kind[1], float(v), kind[2]) for kind, v in zip(_BODY, known, strict=True)]
        self.parameters = tuple(wanted)

    def ride(self, rows: np.ndarray, step: float) -> Ride:
        """Rows (n, 3, 6) of q, qd, qdd, one a ``step``, as the drives see them; no sensor has reported anything."""
        q, qd, qdd = (np.ascontiguousarray(rows[:, i]) for i in range(3))
        none = np.zeros_like(q)
        return Ride(
            source="planned",
            time=np.arange(len(rows)) * step,
            torque=self._dynamics.inverse(q, qd, qdd),
            link=self._bare.inverse(q, qd, qdd),
            qd=qd,
            qdd=qdd,
            ratio=np.ones_like(q),
            feed_forward=none,
            angle=q,
            error=none,
            speed_error=none,
            current=none,
        )

    def information(self, of: Ride, *, ripple: bool = False, step: float = 0.008) -> Information:
        """What a motion tells, at the robot's 125 rows a second.

        Args:
            of: the motion, as ``ride`` gives it or ``drives.terms.ride`` of a log.
            ripple: count the gears' ripple as unknown too, as a fit must; needs all of the 125 rows a second.
            step: of the motion's rows, s; fewer of them stand for more.
        """
        share = step / 0.008
        n, b = len(of.time), len(self._bodies)
        columns, body = self.columns(of)
        if ripple:
            waves = [
                ripple_columns(of, j, ORDERS, DELAY, LAG, directed=False) * (np.abs(of.qd[:, [j]]) > SLIDING)
                for j in range(N_JOINTS)
            ]
            columns = np.concatenate([columns, np.stack(waves, axis=1)], axis=2)
        weighted = columns * (share * self._weight)[:, None]
        joint = np.einsum("nja,njb->jab", weighted, columns, optimize=True)
        if b:
            cross = np.einsum("nja,njb->jab", weighted, body, optimize=True)
            inner = np.einsum("nja,njb->ab", body * (share * self._weight)[:, None], body, optimize=True)
        else:
            cross, inner = np.zeros((N_JOINTS, columns.shape[2], 0)), np.zeros((0, 0))
        servo = np.zeros((N_JOINTS, 3, 3))
        if self.wants_servo and n:
            answer = self._servo_columns(of, step)
            servo = np.einsum("nja,njb->jab", answer * (share * self._weight)[:, None], answer, optimize=True)
        return Information(joint, cross, inner, servo)

    def columns(self, of: Ride) -> tuple[np.ndarray, np.ndarray]:
        """di/dtheta of scaled parameters: (n, 6, m) of the drives and (n, 6, 10) of the payload, A; 0 at rest."""
        k, friction = self._drives.torque_constant, self._drives.friction
        slides = np.abs(of.qd) > SLIDING
        sign = np.where(slides, np.sign(of.qd), 0.0)
        parts = [
            -self.current(of),
            (sign > 0) * 1.0,
            -1.0 * (sign < 0),
            np.exp(-((of.qd / friction.stribeck_speed) ** 2)) * sign,
            np.abs(of.link) * sign,
            of.ratio * of.qd,
            *([of.qdd] if self._has_rotor else []),
        ]
        columns = np.stack(parts, axis=2) * (slides / k)[:, :, None] * self._joint_scale
        if not self._bodies:
            return columns, np.zeros((*columns.shape[:2], 0))
        q, qd, qdd = (np.ascontiguousarray(x) for x in (of.angle, of.qd, of.qdd))
        torques = np.empty((len(self._bodies), *q.shape))
        for packed, out in zip(self._bodies, torques, strict=True):
            kernels.rnea_rows(packed, q, qd, qdd, out)
        carried = torques.transpose(1, 2, 0) * (1.0 + friction.load * sign * np.sign(of.link))[:, :, None]
        return columns, carried * (slides / k)[:, :, None] * self._body_scale

    def current(self, of: Ride) -> np.ndarray:
        """(n, 6) A that a motion takes by the twin's numbers, ripple left out; 0 for a joint that does not slide."""
        slides = np.abs(of.qd) > SLIDING
        friction = self._drives.friction.sliding(of.qd, of.link, of.ratio)
        return (of.torque + friction) * slides / self._drives.torque_constant

    def value(self, information: Information) -> float:
        """log det of what is wanted, the rest unknown (D-optimality); what is hardly told at all counts for little."""
        m, b = information.joint.shape[1], information.body.shape[0]
        # As if each parameter were known to its own size before.
        joint = information.joint + np.eye(m)
        total = 0.0
        if self._wants_drive:
            total += float(np.linalg.slogdet(joint)[1].sum())
        if b:
            told = np.linalg.solve(joint, information.cross)
            left = information.body - np.einsum("jab,jac->bc", information.cross, told)
            total += float(np.linalg.slogdet(left + np.eye(b))[1])
        if self.wants_servo:
            total += float(np.linalg.slogdet(information.servo + np.eye(3))[1].sum())
        return total

    def errors(self, information: Information) -> np.ndarray:
        """Standard errors in the order of ``parameters``, in their units; NaN where nothing tells a parameter.

        That is, where it is not told to ten times its own size.
        """
        m, b = information.joint.shape[1], information.body.shape[0]
        size = N_JOINTS * m + b
        whole = np.zeros((size, size))
        for j in range(N_JOINTS):
            at = slice(j * m, (j + 1) * m)
            whole[at, at] = information.joint[j]
            whole[at, N_JOINTS * m :] = information.cross[j]
            whole[N_JOINTS * m :, at] = information.cross[j].T
        whole[N_JOINTS * m :, N_JOINTS * m :] = information.body
        spread = np.sqrt(np.diag(np.linalg.inv(whole + np.eye(size) / _UNKNOWN**2)))
        found: list[np.ndarray] = []
        if self._wants_drive:
            wanted = self._joint_scale.shape[1]
            found.append(spread[: N_JOINTS * m].reshape(N_JOINTS, m)[:, :wanted].ravel())
        if self.wants_servo:
            inverse = np.linalg.inv(information.servo + np.eye(3) / _UNKNOWN**2)
            found.append(np.sqrt(np.diagonal(inverse, axis1=1, axis2=2)).ravel())
        if b:
            found.append(spread[N_JOINTS * m :])
        relative = np.concatenate(found)
        scale = np.array([parameter.scale for parameter in self.parameters])
        return np.where(relative < 10.0, relative * scale, np.nan)

    def fit(self, of: Ride) -> np.ndarray:
        """What least squares on a log of the twin's gets wrong, in the order of ``parameters``; NaN for the servo.

        One step of Gauss and Newton from the twin's own numbers, with the ripple unknown; rows weighted as above.
        """
        columns, body = self.columns(of)
        m, b = columns.shape[2], body.shape[2]
        slides = np.abs(of.qd) > SLIDING
        left = (of.current - self.current(of)) * slides
        normal, right = [], []
        for j in range(N_JOINTS):
            waves = ripple_columns(of, j, ORDERS, DELAY, LAG, directed=False) * slides[:, [j]]
            mine = np.zeros((len(left), N_JOINTS * (m + waves.shape[1]) + b))
            width = m + waves.shape[1]
            mine[:, j * width : (j + 1) * width] = np.concatenate([columns[:, j], waves], axis=1)
            mine[:, N_JOINTS * width :] = body[:, j]
            normal.append(self._weight[j] * mine.T @ mine)
            right.append(self._weight[j] * mine.T @ left[:, j])
        whole = np.sum(normal, axis=0)
        step = np.linalg.solve(whole + np.eye(len(whole)) / _UNKNOWN**2, np.sum(right, axis=0))
        width = (len(step) - b) // N_JOINTS
        found = []
        if self._wants_drive:
            found.append(step[: N_JOINTS * width].reshape(N_JOINTS, width)[:, :m].ravel())
        if self.wants_servo:
            found.append(np.full(N_JOINTS * len(_SERVO), np.nan))
        if b:
            found.append(step[N_JOINTS * width :])
        return np.concatenate(found) * [parameter.scale for parameter in self.parameters]

    def _servo_columns(self, of: Ride, step: float) -> np.ndarray:
        """(n, 6, 3) di/d kappa of scaled kappas, A, from the tracking error that the servo will have."""
        mass = np.diagonal(self._controller.mass_matrix(of.angle), axis1=1, axis2=2)
        known = self._law.current(self._controller.bias(of.angle, of.qd), of.qd)
        lacking = self._law.torque_constant * (self.current(of) - known * (np.abs(of.qd) > SLIDING)) / mass
        answer = np.empty((len(of.time), N_JOINTS, 3))
        for j in range(N_JOINTS):
            e, speed, integral = _servo_error(lacking[:, j], self._gains, j, step)
            answer[:, j] = np.stack([e, speed, integral], axis=1)
        return answer * (mass / self._law.torque_constant)[:, :, None] * self._servo_scale

    def servo_seen(self, of: Ride, information: Information) -> Information:
        """The information with the servo's part from the error that a log has, not from the one foreseen."""
        mass = np.diagonal(self._controller.mass_matrix(of.angle), axis1=1, axis2=2)
        integral = np.cumsum(of.error * of.step[:, None], axis=0)
        answer = np.stack([of.error, of.speed_error, integral], axis=2)
        answer = answer * (mass / self._law.torque_constant)[:, :, None] * self._servo_scale
        servo = np.einsum("nja,njb->jab", answer * self._weight[:, None], answer, optimize=True)
        return replace(information, servo=servo)


def _servo_error(lacking: np.ndarray, gains: Gains, j: int, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """e, e' and int e of e'' = -kappa0 e - kappa1 e' - kappa_i int e - lacking, exact for steps of ``lacking``."""
    values, vectors, drive = _modes(float(gains.kappa0[j]), float(gains.kappa1[j]), float(gains.kappai[j]), step)
    # Each mode by itself: x_k+1 = lambda x_k + drive u_k.
    modes = np.stack([lfilter([0.0, d], [1.0, -value], lacking) for d, value in zip(drive, values, strict=True)])
    e, speed, integral = np.real(vectors @ modes)
    return e, speed, integral


@lru_cache(maxsize=64)
def _modes(kappa0: float, kappa1: float, kappai: float, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eigenvalues and vectors of the servo's loop over a step of time, and what drives each mode."""
    whole = np.zeros((4, 4))
    whole[:3, :3] = [[0.0, 1.0, 0.0], [-kappa0, -kappa1, -kappai], [1.0, 0.0, 0.0]]
    whole[1, 3] = -1.0
    discrete = expm(whole * step)
    values, vectors = np.linalg.eig(discrete[:3, :3])
    return values, vectors, np.linalg.solve(vectors, discrete[:3, 3].astype(complex))


def _unit_body(plant: ArmModel, k: int) -> kernels.Packed:
    """An arm without any mass but a unit of the payload's k-th parameter, for its column of Y."""
    model = Dynamics(plant).packed
    links = model.links.copy()
    links[:, 4:] = 0.0
    # Link 6's frame J_6 has its origin at o_5; the flange is d_6 along its axis, without a turn for any UR.
    ca, sa, a, d = links[5, :4]
    R, p = np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]]), np.array([a, 0.0, d])
    mass, moment, tensor = 0.0, np.zeros(3), np.zeros((3, 3))
    if k == 0:
        mass, moment, tensor = 1.0, p, inertia.shift(np.zeros((3, 3)), 1.0, p)
    elif k < 4:
        h = R[:, k - 1]
        moment, tensor = h, 2.0 * (p @ h) * np.eye(3) - np.outer(p, h) - np.outer(h, p)
    else:
        row, column = _PAIRS[k - 4]
        unit = np.zeros((3, 3))
        unit[row, column] = unit[column, row] = 1.0
        tensor = R @ unit @ R.T
    links[5, 4:14] = [mass, *moment, *tensor[np.triu_indices(3)]]
    return kernels.Packed(links, model.gravity)


def _body_numbers(plant: ArmModel) -> np.ndarray:
    """(10,) of the tool at the flange: mass, first moments, tensor about the flange's origin."""
    if plant.tool is None:
        return np.zeros(len(_BODY))
    tool = plant.tool
    about = inertia.shift(tool.inertia, tool.mass, tool.center)
    return np.array([tool.mass, *(tool.mass * tool.center), *(about[pair] for pair in _PAIRS)])


def _variance(std: np.ndarray | None) -> np.ndarray:
    return np.zeros(N_JOINTS) if std is None else np.square(std)


def summed(parts: Sequence[Information]) -> Information:
    """Of one motion after another."""
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total
