"""The drives' current map from logs of free motion, and how well it predicts logs it has not seen.

Coefficients of ``drives.current_map`` are linear, by least absolute errors (reweighted least squares) with ridge
penalties. Whether a joint's map has the servo in it is chosen by the error on logs left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ur5_twin.arm.drive import LinearDrive
from ur5_twin.arm.parameters import N_JOINTS, ArmModel
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.drives import terms
from ur5_twin.drives.current_map import CurrentMap, Shape, columns, start
from ur5_twin.errors import IdentificationError
from ur5_twin.identification import residual, thesis_drive
from ur5_twin.recording.table import Recording

#: Errors below count squared, those above absolutely, A: some steps of the current's scale (2.2 mA).
_SMALL_ERROR = 0.05
_SWEEPS = 6
#: Blocks of the standard errors' estimate, rows (1 s): errors of a block may be correlated.
_BLOCK = 125
#: Spread of the torque behind a gear that is too small to tell load-dependent friction, Nm, and that term's column.
_LEAST_LOAD, _LOAD = 0.8, terms.friction_names().index("load")
#: Logs from which on the map's form is chosen.
_ENOUGH_TO_CHOOSE = 3


class Penalty(NamedTuple):
    """Ridge penalties relative to a column's mean square: on 1/k less its known value, friction and servo, ripple."""

    torque: float
    other: float
    ripple: float


class Candidate(NamedTuple):
    """A form of a joint's map with the penalties of its fit."""

    shape: Shape
    penalty: Penalty


#: Without the servo, chosen by the leave-one-out error on the lab's free logs (docs/drive.md says what that is worth).
FREE = (
    Candidate(
        Shape(False, 0.02, 0.1, 0.5, (), False, (202, 404), 0.004, 0.008, False, False), Penalty(0.03, 0.01, 1e-3)
    ),
    Candidate(Shape(False, 0.02, 0.1, 0.5, (), False, (202, 404), 0.0, 0.004, True, False), Penalty(0.3, 0.2, 0.5)),
    Candidate(Shape(False, 0.02, 0.1, 0.5, (), False, (202,), 0.002, 0.0, True, False), Penalty(30.0, 1e-3, 0.5)),
    Candidate(
        Shape(False, 0.009, 1e6, 0.5, (), False, (101, 202, 403, 404, 405, 808), 0.006, 0.002, True, False),
        Penalty(0.03, 0.05, 0.5),
    ),
    Candidate(
        Shape(False, 0.02, 10.0, 0.5, (), False, (101, 202, 303, 404, 808), 0.006, 0.0, True, False),
        Penalty(30.0, 0.5, 1e-3),
    ),
    Candidate(
        Shape(False, 0.04, 3.0, 0.5, (), False, (402, 403, 404, 405, 406), 0.004, 0.004, True, False),
        Penalty(0.3, 0.5, 0.5),
    ),
)
#: With it.
FOLLOWING = (
    Candidate(
        Shape(True, 0.02, 1.0, 0.5, (0.02, 0.05, 0.3), False, (200, 202, 404), 0.004, 0.004, False, True),
        Penalty(3.0, 0.2, 1e-3),
    ),
    Candidate(
        Shape(True, 0.16, 10.0, 10.0, (0.05, 0.3, 1.0), True, (202, 404), 0.010, 0.004, True, True),
        Penalty(0.03, 0.15, 1e-3),
    ),
    Candidate(
        Shape(True, 0.16, 1.0, 10.0, (0.05, 0.3), True, (200, 202, 404), 0.006, 0.004, False, True),
        Penalty(0.3, 0.05, 0.01),
    ),
    Candidate(
        Shape(True, 0.16, 1e6, 10.0, (0.05, 0.15, 0.5), False, (101, 202, 403, 404, 405), 0.006, 0.001, True, True),
        Penalty(3.0, 1e-3, 1e-3),
    ),
    Candidate(
        Shape(True, 0.04, 3.0, 0.5, (0.05, 0.3, 1.0), False, (101, 202, 303, 404, 808), 0.004, 0.001, True, False),
        Penalty(3.0, 0.05, 0.1),
    ),
    Candidate(
        Shape(True, 0.04, 0.1, 3.0, (0.02, 0.05, 0.3), True, (402, 403, 404, 405, 406), 0.004, 0.004, True, True),
        Penalty(3.0, 0.2, 0.1),
    ),
)
#: Name of the rigid-body model in the fits.
MODEL = "plant"


def fit_drive(
    rides: Sequence[terms.Ride], candidates: Sequence[Candidate] = FREE, torque_constant: np.ndarray | None = None
) -> CurrentMap:
    """The coefficients from logs of free motion.

    Args:
        rides: free motion, all with the same load at the flange.
        candidates: per joint.
        torque_constant: (6,) Nm/A known before, by default the controller's own, which no measured
            current went into.

    Where the torque behind a gear hardly changes, its load-dependent friction counts as none.

    Raises:
        IdentificationError: a joint never moves.
    """
    known = np.asarray(load_target_current_law().torque_constant if torque_constant is None else torque_constant)
    coefficients, errors = [], []
    for j, (shape, penalty) in enumerate(candidates):
        if not any(of.moving[:, j].sum() > _BLOCK for of in rides):
            raise IdentificationError(
                f"joint {j + 1} does not move for 1 s in {', '.join(of.source for of in rides) or 'no logs'}"
            )
        parts = []
        for of in rides:
            made, sure = columns(of, j, shape, known[j])
            rest = of.current[:, j] - sure
            parts.append((made - start(of, j, made), rest - start(of, j, rest)))
        made, rest = np.concatenate([c for c, _ in parts]), np.concatenate([r for _, r in parts])
        if np.concatenate([of.link[of.moving[:, j], j] for of in rides]).std() < _LEAST_LOAD:
            made[:, _LOAD] = 0.0
        found, spread = _least_absolute(made, rest, _penalties(shape, penalty))
        coefficients.append(found)
        errors.append(spread)
    shapes = tuple(candidate.shape for candidate in candidates)
    source = f"identified from {', '.join(of.source for of in rides)}"
    return CurrentMap("identified", source, MODEL, known, shapes, tuple(coefficients), tuple(errors), ())


def with_residuals(
    found: CurrentMap,
    candidates: Sequence[Candidate],
    rides: Sequence[terms.Ride],
    progress: Callable[[int], object] = lambda done: None,
) -> CurrentMap:
    """The map with how it errs, by fits of the same form on all logs but one; a single log is its own judge.

    Args:
        found: fitted to all the rides.
        candidates: the form it was fitted in.
        rides: the logs.
        progress: called with the number of joints done.
    """
    known = found.torque_constant
    maps = [found if len(rides) == 1 else fit_drive(_without(rides, of), candidates, known) for of in rides]
    errors = [of.current - made.current(of) for of, made in zip(rides, maps, strict=True)]
    return replace(found, residuals=residual.fit_residual(rides, errors, progress))


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


class Study(NamedTuple):
    """How the forms of the map predict logs left out.

    Attributes:
        free: without the servo.
        following: with it.
        chosen: the form of each joint that did better on the other logs, on this one.
        tared: the same with what the joints remember of earlier moves told by the current of the log's first 80 ms.
        two_step: the thesis' two-step method (``thesis_drive``).
        printed: the thesis' numbers as printed, which were fitted to a log of theirs.
        candidates: the choice, by all logs.
    """

    free: list[HeldOut]
    following: list[HeldOut]
    chosen: list[HeldOut]
    tared: list[HeldOut]
    two_step: list[HeldOut]
    printed: list[HeldOut]
    candidates: tuple[Candidate, ...]


def held_out(rides: Sequence[terms.Ride], candidates: Sequence[Candidate] = FREE) -> list[HeldOut]:
    """Each log predicted by a fit on all the others.

    Raises:
        IdentificationError: as ``fit_drive``.
    """
    return [score(unseen, fit_drive(_without(rides, unseen), candidates).current(unseen)) for unseen in rides]


def study(
    recordings: Sequence[Recording],
    rides: Sequence[terms.Ride],
    links: ArmModel,
    printed: LinearDrive,
    progress: Callable[[int], object] = lambda done: None,
) -> Study:
    """Every form on every log left out.

    Args:
        recordings: two logs or more.
        rides: the same, prepared.
        links: the rigid bodies of the thesis' method.
        printed: the thesis' own map.
        progress: called with the number of logs done.

    Raises:
        IdentificationError: as ``fit_drive``.
    """
    forms: tuple[list[HeldOut], list[HeldOut]] = ([], [])
    two_step, as_printed = [], []
    for done, (recording, unseen) in enumerate(zip(recordings, rides, strict=True), start=1):
        rest = _without(rides, unseen)
        for form, candidates in zip(forms, (FREE, FOLLOWING), strict=True):
            form.append(score(unseen, fit_drive(rest, candidates).current(unseen)))
        fit = thesis_drive.fit_two_step([other for other in recordings if other is not recording], links)
        for scores, drive in ((two_step, fit.drive), (as_printed, printed)):
            scores.append(score(unseen, thesis_drive.current(drive, recording, links)))
        progress(done)
    ratios = np.stack([[item.ratio for item in form] for form in forms])
    chosen, tared = [], []
    for k, unseen in enumerate(rides):
        candidates = _choose(np.delete(ratios, k, axis=1))
        predicted = fit_drive(_without(rides, unseen), candidates).current(unseen)
        chosen.append(score(unseen, predicted))
        left = unseen.current - predicted
        memory = [start(unseen, j, left[:, j]) for j in range(N_JOINTS)]
        tared.append(score(unseen, predicted + np.stack(memory, axis=1)))
    return Study(*forms, chosen, tared, two_step, as_printed, _choose(ratios))


def _without(rides: Sequence[terms.Ride], unseen: terms.Ride) -> list[terms.Ride]:
    return [of for of in rides if of is not unseen]


def score(of: terms.Ride, predicted: np.ndarray) -> HeldOut:
    """The errors of a prediction (n, 6) in A."""
    error, own = np.abs(predicted - of.current), np.abs(of.feed_forward - of.current)
    parts = [_means(e, rows) for e in (error, own) for rows in (of.moving, ~of.moving, of.moving | True)]
    return HeldOut(of.source, *parts)


def _choose(ratios: np.ndarray) -> tuple[Candidate, ...]:
    """Per joint the form whose worst log is better, since a new log may be like it; ratios are (2, n_logs, 6)."""
    if ratios.shape[1] < _ENOUGH_TO_CHOOSE:
        return FREE
    follow = ratios[1].max(axis=0) < ratios[0].max(axis=0)
    return tuple(FOLLOWING[j] if follow[j] else FREE[j] for j in range(N_JOINTS))


def _penalties(shape: Shape, penalty: Penalty) -> np.ndarray:
    n_ripple = len(terms.ripple_names(shape.orders, directed=shape.directed))
    n_other = len(shape.names()) - n_ripple - 1
    return np.concatenate([[penalty.torque], np.full(n_other, penalty.other), np.full(n_ripple, penalty.ripple)])


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
