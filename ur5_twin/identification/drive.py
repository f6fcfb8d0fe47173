"""The real drives: from torque and motion to the measured current, with the gears' ripple and what rest remembers.

Per joint, with kept() and passed() of ``drive_terms``::

    i = kept(tau / k + friction) + ripple(q) [+ passed(i_target + PID(error))]

- tau is the plant's inverse dynamics of the target motion; friction is Coulomb (per direction), load-dependent, viscous
  with the controller's own correction for temperature, and falls towards standstill; kept() lets a joint at rest
  remember the friction it stopped with.
- ripple has whole periods per revolution of the joint: 404 (four per motor turn at gear 101) and its neighbours for the
  small joints, 200, 202 and 404 for the big ones. It stays at rest, where it is a constant that depends on the angle.
- the bracket is the servo: feed-forward and the answer to the measured position error, of which only the fast part
  counts while the joint moves. It predicts the current best, and it contains every push the servo answers: an estimator
  of contact does without it (``servo=False``, as it is unless asked for).

Coefficients are linear, by least absolute errors (reweighted least squares) with ridge penalties.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ur5_twin.arm.parameters import N_JOINTS, ArmModel
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.errors import IdentificationError
from ur5_twin.identification import drive_terms as terms
from ur5_twin.recording.table import Recording

#: Rows before the first move whose mean current tells what the joints remember of earlier moves, 80 ms.
_TARE_ROWS = 10
#: Time constant with which that is forgotten once a joint moves, s.
_TARE_FORGOTTEN = 0.1
#: A joint at rest for ever forgets nothing, s.
_NEVER = 1e9
#: Errors below count squared, those above absolutely, A: some steps of the current's scale (2.2 mA).
_SMALL_ERROR = 0.05
_SWEEPS = 6
#: Blocks of the standard errors' estimate, rows (1 s): errors of a block may be correlated.
_BLOCK = 125


class Shape(NamedTuple):
    """How a joint's terms remember and see the ripple. Times in s; penalties relative to a column's mean square.

    Attributes:
        moving: of kept() and passed() while the joint moves.
        forgetting, servo_forgetting: of kept() and of passed() while it rests.
        averages: time constants of the averaged position error.
        integral: whether the servo has an integral.
        orders: of the ripple, periods per revolution.
        delay, lag: of the ripple's answer in the current.
        directed: whether the ripple differs with the direction.
        torque_penalty, penalty, ripple_penalty: on 1/k less its known value, on friction and servo, on the ripple.
    """

    moving: float
    forgetting: float
    servo_forgetting: float
    averages: tuple[float, ...]
    integral: bool
    orders: tuple[int, ...]
    delay: float
    lag: float
    directed: bool
    torque_penalty: float
    penalty: float
    ripple_penalty: float


#: Without the servo, chosen by the leave-one-out error on the lab's free logs (docs/drive.md says what that is worth).
SHAPES = (
    Shape(0.02, 0.1, 0.5, (), False, (202, 404), 0.004, 0.008, False, 0.03, 0.01, 1e-3),
    Shape(0.02, 0.1, 0.5, (), False, (202, 404), 0.0, 0.004, True, 0.3, 0.2, 0.5),
    Shape(0.02, 0.1, 0.5, (), False, (202,), 0.002, 0.0, True, 30.0, 1e-3, 0.5),
    Shape(0.009, 1e6, 0.5, (), False, (101, 202, 403, 404, 405, 808), 0.006, 0.002, True, 0.03, 0.05, 0.5),
    Shape(0.02, 10.0, 0.5, (), False, (101, 202, 303, 404, 808), 0.006, 0.0, True, 30.0, 0.5, 1e-3),
    Shape(0.04, 3.0, 0.5, (), False, (402, 403, 404, 405, 406), 0.004, 0.004, True, 0.3, 0.5, 0.5),
)
#: With it.
SERVO_SHAPES = (
    Shape(0.02, 1.0, 0.5, (0.02, 0.05, 0.3), False, (200, 202, 404), 0.004, 0.004, False, 3.0, 0.2, 1e-3),
    Shape(0.16, 10.0, 10.0, (0.05, 0.3, 1.0), True, (202, 404), 0.010, 0.004, True, 0.03, 0.05, 1e-3),
    Shape(0.16, 1.0, 10.0, (0.05, 0.3), True, (200, 202, 404), 0.006, 0.004, False, 0.3, 0.05, 0.01),
    Shape(0.16, 1e6, 10.0, (0.05, 0.15, 0.5), False, (101, 202, 403, 404, 405), 0.006, 0.001, True, 3.0, 1e-3, 1e-3),
    Shape(0.04, 3.0, 0.5, (0.05, 0.3, 1.0), False, (101, 202, 303, 404, 808), 0.004, 0.001, True, 3.0, 0.05, 0.1),
    Shape(0.04, 0.1, 3.0, (0.02, 0.05, 0.3), True, (402, 403, 404, 405, 406), 0.004, 0.004, True, 3.0, 0.2, 0.1),
)


@dataclass(frozen=True)
class DriveFit:
    """Coefficients of the map to current.

    Attributes:
        torque_constant: (6,) known torque constants that 1/k is measured from, Nm/A.
        shapes: per joint.
        coefficients: per joint, in the order of the columns.
        errors: their standard errors, from the Jacobian with blocks of 1 s.
        servo: whether the servo's answer to the measured error is in it.
    """

    torque_constant: np.ndarray
    shapes: tuple[Shape, ...]
    coefficients: tuple[np.ndarray, ...]
    errors: tuple[np.ndarray, ...]
    servo: bool

    def __post_init__(self) -> None:
        if not (self.torque_constant > 0).all():
            raise IdentificationError(f"drive: torque constants must be positive, not {self.torque_constant} Nm/A")


def fit_drive(
    recordings: Sequence[Recording],
    model: ArmModel,
    torque_constant: np.ndarray | None = None,
    *,
    servo: bool = False,
    shapes: Sequence[Shape] | None = None,
) -> DriveFit:
    """The coefficients from logs of free motion.

    Args:
        recordings: free motion, all with the same load at the flange.
        model: the plant's rigid bodies with that load.
        torque_constant: (6,) Nm/A known before, by default the controller's own, which no measured
            current went into.
        servo: with the servo's answer to the measured position error.
        shapes: per joint, by default ``SERVO_SHAPES`` or ``SHAPES``.

    Raises:
        IdentificationError: a signal is missing, or a joint never moves.
    """
    return fit_rides([terms.ride(r, model) for r in recordings], torque_constant, servo=servo, shapes=shapes)


def fit_rides(
    rides: Sequence[terms.Ride],
    torque_constant: np.ndarray | None = None,
    *,
    servo: bool = False,
    shapes: Sequence[Shape] | None = None,
) -> DriveFit:
    """``fit_drive`` for logs already prepared."""
    known = np.asarray(load_target_current_law().torque_constant if torque_constant is None else torque_constant)
    chosen = tuple(shapes or (SERVO_SHAPES if servo else SHAPES))
    coefficients, errors = [], []
    for j, shape in enumerate(chosen):
        if not any(of.moving[:, j].sum() > _BLOCK for of in rides):
            raise IdentificationError(
                f"joint {j + 1} does not move for 1 s in {', '.join(of.source for of in rides) or 'no logs'}"
            )
        parts = [_tared(of, j, *_terms(of, j, shape, known[j], servo)) for of in rides]
        columns, rest = np.concatenate([c for c, _ in parts]), np.concatenate([r for _, r in parts])
        found, spread = _least_absolute(columns, rest, _penalties(shape, columns.shape[1]))
        coefficients.append(found)
        errors.append(spread)
    return DriveFit(known, chosen, tuple(coefficients), tuple(errors), servo)


def predict_current(fit: DriveFit, of: terms.Ride, *, tare: bool = False) -> np.ndarray:
    """Expected actual_current (n, 6) in A; row k uses rows up to k only.

    Args:
        fit: from other logs.
        of: the log.
        tare: take what the joints remember at the log's start from actual_current of its first ten rows (80 ms), as a
            force sensor is tared; those rows then use one another. Without it no current is used.
    """
    predicted = np.empty_like(of.current)
    for j, (shape, x) in enumerate(zip(fit.shapes, fit.coefficients, strict=True)):
        columns, rest = _terms(of, j, shape, fit.torque_constant[j], fit.servo)
        if tare:
            columns, rest = _tared(of, j, columns, rest)
        predicted[:, j] = of.current[:, j] - rest + columns @ x
    return predicted


class HeldOut(NamedTuple):
    """Mean absolute error of the current in A for a log that the fit has not seen, each (6,).

    Attributes:
        source: the log's name.
        moving, resting, whole: of the prediction, over the rows named; NaN where there are none.
        own_moving, own_resting, own: of the controller's target_current.
    """

    source: str
    moving: np.ndarray
    resting: np.ndarray
    whole: np.ndarray
    own_moving: np.ndarray
    own_resting: np.ndarray
    own: np.ndarray

    @property
    def ratio(self) -> np.ndarray:
        """(6,) whole error over the controller's own."""
        return self.whole / self.own


def held_out(
    recordings: Sequence[Recording], model: ArmModel, torque_constant: np.ndarray | None = None, *, servo: bool = False
) -> list[HeldOut]:
    """Each log predicted by a fit on all the others.

    Raises:
        IdentificationError: as ``fit_drive``.
    """
    rides = [terms.ride(r, model) for r in recordings]
    table = []
    for k, unseen in enumerate(rides):
        fit = fit_rides([of for i, of in enumerate(rides) if i != k], torque_constant, servo=servo)
        error = np.abs(predict_current(fit, unseen) - unseen.current)
        own = np.abs(unseen.feed_forward - unseen.current)
        parts = [
            _means(e, rows) for e in (error, own) for rows in (unseen.moving, ~unseen.moving, unseen.moving | True)
        ]
        table.append(HeldOut(unseen.source, *parts))
    return table


def _terms(of: terms.Ride, j: int, shape: Shape, constant: float, servo: bool) -> tuple[np.ndarray, np.ndarray]:
    """Columns (n, m) and the current (n,) less what is known of it."""
    slow = terms.kept(terms.friction_columns(of, j), terms.leak(of, j, shape.moving, shape.forgetting))
    rest = of.current[:, j] - slow[:, 0] / constant
    columns = [slow]
    if servo:
        a = terms.leak(of, j, shape.moving, shape.servo_forgetting)
        columns.append(terms.passed(terms.servo_columns(of, j, shape.averages, shape.integral), a))
        rest = rest - terms.passed(of.feed_forward[:, j : j + 1], a)[:, 0]
    columns.append(terms.ripple_columns(of, j, shape.orders, shape.delay, shape.lag, directed=shape.directed))
    return np.concatenate(columns, axis=1), rest


def _tared(of: terms.Ride, j: int, columns: np.ndarray, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both less their start, which is forgotten as the joint moves."""
    memory = np.cumprod(1.0 - terms.leak(of, j, _TARE_FORGOTTEN, _NEVER))
    columns = columns - columns[:_TARE_ROWS].mean(axis=0) * memory[:, None]
    return columns, rest - rest[:_TARE_ROWS].mean() * memory


def _penalties(shape: Shape, n_columns: int) -> np.ndarray:
    n_ripple = len(shape.orders) * (4 if shape.directed else 2)
    n_other = n_columns - n_ripple - 1
    return np.concatenate(
        [[shape.torque_penalty], np.full(n_other, shape.penalty), np.full(n_ripple, shape.ripple_penalty)]
    )


def _least_absolute(columns: np.ndarray, rest: np.ndarray, penalties: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients and their standard errors (m,)."""
    scale = np.sqrt((columns**2).mean(axis=0)) + 1e-12
    unit, n = columns / scale, len(rest)
    weight, found = np.ones(n), np.zeros(columns.shape[1])
    normal = np.eye(columns.shape[1])
    for _ in range(_SWEEPS):
        weighted = unit * weight[:, None]
        normal = unit.T @ weighted / n + np.diag(penalties)
        found = np.linalg.solve(normal, weighted.T @ rest / n)
        weight = 1.0 / np.maximum(np.abs(rest - unit @ found), _SMALL_ERROR)
    scores = unit * (np.clip(rest - unit @ found, -_SMALL_ERROR, _SMALL_ERROR) / _SMALL_ERROR)[:, None]
    blocks = np.add.reduceat(scores, np.arange(0, n, _BLOCK))
    inverse = np.linalg.inv(normal)
    spread = np.sqrt(np.diagonal(inverse @ (blocks.T @ blocks) @ inverse)) / n
    return found / scale, spread / scale


def _means(error: np.ndarray, rows: np.ndarray) -> np.ndarray:
    count, total = rows.sum(axis=0), np.where(rows, error, 0.0).sum(axis=0)
    return np.divide(total, count, out=np.full(N_JOINTS, np.nan), where=count > 0)
