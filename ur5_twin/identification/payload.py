"""What hangs on the flange: what the controller was told of, and what the motors really carry.

**Told.** target_moment is the controller's own model, payload included, without noise: what it has beyond the model of
the bare arm is linear in the ten numbers of ``identification.body``, and least squares finds them exactly.

**Carried.** The motors' currents answer what really hangs there::

    i = u (tau + Y phi) + l |tau_l + Y phi| s + c(+/-) s + r exp(-(qd / v_s)^2) s + v w qd + ripple(q),   s = sgn(qd)

per joint, u = 1/k, tau the bare arm's torque and tau_l its part beyond the rotors. phi is one for all joints and
logs. The drives' numbers (u, l, c, r, v) are nuisance: their prior is a file of drives, as far as such numbers hold
for another day or another arm; logs of the same arm without the load know them better. A joint at rest has no
friction term: what its gear holds by friction is error there, and rest and motion are weighted by what each leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ur5_twin.arm.drive import JointDrives
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import N_JOINTS, ArmModel
from ur5_twin.drives import terms
from ur5_twin.errors import IdentificationError
from ur5_twin.identification import body, spread
from ur5_twin.identification.load import LARGEST_INERTIA, LINK_MASS_OFF, Load, likeliest, load_columns, mass_columns
from ur5_twin.identification.servo import external_torque
from ur5_twin.recording.force_sensor import FT_DELAY
from ur5_twin.recording.table import Recording

_TOLD_SIGNALS = ("target_q", "target_qd", "target_qdd", "target_moment")
#: Target speed above which friction is sliding, rad/s; slower joints that move are left out.
_SLIDING = 0.01
#: Rows of a block of correlated errors, 2 s.
_BLOCK = 250
#: How far drives' numbers may be off on another day or another arm, one standard deviation: torque constants, as much
#: as pushes and free motion disagree about them (docs/servo.md, docs/drive.md), and friction, a share and as much
#: beside, A.
_CONSTANT_OFF = np.array([0.05, 0.05, 0.05, 0.12, 0.25, 0.25])
_FRICTION_OFF, _FRICTION_BESIDE, _LOAD_BESIDE = 0.25, 0.1, 0.002
#: Errors beyond so many standard deviations count less: somebody touched the arm.
_HUBER = 2.0
#: How far the arm's own numbers may be off, one standard deviation, shares: masses of links 2 to 6, rotors' inertias.
_ARM_OFF = np.concatenate([np.full(5, LINK_MASS_OFF), np.full(6, 0.05)])
#: Orders of the ripple, periods a revolution, and with which delay and lag a current shows it, s (docs/drive.md).
_ORDERS, _DELAY, _LAG = (202, 404), 0.005, 0.002
#: Ripple of another phase, A: no prior knowledge.
_RIPPLE_OFF = 1.0
#: The inertia is told if the standard deviation of its trace is less than this share of it.
_INERTIA_TOLD = 0.25
_ROUNDS = 8
#: Less motion than this, s, or fewer joints tell mass and centre no better than standing would.
_SHORTEST = 1.0
#: Error of a noiseless target_moment beyond which it is not that of one body, Nm.
_NOT_ONE = 1e-3


@dataclass(frozen=True)
class PayloadFit(Load):
    """A body at the flange, and what it explains.

    Attributes:
        error: (n_logs, 6) mean absolute error with the body, A or Nm.
        without: (n_logs, 6) the same with nothing at the flange, drives fitted anew.
        constants: (6,) torque constants that the fit found, Nm/A; None for the told one.
        constants_std: (6,)
    """

    error: np.ndarray
    without: np.ndarray
    constants: np.ndarray | None = None
    constants_std: np.ndarray | None = None


def between(recording: Recording, first: float, last: float) -> Recording:
    """The part of a log in which one thing hangs on the flange, s on the robot's clock.

    Raises:
        IdentificationError: fewer than a second of rows lie there.
    """
    robot = recording.robot
    rows = (robot.time >= first) & (robot.time <= last)
    if rows.sum() < 125:
        raise IdentificationError(
            f"{recording.source}: {rows.sum()} rows between {first:g} and {last:g} s; its time runs from "
            f"{robot.time[0]:.3f} to {robot.time[-1]:.3f} s"
        )
    cut = type(robot)("robot", robot.time[rows], {k: v[rows] for k, v in robot.columns.items()}, robot.host_start)
    return recording.with_table(cut)


def fit_told(recordings: Sequence[Recording], controller: ArmModel) -> PayloadFit:
    """The payload that the controller was told of.

    Args:
        recordings: logs with targets and target_moment.
        controller: its model without that payload.

    Raises:
        IdentificationError: a signal is missing, or the arm stands still in one posture.
    """
    columns, left = [], []
    for recording in recordings:
        robot = recording.robot
        _need(recording, _TOLD_SIGNALS, "what the controller was told of shows in target_moment")
        q, qd, qdd, moment = (robot[name] for name in _TOLD_SIGNALS)
        columns.append(load_columns(controller, q, qd, qdd))
        left.append(moment - Dynamics(controller).inverse(q, qd, qdd))
    x, y = np.concatenate(columns), np.concatenate(left)
    blocks = np.repeat(np.arange(len(y)) // _BLOCK, N_JOINTS)
    for width in (10, 4):
        flat = x[:, :, :width].reshape(-1, width)
        scale = np.sqrt((flat**2).mean(axis=0)) + 1e-12
        singular = np.linalg.svd(flat / scale, compute_uv=False)
        # Six decimals of some Nm: what is told by a ten-thousandth of the rest drowns in rounding.
        if singular[-1] > 1e-4 * singular[0]:
            break
    else:
        raise IdentificationError(
            f"{_names(recordings)}: the targets hold one posture, which tells no mass from its centre; record a "
            f"motion of "
            "several joints"
        )
    phi = np.linalg.lstsq(flat, y.ravel(), rcond=None)[0]
    residual = y - x[:, :, :width] @ phi
    covariance = spread.sandwich(flat, residual.ravel(), blocks)
    error = np.array([np.abs(part - c[:, :, :width] @ phi).mean(axis=0) for part, c in zip(left, columns, strict=True)])
    fit = PayloadFit(phi, covariance, None, error, np.array([np.abs(part).mean(axis=0) for part in left]))
    return replace(fit, body=likeliest(phi, covariance)) if fit.found else fit


def one_body(fit: PayloadFit) -> bool:
    """Whether a noiseless target_moment is that of one body from beginning to end."""
    return bool(fit.error.max() < _NOT_ONE)


def fit_carried(
    loaded: Sequence[Recording],
    bare: Sequence[Recording],
    plant: ArmModel,
    drives: JointDrives,
    p_FS: np.ndarray | None = None,
) -> PayloadFit:
    """What really hangs on the flange, from the motors' currents.

    Args:
        loaded: logs with the load.
        bare: logs of the same arm without it; none if there are none.
        plant: the arm's rigid bodies without the load.
        drives: the prior of torque constants and friction.
        p_FS: (3,) origin in the flange frame, m, of a force sensor through which the loaded arm was pushed: what it
            felt is taken off. None where nobody pushed.

    Raises:
        IdentificationError: a signal is missing, or too few joints of the loaded logs move.
    """
    rides = [terms.ride(recording, plant) for recording in (*loaded, *bare)]
    _check_motion(rides[: len(loaded)], loaded)
    laden = []
    for n, (recording, ride) in enumerate(zip((*loaded, *bare), rides, strict=True)):
        q = ride.angle - ride.error
        load = load_columns(plant, q, ride.qd, ride.qdd)
        if n >= len(loaded):
            load = np.zeros_like(load)
        helped = np.zeros_like(ride.qd)
        if p_FS is not None and n < len(loaded):
            helped = external_torque(recording, plant, p_FS, FT_DELAY)
        laden.append(_Laden(ride, np.concatenate([_arm_columns(plant, q, ride), load], axis=2), helped))
    problem = _Problem(laden, drives)
    nothing = problem.solve(0)
    fit = problem.solve(10)
    trace = fit.phi[4:7].sum()
    told = np.sqrt(np.ones(3) @ fit.covariance[4:7, 4:7] @ np.ones(3)) < _INERTIA_TOLD * abs(trace)
    if not told or np.linalg.eigvalsh(body.pseudo_inertia(fit.phi))[0] < -1e-3:
        fit = problem.solve(4)
    return PayloadFit(
        fit.phi,
        fit.covariance,
        likeliest(fit.phi, fit.covariance),
        problem.errors(fit)[: len(loaded)],
        problem.errors(nothing)[: len(loaded)],
        1.0 / fit.own[:, 0],
        fit.own_std[:, 0] / fit.own[:, 0] ** 2,
    )


@dataclass(frozen=True)
class _Solution:
    """Numbers of the arm and the body, covariance of the body's, and each joint's own with their deviations."""

    shared: np.ndarray
    covariance: np.ndarray
    own: np.ndarray
    own_std: np.ndarray

    @property
    def phi(self) -> np.ndarray:
        return self.shared[_ARM_OFF.size :]


@dataclass(frozen=True)
class _Rows:
    """One joint in all logs, rows that count only, each (n,) or (n, width)."""

    log: np.ndarray
    block: np.ndarray
    torque: np.ndarray
    link: np.ndarray
    qd: np.ndarray
    sign: np.ndarray
    fading: np.ndarray
    viscous: np.ndarray
    waves: np.ndarray
    regressor: np.ndarray
    current: np.ndarray

    @property
    def rests(self) -> np.ndarray:
        return self.sign == 0.0


class _Problem:
    """The currents of all joints and logs, and the drives' prior."""

    def __init__(self, rides: Sequence[_Laden], drives: JointDrives) -> None:
        friction, u = drives.friction, 1.0 / drives.torque_constant
        mean = np.stack(
            [
                u,
                friction.load * u,
                friction.coulomb_positive * u,
                friction.coulomb_negative * u,
                friction.stribeck * u,
                friction.viscous * u,
            ],
            axis=1,
        )
        off = _FRICTION_OFF * np.abs(mean) + _FRICTION_BESIDE
        off[:, 0] = _CONSTANT_OFF * u
        # Of load-dependent friction only a share may be off: A/Nm, not A.
        off[:, 1] = _FRICTION_OFF * mean[:, 1] + _LOAD_BESIDE
        ripple = 2 * len(_ORDERS)
        self._mean = np.concatenate([mean, np.zeros((N_JOINTS, ripple))], axis=1)
        self._off = np.concatenate([off, np.full((N_JOINTS, ripple), _RIPPLE_OFF)], axis=1)
        self._logs = len(rides)
        first = np.cumsum([0, *(len(laden.ride.time) // _BLOCK + 1 for laden in rides)])
        self._blocks = int(first[-1])
        self._joints = [_joint_rows(rides, first, j, float(friction.stribeck_speed[j])) for j in range(N_JOINTS)]

    def solve(self, width: int) -> _Solution:
        """The fit with ten, four or no numbers of the body; with four the body is a ball."""
        size = self._mean.shape[1]
        arm = _ARM_OFF.size
        width += arm
        own, shared = self._mean.copy(), np.zeros(width)
        weights = [np.full(len(rows.current), 1.0) for rows in self._joints]
        prior = np.concatenate([1.0 / _ARM_OFF**2, np.zeros(width - arm), (1.0 / self._off**2).ravel()])
        prior[arm + 4 : width] = 1.0 / LARGEST_INERTIA**2
        covariance = np.diag(1.0 / np.maximum(prior, 1.0))
        for _ in range(_ROUNDS):
            information, gradients = np.diag(prior), np.zeros((self._blocks, len(prior)))
            for j, rows in enumerate(self._joints):
                slope, error = _slope(rows, shared, own[j])
                at = np.r_[np.arange(width), width + j * size + np.arange(size)]
                information[np.ix_(at, at)] += slope.T @ (slope * weights[j][:, None])
                gradients[:, at] += spread.by_block(slope * (weights[j] * error)[:, None], rows.block, self._blocks)
            pull = prior * np.concatenate([-shared, (self._mean - own).ravel()])
            step = np.linalg.solve(information, gradients.sum(axis=0) + pull)
            inverse = np.linalg.inv(information)
            covariance = spread.at_least(inverse @ (gradients.T @ gradients + np.diag(prior)) @ inverse, inverse)
            shared = shared + step[:width]
            own = own + step[width:].reshape(N_JOINTS, size)
            weights = [
                _weights(rows, _slope(rows, shared, own[j])[1], self._blocks) for j, rows in enumerate(self._joints)
            ]
        own_std = np.sqrt(np.diag(covariance)[width:]).reshape(N_JOINTS, size)
        return _Solution(shared, covariance[arm:width, arm:width], own, own_std)

    def errors(self, solution: _Solution) -> np.ndarray:
        """(n_logs, 6) mean absolute error of the current in motion, A."""
        found = np.full((self._logs, N_JOINTS), np.nan)
        for j, rows in enumerate(self._joints):
            error = np.abs(_slope(rows, solution.shared, solution.own[j])[1])
            for n in range(self._logs):
                moving = (rows.log == n) & ~rows.rests
                if moving.any():
                    found[n, j] = error[moving].mean()
        return found


@dataclass(frozen=True)
class _Laden:
    """A log, the torque that its arm and its load take by the numbers of both (n, 6, 11 + 10), and the torque (n, 6)
    with
    which somebody helps the motors."""

    ride: terms.Ride
    regressor: np.ndarray
    helped: np.ndarray


def _joint_rows(rides: Sequence[_Laden], first: np.ndarray, j: int, speed: float) -> _Rows:
    found: list[_Rows] = []
    for n, laden in enumerate(rides):
        ride = laden.ride
        qd = ride.qd[:, j]
        rows = np.flatnonzero((qd == 0.0) | (np.abs(qd) > _SLIDING))
        sign = np.sign(qd)
        waves = terms.ripple_columns(ride, j, _ORDERS, _DELAY, _LAG, directed=False)
        columns = (
            np.full(len(qd), n),
            first[n] + np.arange(len(qd)) // _BLOCK,
            ride.torque[:, j] - laden.helped[:, j],
            ride.link[:, j] - laden.helped[:, j],
            qd,
            sign,
            np.exp(-((qd / speed) ** 2)) * sign,
            ride.ratio[:, j] * qd,
            waves,
            laden.regressor[:, j],
            ride.current[:, j],
        )
        found.append(_Rows(*(column[rows] for column in columns)))
    names = [field.name for field in fields(_Rows)]
    return _Rows(*(np.concatenate([getattr(part, name) for part in found]) for name in names))


def _slope(rows: _Rows, shared: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (n, width + own) of a joint's current, and its errors (n,)."""
    arm, width = _ARM_OFF.size, len(shared)
    extra = rows.regressor[:, :width] @ shared
    mass = shared[arm] if width == arm + 4 else 0.0
    if mass > 0.0:
        extra = extra + rows.regressor[:, width:] @ body.ball(mass, shared[arm + 1 :] / mass).phi[4:]
    link, torque = rows.link + extra, rows.torque + extra
    up, down = rows.sign > 0, -1.0 * (rows.sign < 0)
    columns = np.stack([torque, np.abs(link) * rows.sign, up, down, rows.fading, rows.viscous], axis=1)
    linear = np.concatenate([columns, rows.waves], axis=1)
    through = (own[0] + own[1] * rows.sign * np.sign(link))[:, None]
    return np.concatenate([through * rows.regressor[:, :width], linear], axis=1), rows.current - linear @ own


def _weights(rows: _Rows, error: np.ndarray, blocks: int) -> np.ndarray:
    """(n,) what a row counts, apart in motion and at rest: one over the variance of its error, times how many rows say
    the same thing, and less for a row that is far off (Huber 1964)."""
    weights = np.zeros(len(error))
    for which in (rows.rests, ~rows.rests):
        e = error[which]
        if len(e) < _BLOCK:
            # Less than two seconds in all tell no variance.
            continue
        robust = np.median(np.abs(e)) / 0.6745
        cut = np.minimum(1.0, _HUBER * robust / np.maximum(np.abs(e), 1e-12))
        # White noise of variance s^2 has sums of variance n s^2; errors that hang together have more.
        sums = spread.by_block((cut * e)[:, None], rows.block[which], blocks)
        weights[which] = cut / max((sums**2).sum() / len(e), robust**2)
    return weights


def _arm_columns(plant: ArmModel, q: np.ndarray, ride: terms.Ride) -> np.ndarray:
    """(n, 6, 11) torque by shares that the masses of links 2 to 6 and the rotors' inertias are off."""
    columns = np.zeros((*q.shape, _ARM_OFF.size))
    columns[:, :, : N_JOINTS - 1] = mass_columns(plant, q, ride.qd, ride.qdd)
    joints = np.arange(N_JOINTS)
    columns[:, joints, N_JOINTS - 1 + joints] = plant.rotor_inertia * ride.qdd
    return columns


def _check_motion(rides: Sequence[terms.Ride], loaded: Sequence[Recording]) -> None:
    moving = sum((ride.step @ (np.abs(ride.qd) > _SLIDING) for ride in rides), np.zeros(N_JOINTS))
    if (moving[1:4] < _SHORTEST).all():
        said = ", ".join(f"{seconds:.1f}" for seconds in moving)
        raise IdentificationError(
            f"{_names(loaded)}: none of joints 2 to 4, which carry a load, moves for {_SHORTEST:g} s (joints 1 "
            f"to 6: {said} "
            "s); what friction holds at rest hides a load"
        )


def _need(recording: Recording, signals: Sequence[str], why: str) -> None:
    missing = [name for name in signals if name not in recording.robot]
    if missing:
        raise IdentificationError(f"{recording.source}: no {', '.join(missing)}; {why}")


def _names(recordings: Sequence[Recording]) -> str:
    return ", ".join(recording.source for recording in recordings)
