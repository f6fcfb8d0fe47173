"""How a force sensor sits on the flange, what it reads without load, what hangs on it, and how late its rows are.

**By weight.** Where nobody touches the tool a sensor reads its bias and what the load beyond it weighs, in its own axes
about its own origin; b is the bias at the log's begin, and wanders from there::

    y(t) = b(t) + [R_SF f; R_SF (n - p_FS x f)],   f = -(m a + (S(alpha) + S(omega)^2) m c),   n = -m c x a

with a the flange's acceleration less gravity at t + shift, and what turning the load about its own centre takes by
the tool's table.
Rows in which somebody pushes disagree with that and count nothing (Tukey's biweight).

**By pushes.** The motors' currents answer what pushes the arm, joint by joint::

    i(t) = u tau - g [J' w(t + shift)] + friction,   w = the reading less bias and load, turned into the base's axes

with a friction that depends on direction, load and speed and is fitted beside; it tells the shift, and how the sensor
is turned, without any load on it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d
from scipy.optimize import least_squares

from ur5_twin import spatial
from ur5_twin.arm import kinematics
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import FT_SENSOR, N_JOINTS, ArmModel
from ur5_twin.control.held import commanded
from ur5_twin.errors import IdentificationError
from ur5_twin.identification import spread
from ur5_twin.identification.clocks import Correlation, group_delay, smoothed
from ur5_twin.identification.flange import BAND, BLOCK, EDGE, LEVER, LINEAR, RATE, TURN, flange_felt
from ur5_twin.recording.table import Recording
from ur5_twin.sensing.specs import SensorSuite

#: Parameters of the fit by weight: s in the middle of the log, s/s, rotation vector of R_FS in rad, N and Nm, kg, kg m.
NAMES = (
    "shift",
    "drift",
    *(f"rotation_{axis}" for axis in "xyz"),
    *(f"bias_{axis}" for axis in ("fx", "fy", "fz", "mx", "my", "mz")),
    "mass",
    *(f"moment_{axis}" for axis in "xyz"),
)
SHIFT, DRIFT, ROTATION, BIAS, MASS, MOMENT = 0, 1, slice(2, 5), slice(5, 11), 11, slice(12, 15)
#: How far each may be off what is known, one standard deviation: a sensor's clock, its mounting, its bias, and a load
#: that the tool's table does not have.
_OFF = np.array([0.2, 1e-3, *np.full(3, 1.5), *np.full(3, 100.0), *np.full(3, 10.0), 0.1, *np.full(3, 0.01)])
#: Errors that no sensor is below, N and Nm.
_LEAST = np.array([2e-3, 2e-3, 2e-3, 1e-4, 1e-4, 1e-4])
#: Standard deviations beyond which a row is somebody's push.
_CUT = 5.0
#: Times that it is one for sure, and the s around it that are not free either.
_SURE, _AROUND = 3.0, 0.4
#: Rounds, of which the first count far rows less and the later ones not at all.
_ROUNDS, _GENTLE = 12, 5
#: By how much of itself gravity must turn in the flange's axes to tell weight from bias.
_TURNED = 0.2
#: Of the fit by weight.
_REFINED = 4
#: A load tells the sensor's axes if its weight shows alike along all of them, and if it is more than this, kg.
_ALIKE, _HEAVY = 0.7, 0.02
#: A mounting that nothing tells stays as it is known, rad.
_KEPT = 1e-3
#: An adapter's holes let a sensor be mounted turned about its axis, and hardly askew, one standard deviation, rad.
_TILTED = np.array([0.1, 0.1, 0.5])
#: Turns about the sensor's axis that pushes are tried with, rad.
_TURNS = (0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi)
#: The bias wanders, as fast as the preset says; between such times along a line, s.
_WANDER = 5.0
#: Rows are closer than the low-pass lets them differ: by so much a row counts less, in deviations.
_ALIKE_ROWS = float(np.sqrt(RATE / (2.0 * BAND)))
#: Of a block of correlated errors, s: a bias wanders slowly.
_BLOCK = 2.0
#: Fewer free rows than these tell nothing, s.
_FREE = 0.5
#: Shifts tried for the pushes, s, and a push that is one, Nm.
_SHIFTS, _PUSHED = np.arange(-0.3, 0.3001, 0.01), 1.5
#: The motors answer a push through the servo, which works in ticks, s.
_TICK = 0.008
#: Speed at which friction is fully there, rad/s.
_RISE = 0.03


@dataclass(frozen=True)
class PushFit:
    """What pushes tell.

    Attributes:
        shift, shift_std: s in the middle of the log.
        drift, drift_std: s/s.
        turn, turn_std: (3,) rotation vector of R_FS beyond the one by weight or the preset, rad.
        explained: (6,) share of the current's variance beside motion and friction that the pushes explain; NaN for
            joints that no push loads.
        clock: that over the shift, all joints together.
    """

    shift: float
    shift_std: float
    drift: float
    drift_std: float
    turn: np.ndarray
    turn_std: np.ndarray
    explained: np.ndarray
    clock: Correlation


@dataclass(frozen=True)
class FtFit:
    """What one log says.

    Attributes:
        source: the log.
        values, std: (15,) in the order of ``NAMES``, by weight.
        free: share of the rows that nobody touches.
        turns: whether the flange's orientation changed enough to tell bias from weight.
        before, after: (6,) root mean square errors over the free rows, N and Nm: bias from the first row alone, and
            with what was found.
        pushes: what pushes say; None without any.
        offset: s, of the sensor's clock on the robot's by the host's stamps; None if they do not tell.
        time: (n,) s.
        reading, predicted: (n, 6)
        untouched: (n,) which rows are free.
    """

    source: str
    values: np.ndarray
    std: np.ndarray
    free: float
    turns: bool
    before: np.ndarray
    after: np.ndarray
    pushes: PushFit | None
    offset: float | None
    time: np.ndarray
    reading: np.ndarray
    predicted: np.ndarray
    untouched: np.ndarray


def fit_ft(recording: Recording, arm: ArmModel, suite: SensorSuite) -> FtFit:
    """Bias, mounting, load and clock of the force sensor of one log.

    Args:
        recording: with actual_q, actual_qd and ft_wrench.
        arm: kinematics, gravity, and the tool that carries the sensor, with what hangs on it by its table.
        suite: the devices as they are known.

    Raises:
        IdentificationError: a signal is missing or the sensor is never free of contact.
    """
    table = recording.tables.get("ft")
    if table is None or "ft_wrench" not in table:
        raise IdentificationError(f"{recording.source}: no ft_wrench; record the force sensor")
    assert arm.tool is not None
    p_FS = arm.tool.sensors[FT_SENSOR]
    mass, center, tensor = arm.tool.distal_to(FT_SENSOR)
    time, felt = flange_felt(recording, arm)
    offset = recording.offset("ft")
    known = np.isfinite(table["ft_wrench"]).all(axis=1) & np.append(np.diff(table.time) > 0, True)
    grid, smooth = smoothed(table.time[known] + (offset or 0.0), table["ft_wrench"][known], BAND)
    rows = np.flatnonzero((grid > time[0] + EDGE) & (grid < time[-1] - EDGE))
    rows = rows[:: round(len(grid) / (grid[-1] - grid[0]) / RATE)]
    if len(rows) < RATE:
        raise IdentificationError(f"{recording.source}: robot and force sensor have less than 1 s in common")
    stamp, reading = grid[rows], smooth[rows]
    spline = CubicSpline(time, felt)
    late = group_delay(suite.ft.bandwidth)

    middle = float(stamp.mean())
    knots = np.linspace(stamp[0], stamp[-1], max(2, round((stamp[-1] - stamp[0]) / _WANDER) + 1))
    between = np.stack([np.interp(stamp, knots, hat) for hat in np.eye(len(knots))], axis=1)

    def predict(x: np.ndarray) -> np.ndarray:
        then = spline(stamp + x[SHIFT] + x[DRIFT] * (stamp - middle) - late)
        a, omega, lever = then[:, LINEAR], then[:, TURN], then[:, LEVER].reshape(-1, 3, 3)
        # S(omega)^2 is symmetric, so that alpha is what is not.
        alpha = 0.5 * np.stack(
            [lever[:, 2, 1] - lever[:, 1, 2], lever[:, 0, 2] - lever[:, 2, 0], lever[:, 1, 0] - lever[:, 0, 1]], axis=1
        )
        spin = alpha @ tensor + np.cross(omega, omega @ tensor)
        wrench = np.concatenate([-(x[MASS] * a + lever @ x[MOMENT]), -np.cross(x[MOMENT], a) - spin], axis=1)
        R_SF = spatial.rotation_from_vector(x[ROTATION]).T
        wander = between @ np.concatenate([np.zeros((1, 6)), x[len(NAMES) :].reshape(-1, 6)])
        return spatial.rotate_wrench(R_SF, spatial.shift_wrench(wrench, p_FS)) + x[BIAS] + wander

    prior = np.zeros(len(NAMES))
    prior[SHIFT] = -suite.ft.delay
    prior[ROTATION], prior[MASS], prior[MOMENT] = suite.ft_mount, mass, mass * center
    first = reading[: max(1, int(EDGE * RATE))].mean(axis=0)
    linear, weight = _linear(spline(stamp + prior[SHIFT] - late)[:, LINEAR], reading)
    start, told = prior.copy(), _rotation(linear)
    start[BIAS] = linear[0]
    off = _OFF.copy()
    if told is None:
        off[ROTATION] = _KEPT
    else:
        start[ROTATION] = told
    known_by = _known_by(off, _LEAST if suite.ft.drift is None else suite.ft.drift, knots)
    x, jacobian, error, weight = _by_weight(predict, between, reading, start, prior, known_by, weight)
    free = weight.max(axis=1) > 0
    if free.sum() < _FREE * RATE:
        raise IdentificationError(
            f"{recording.source}: the force sensor is free of contact for {free.sum() / RATE:.2f} s; leave it "
            f"alone for "
            f"{_FREE:g} s at least, better in several orientations"
        )
    gravity = spline(stamp[free])[:, LINEAR]
    block = np.repeat(((stamp - stamp[0]) / _BLOCK).astype(int), 6)
    information = known_by.T @ known_by
    covariance = spread.at_least(
        spread.sandwich(jacobian, error, block, information), np.linalg.inv(jacobian.T @ jacobian + information)
    )
    predicted = predict(x)
    x, std = x[: len(NAMES)], np.sqrt(np.diag(covariance))[: len(NAMES)]
    turns = bool(np.linalg.norm(gravity - gravity.mean(axis=0), axis=1).max() > _TURNED * arm.gravity)
    after = np.sqrt(((reading - predicted)[free] ** 2).mean(axis=0))
    # Rounding to whole counts of the gauges hides what is less, the same way all over a log.
    hidden = np.zeros(6) if suite.ft.gauges is None else np.sqrt((suite.ft.gauges**2).sum(axis=1) / 12.0)
    force, moment = np.linalg.norm(hidden[:3]), np.linalg.norm(hidden[3:])
    std[BIAS] = np.hypot(std[BIAS], hidden)
    std[ROTATION] = np.hypot(std[ROTATION], force / (arm.gravity * max(float(x[MASS]), _HEAVY)))
    std[MASS] = np.hypot(std[MASS], force / arm.gravity)
    std[MOMENT] = np.hypot(std[MOMENT], moment / arm.gravity)
    if told is None:
        std[ROTATION] = np.nan
        if turns:
            # No weight reads like this: what the fit leaves is no noise but something else, and may hide in the rest.
            std[BIAS] = np.hypot(std[BIAS], after)
            std[MASS] = np.hypot(std[MASS], np.linalg.norm(after[:3]) / arm.gravity)
            std[MOMENT] = np.hypot(std[MOMENT], np.linalg.norm(after[3:]) / arm.gravity)
    pushes = _by_pushes(recording, arm, x, p_FS, suite, told is None) if (~free).any() else None
    before = reading[free] - first
    return FtFit(
        source=recording.source,
        values=x,
        std=std,
        free=float(free.mean()),
        turns=turns,
        before=np.sqrt((before**2).mean(axis=0)),
        after=after,
        pushes=pushes,
        offset=offset,
        time=stamp + x[SHIFT],
        reading=reading,
        predicted=predicted,
        untouched=free,
    )


def _known_by(off: np.ndarray, drift: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """(k, k) root of the information there was before: of each number by itself, of a bias that wanders by its
    steps."""
    steps = np.eye(len(knots) - 1) - np.eye(len(knots) - 1, k=-1)
    wander = np.kron(steps, np.diag(1.0 / (drift * np.sqrt(knots[1] - knots[0]))))
    root = np.zeros((len(off) + len(wander),) * 2)
    root[: len(off), : len(off)] = np.diag(1.0 / off)
    root[len(off) :, len(off) :] = wander
    return root


def _linear(acceleration: np.ndarray, reading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(4, 6) bias and slopes of the reading over the acceleration, and weights (n, 6), by rows that agree with each
    other."""
    columns = np.concatenate([np.ones((len(acceleration), 1)), acceleration], axis=1)
    row = np.ones((len(reading), 1))
    scale, solution = np.ones(6), np.zeros((4, 6))
    for round_ in range(_ROUNDS):
        solution = np.linalg.lstsq(columns * row, reading * row, rcond=None)[0]
        error = np.abs(reading - columns @ solution)
        scale = np.maximum(np.median(error, axis=0) / 0.6745, _LEAST)
        distance = (error / scale).max(axis=1, keepdims=True)
        # Far rows count less at first, and not at all in the end.
        row = 1.0 / np.maximum(distance, 1.0) if round_ < _GENTLE else np.maximum(0.0, 1.0 - (distance / _CUT) ** 2)
    return solution, row / scale


def _rotation(linear: np.ndarray) -> np.ndarray | None:
    """Rotation vector of R_FS from slopes that are -m R_SF, of one size along every axis; None if they are not."""
    u, size, v = np.linalg.svd(-linear[1:, :3].T)
    if size[2] < _ALIKE * size[0] or size[0] < _HEAVY or np.linalg.det(u @ v) < 0:
        return None
    return spatial.vector_from_rotation((u @ v).T)


def _by_weight(
    predict: Callable[[np.ndarray], np.ndarray],
    between: np.ndarray,
    reading: np.ndarray,
    x: np.ndarray,
    prior: np.ndarray,
    known_by: np.ndarray,
    weight: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Parameters, weighted Jacobian and errors, and weights (n, 6) of the fit to the rows without pushes."""
    more = np.zeros(len(known_by) - len(x))
    x, prior = np.concatenate([x, more]), np.concatenate([prior, more])
    low = np.full(len(x), -np.inf)
    low[MASS] = -1e-9
    constant = np.concatenate([np.ones((len(between), 1)), between[:, 1:]], axis=1)
    constant = np.kron(constant, np.eye(6))

    def slopes(y: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Of the residuals: by differences where predict bends, from predict itself where it does not."""
        columns, here = np.empty((reading.size, len(y))), predict(y)
        columns[:, BIAS], columns[:, len(NAMES) :] = constant[:, :6], constant[:, 6:]
        for k in range(len(NAMES)):
            if not BIAS.start <= k < BIAS.stop:
                step = 1e-6 if k < BIAS.start else 1.0
                columns[:, k] = ((predict(y + step * np.eye(len(y))[k]) - here) / step).ravel()
        return np.concatenate([columns * w.reshape(-1, 1), known_by])

    for _ in range(_REFINED):
        found = least_squares(
            lambda y, w: np.concatenate([((predict(y) - reading) * w).ravel(), known_by @ (y - prior)]),
            np.maximum(x, low + 1e-9),
            x_scale=np.linalg.norm(np.linalg.inv(known_by), axis=1),
            bounds=(low, np.full(len(x), np.inf)),
            jac=slopes,  # type: ignore  # scipy takes a function as well
            args=(weight,),
            max_nfev=8,
        )
        x = found.x
        error = predict(x) - reading
        scale = np.maximum(np.median(np.abs(error[weight.max(axis=1) > 0]), axis=0) / 0.6745, _LEAST) * _ALIKE_ROWS
        distance = _ALIKE_ROWS * np.abs(error / scale).max(axis=1, keepdims=True)
        # The low-pass spreads a push over what is before and after it.
        near = maximum_filter1d(distance > _SURE * _CUT, 2 * round(_AROUND * RATE) + 1, axis=0)
        weight = np.where(near, 0.0, np.maximum(0.0, 1.0 - (distance / _CUT) ** 2)) / scale
    return x, found.jac[: reading.size], found.fun[: reading.size], weight


def _by_pushes(
    recording: Recording, arm: ArmModel, x: np.ndarray, p_FS: np.ndarray, suite: SensorSuite, turns: bool
) -> PushFit | None:
    """Shift, and turn if it is not known, by the motors' answer; None where nobody pushes, or the log lacks currents
    or targets."""
    robot = recording.robot
    needed = ("target_q", "target_qd", "target_qdd", "actual_q", "actual_current")
    if any(name not in robot for name in needed):
        return None
    targets = commanded(np.stack([robot[name] for name in needed[:3]], axis=1))
    q, qd, qdd = (targets[:, k] for k in range(3))
    torque = Dynamics(arm).inverse(q, qd, qdd)
    actual = robot["actual_q"]
    R_BF, J = kinematics.forward(arm, actual)[:, :3, :3], kinematics.jacobian(arm, actual)
    table = recording.tables["ft"]
    known = np.isfinite(table["ft_wrench"]).all(axis=1) & np.append(np.diff(table.time) > 0, True)
    stamp = table.time[known] + (recording.offset("ft") or 0.0)
    # Of the load beyond the sensor only the weight matters beside a push.
    weight = np.stack([*(-x[MASS] * arm.gravity * R_BF[:, 2].T), *np.zeros((3, len(q)))], axis=1)
    weight[:, 3:] = np.cross(x[MOMENT] / x[MASS] if x[MASS] else np.zeros(3), weight[:, :3])
    late = group_delay(suite.ft.bandwidth)
    rise = np.tanh(qd / _RISE)
    reading = CubicSpline(stamp, table["ft_wrench"][known] - x[BIAS])

    middle = float(robot.time.mean())

    def answer(y: np.ndarray) -> np.ndarray:
        """(n, 6) J' w, Nm, by shift, drift and turn."""
        at = np.clip(robot.time - y[0] - y[1] * (robot.time - middle) + late, stamp[0], stamp[-1])
        R_FS = spatial.rotation_from_vector(x[ROTATION]) @ spatial.rotation_from_vector(y[2:])
        at_flange = spatial.shift_wrench(spatial.rotate_wrench(R_FS, reading(at)), -p_FS) - weight
        return np.einsum("nij,ni->nj", J, spatial.rotate_wrench(R_BF, at_flange))

    plain = np.stack([torque, rise, np.abs(torque) * rise, qd, np.ones_like(q)], axis=2)
    every = round(1.0 / RATE / np.median(np.diff(robot.time)))

    def slow(values: np.ndarray) -> np.ndarray:
        flat = values.reshape(len(values), -1)
        grid, smooth = smoothed(robot.time, flat, BAND)
        at = robot.time[::every][1:-1]
        picked = np.stack([np.interp(at, grid, column) for column in smooth.T], axis=1)
        return picked.reshape(len(at), *values.shape[1:])

    current, motion = slow(robot["actual_current"]), slow(plain)
    sizes = np.percentile(np.abs(slow(answer(np.array([x[SHIFT], 0.0, 0.0, 0.0, 0.0])))), 99, axis=0)
    pushed = np.flatnonzero(sizes > _PUSHED)
    if not len(pushed):
        return None
    # Beside motion and friction: what they explain is taken off both sides of each joint.
    off = [_rejector(motion[:, j]) for j in pushed]
    left = [off_j(current[:, j]) for off_j, j in zip(off, pushed, strict=True)]
    scale = np.array([part.std() for part in left])

    def errors(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, joints) what the pushes leave of the currents, in their own deviations, and the share explained."""
        pushes = slow(answer(y))
        error, explained = [], []
        for k, j in enumerate(pushed):
            column = off[k](pushes[:, j])
            # A motor works against a push, never with it.
            gain = min(0.0, float(column @ left[k]) / max(float(column @ column), 1e-12))
            error.append((left[k] - gain * column) / scale[k])
            explained.append(1.0 - error[-1].var())
        return np.stack(error, axis=1), np.array(explained)

    curves = {
        turn: np.array([errors(np.array([shift, 0.0, 0.0, 0.0, turn]))[1].mean() for shift in _SHIFTS])
        for turn in (_TURNS if turns else _TURNS[:1])
    }
    turn = max(curves, key=lambda key: curves[key].max())
    start = np.array([_SHIFTS[int(np.argmax(curves[turn]))], 0.0, 0.0, 0.0, turn])
    # Weight knows the sensor's axes better than pushes do.
    known_by = np.array([0.3, _OFF[DRIFT], *(_TILTED if turns else np.full(3, _KEPT))])
    steps = np.array([0.01, 1e-3, 0.01, 0.01, 0.01])
    middle_of = np.array([0.0, 0.0, 0.0, 0.0, turn])
    result = least_squares(
        lambda y: np.concatenate([errors(y)[0].ravel(), (y - middle_of) / known_by]),
        start,
        x_scale=steps,
        diff_step=1e-3,
    )
    error, explained = errors(result.x)
    block = np.repeat(np.arange(len(error)) // round(BLOCK * RATE), len(pushed))
    covariance = spread.sandwich(
        result.jac[: error.size] / error.std(), error.ravel() / error.std(), block, np.diag(1.0 / known_by**2)
    )
    std = np.sqrt(np.diag(covariance))
    std[0] = np.hypot(std[0], _TICK)
    shares = np.full(N_JOINTS, np.nan)
    shares[pushed] = explained
    clock = Correlation(_SHIFTS, np.sqrt(np.maximum(curves[turn], 0.0)), float(result.x[0]))
    y = result.x
    return PushFit(
        shift=float(y[0]),
        shift_std=float(std[0]),
        drift=float(y[1]),
        drift_std=float(std[1]),
        turn=y[2:],
        turn_std=std[2:],
        explained=shares,
        clock=clock,
    )


def _rejector(columns: np.ndarray):
    basis = np.linalg.svd(columns / (np.linalg.norm(columns, axis=0) + 1e-12), full_matrices=False)[0]
    return lambda y: y - basis @ (basis.T @ y)
