"""What a joint's current is made of: friction with memory, ripple of the gear, the servo's answer to its error.

Two first-order filters with a leak that changes with the joint's state carry all memory (``a`` is a row's leak)::

    kept:    y_k = (1 - a_k) y_k-1 + a_k x_k            follows x at its pace while moving, remembers it at rest
    passed:  y_k = (1 - a_k) (y_k-1 + x_k - x_k-1)      forgets the slow part of x

Their sum is x itself, so that one signal may give the fast part of a prediction and another the slow part.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np

from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import N_JOINTS, ArmModel
from ur5_twin.control.held import commanded
from ur5_twin.control.target_current import TargetCurrentLaw, load_target_current_law
from ur5_twin.control.tcp_force import last_known, viscous_ratio
from ur5_twin.errors import RecordingError
from ur5_twin.recording.table import Recording

#: Target speed above which a joint counts as moving, rad/s: published speeds at rest are below 1e-4.
MOVING = 1e-3
#: Speeds at which sliding friction has grown by 63 %, rad/s.
RISE_SPEEDS = (0.01, 0.03, 0.1)
#: Way on which a resting joint's friction turns to oppose it by 63 %, rad: three steps of the encoder.
STICKING_WAY = 3e-5
_NEEDED = (
    "target_q",
    "target_qd",
    "target_qdd",
    "target_moment",
    "target_current",
    "actual_q",
    "actual_qd",
    "actual_current",
)


@dataclass(frozen=True)
class Ride:
    """One log, each (n, 6) but time; ratio and reference use earlier rows only.

    Attributes:
        source: the log's name.
        time: (n,) s.
        torque: Nm that the target motion needs by the plant's rigid-body model, rotors included.
        link: its part beyond the rotors, Nm.
        qd, qdd: target motion, rad/s and rad/s^2.
        ratio: viscous friction over the controller's law, its correction for temperature; 1 until it shows.
        feed_forward: target_current, A.
        angle: actual_q, rad.
        error: actual_q less the target the servo holds, rad.
        speed_error: actual_qd less target_qd, rad/s.
        current: actual_current, A.
    """

    source: str
    time: np.ndarray
    torque: np.ndarray
    link: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    ratio: np.ndarray
    feed_forward: np.ndarray
    angle: np.ndarray
    error: np.ndarray
    speed_error: np.ndarray
    current: np.ndarray

    @property
    def moving(self) -> np.ndarray:
        """(n, 6) whether a joint's target moves."""
        return np.abs(self.qd) > MOVING

    @property
    def step(self) -> np.ndarray:
        """(n,) s since the row before; the usual step for the first row."""
        steps = np.diff(self.time)
        return np.concatenate([[np.median(steps)], steps])


def missing(recording: Recording) -> list[str]:
    """Signals that a ride needs and the log lacks."""
    return [name for name in _NEEDED if name not in recording.robot]


def ride(
    recording: Recording,
    model: ArmModel,
    law: TargetCurrentLaw | None = None,
    motion: tuple[np.ndarray, np.ndarray] | None = None,
    tau_ext: np.ndarray | None = None,
) -> Ride:
    """A log for the fit and the prediction.

    Where the servo held the arm before the log's first move no signal tells, so that the position error counts as zero
    until then.

    Args:
        recording: with targets, target_moment and both currents.
        model: the plant's rigid bodies with whatever is bolted to the flange.
        law: the controller's drive law, by default the models' own.
        motion: positions and speeds, (n, 6) each, of the arm that follows the targets, by default the measured ones.
        tau_ext: (n, 6) J' F of contacts in Nm, positive accelerates; taken off what the motors must give. None if
            nothing touches the arm.

    Raises:
        RecordingError: a signal is missing or the log is shorter than 20 rows.
    """
    robot = recording.robot
    if lacking := missing(recording):
        raise RecordingError(f"{recording.source}: no {', '.join(lacking)}; a drive needs {', '.join(_NEEDED)}")
    if len(robot) < 20:
        raise RecordingError(f"{recording.source}: {len(robot)} rows, too few for a drive; 20 at least")
    q, qd, qdd = (robot[name] for name in _NEEDED[:3])
    at, speed = (robot["actual_q"], robot["actual_qd"]) if motion is None else motion
    reference = commanded(np.stack([q, qd, qdd], axis=1))[:, 0]
    started = np.maximum.accumulate((qd != 0.0).any(axis=1) | (qdd != 0.0).any(axis=1))[:, None]
    law = law or load_target_current_law()
    ratio = viscous_ratio(law, qd, robot["target_moment"], robot["target_current"])
    contact = np.zeros_like(q) if tau_ext is None else tau_ext
    return Ride(
        source=recording.source,
        time=robot.time,
        torque=Dynamics(model).inverse(reference, qd, qdd) - contact,
        link=Dynamics(replace(model, rotor_inertia=np.zeros(N_JOINTS))).inverse(reference, qd, qdd) - contact,
        qd=qd,
        qdd=qdd,
        ratio=last_known(ratio, np.ones(ratio.shape[1])),
        feed_forward=robot["target_current"],
        angle=at,
        error=np.where(started, at - reference, 0.0),
        speed_error=np.where(started, speed - qd, 0.0),
        current=robot["actual_current"],
    )


def leak(of: Ride, joint: int, moving: float, resting: float) -> np.ndarray:
    """(n,) leak per row for time constants in s while the joint moves and while it rests."""
    step = of.step
    return np.minimum(np.where(of.moving[:, joint], step / moving, step / resting), 1.0)


@numba.njit(cache=True, nogil=True)
def kept(x, a):  # pragma: no cover - compiled
    """The first filter above: columns of x (n, m) with leak a (n,); starts at x."""
    y = np.empty_like(x)
    y[0] = x[0]
    for k in range(1, x.shape[0]):
        y[k] = (1.0 - a[k]) * y[k - 1] + a[k] * x[k]
    return y


@numba.njit(cache=True, nogil=True)
def passed(x, a):  # pragma: no cover - compiled
    """The second filter above: columns of x (n, m) with leak a (n,); starts at zero."""
    y = np.zeros_like(x)
    for k in range(1, x.shape[0]):
        y[k] = (1.0 - a[k]) * (y[k - 1] + x[k] - x[k - 1])
    return y


def friction_columns(of: Ride, joint: int) -> np.ndarray:
    """(n, 8): torque, then sgn(qd) times 1, sgn(qd), |link torque|, ratio |qd| and exp(-|qd| / rise speed)."""
    qd = of.qd[:, joint]
    sign = np.where(of.moving[:, joint], np.sign(qd), 0.0)
    fading = [sign * np.exp(-np.abs(qd) / speed) for speed in RISE_SPEEDS]
    load, viscous = np.abs(of.link[:, joint]) * sign, of.ratio[:, joint] * qd
    return np.stack([of.torque[:, joint], sign, np.abs(sign), load, viscous, *fading], axis=1)


def friction_names() -> list[str]:
    """Names of ``friction_columns``."""
    return ["torque", "coulomb", "asymmetry", "load", "viscous", *(f"fading_{speed:g}" for speed in RISE_SPEEDS)]


def sticking_column(of: Ride, joint: int) -> np.ndarray:
    """(n, 1) friction of a joint that rests and is moved on its grip, from -1 to 1; 0 while its target moves.

    Over a way x of the encoder z <- e z + (1 - e) sgn(x), e = exp(-|x| / STICKING_WAY): Dahl's model of presliding. It
    begins at 0 with each rest, since what the joint stopped with is what kept() remembers.
    """
    return _sticking(np.ascontiguousarray(of.angle[:, joint]), of.moving[:, joint])[:, None]


@numba.njit(cache=True, nogil=True)
def _sticking(angle, moving):  # pragma: no cover - compiled
    z = np.zeros(len(angle))
    for k in range(1, len(angle)):
        if not moving[k]:
            way = angle[k] - angle[k - 1]
            keep = np.exp(-abs(way) / STICKING_WAY)
            z[k] = keep * z[k - 1] + (1.0 - keep) * np.sign(way)
    return z


def servo_columns(of: Ride, joint: int, times: tuple[float, ...], integral: bool) -> np.ndarray:
    """What a servo's torque follows: error and speed error of three rows, averages of the error, its integral.

    The last two columns, the target's speed and acceleration, take out that error and current are not sampled at once.

    Args:
        times: time constants of the averages, s.
        integral: whether the integral is among them.
    """
    error, speed, step = 1e3 * of.error[:, joint], 1e2 * of.speed_error[:, joint], of.step
    columns = [np.concatenate([np.full(lag, x[0]), x[: len(x) - lag]]) for lag in range(3) for x in (error, speed)]
    if integral:
        columns.append(np.cumsum(error * step) * 10.0)
    columns += [kept(error[:, None], np.minimum(step / time, 1.0))[:, 0] for time in times]
    return np.stack([*columns, of.qd[:, joint], 0.1 * of.qdd[:, joint]], axis=1)


def servo_names(times: tuple[float, ...], integral: bool) -> list[str]:
    """Names of ``servo_columns``."""
    names = [f"{of}_{lag}" for lag in range(3) for of in ("error", "speed_error")]
    return [*names, *(["integral"] if integral else []), *(f"average_{t:g}" for t in times), "speed", "acceleration"]


def ripple_columns(
    of: Ride, joint: int, orders: tuple[int, ...], delay: float, lag: float, *, directed: bool
) -> np.ndarray:
    """(n, 2 or 4 per order) cosine and sine of the order times the joint's angle, seen through a delay and a lag.

    Re and Im of exp(j n (q - delay qd)) / (1 + j n qd lag); at rest the ripple of the angle the joint rests at.

    Args:
        orders: periods a revolution, 2 pi rad of the joint.
        delay, lag: s.
        directed: add the same times sgn(qd), for ripple of friction.
    """
    qd = of.qd[:, joint]
    sign = np.where(of.moving[:, joint], np.sign(qd), 0.0)
    columns = []
    for order in orders:
        wave = np.exp(1j * order * (of.angle[:, joint] - delay * qd)) / (1.0 + 1j * order * qd * lag)
        columns += [wave.real, wave.imag] + ([wave.real * sign, wave.imag * sign] if directed else [])
    return np.stack(columns, axis=1) if columns else np.empty((len(qd), 0))


def ripple_names(orders: tuple[int, ...], *, directed: bool) -> list[str]:
    """Names of ``ripple_columns``."""
    kinds = ("cosine", "sine", "cosine_directed", "sine_directed") if directed else ("cosine", "sine")
    return [f"{kind}_{order}" for order in orders for kind in kinds]
