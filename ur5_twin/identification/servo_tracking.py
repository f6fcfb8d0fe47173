"""What moving logs tell of the servo: its lag and its share of the target's acceleration.

With exact linearisation every joint's error e = q - q_d + T qd_d follows

    e'' + K1 e' + K0 e + KI int(e) dt = (A - 1) qdd_d + T qddd_d

so that q - q_d is linear in T (s) and A - 1 once the gains are known, and T and A come from linear least absolute
deviations (iteratively reweighted), which neither the ripple's tails nor a reversal of friction pulls away. Their
intervals are those of a jackknife over blocks of seconds, because residuals of friction and ripple follow each
other, or over whole logs where that is wider.
First order in time, the error is (A - 1) / K0 times the acceleration: A says what the servo makes of the acceleration
only with the K0 it was fitted with. A negative A is a reference that is smoothed, not a feed-forward of wrong sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import bilinear, lfilter

from ur5_twin.arm.parameters import N_JOINTS
from ur5_twin.control.gains import Gains
from ur5_twin.errors import IdentificationError
from ur5_twin.evaluation.reporting import held_targets
from ur5_twin.identification.jackknife import half_widths
from ur5_twin.recording.table import Recording

_SIGNALS = ("actual_q", "actual_qd", "actual_current", "target_current", "target_q", "target_qd", "target_qdd")
#: Target speed above which a joint counts as moving, rad/s.
_MOVING = 0.01
#: A joint that moves for less, s, or whose target's acceleration spreads less, rad/s^2, tells no lag, no share.
_LEAST_TIME, _LEAST_ACCELERATION = 5.0, 0.05
#: Step of the linear model, s: the closed loop's, some hundredth of its period.
_STEP = 2e-3
#: Rounds of reweighting, and the error below which all count alike: some encoder steps of 9.6 urad, rad.
_ROUNDS, _SMALL = 15, 3e-5
#: Length of the jackknife's blocks, s: longer than a servo's memory (KP / KI is some 0.1 s) and than a move's half.
_BLOCK = 2.0
#: More blocks than a log has.
_BLOCKS = 100_000


@dataclass(frozen=True)
class Tracking:
    """Lag and acceleration share, each (6,); the base gains' where a joint does not tell.

    Attributes:
        gains: the base gains with both put in.
        lag_interval, share_interval: (6, 2) 95 %, NaN where the logs do not tell.
        told: (6,) whether they do.
    """

    gains: Gains
    lag_interval: np.ndarray
    share_interval: np.ndarray
    told: np.ndarray


def is_standstill(recording: Recording) -> bool:
    """Whether the log's target never moves.

    Raises:
        IdentificationError: a signal is missing.
    """
    missing = [name for name in _SIGNALS if name not in recording.robot]
    if missing:
        raise IdentificationError(f"{recording.source}: no {', '.join(missing)}; the fit needs {', '.join(_SIGNALS)}")
    return not np.any(recording.robot["target_qd"])


def tracking_error(recording: Recording) -> np.ndarray:
    """(n, 6) actual_q less where the servo holds the joints, rad."""
    return recording.robot["actual_q"] - held_targets(recording.robot)


def fit_tracking(recordings: Sequence[Recording], gains: Gains) -> Tracking:
    """Lag and acceleration share from tracking errors.

    Args:
        recordings: moving logs, without pushes.
        gains: whose K0, K1 and KI are taken as given; its lag and share stay where no log tells.

    Raises:
        IdentificationError: no joint moves enough.
    """
    lag, share = gains.lag.copy(), gains.share.copy()
    lag_interval, share_interval = (np.full((N_JOINTS, 2), np.nan) for _ in range(2))
    told = np.zeros(N_JOINTS, dtype=bool)
    columns = [_columns(recording, gains) for recording in recordings]
    for j in range(N_JOINTS):
        A, y, block = [], [], []
        for n, recording in enumerate(recordings):
            robot, error = recording.robot, tracking_error(recording)[:, j]
            moving = np.abs(robot["target_qd"][:, j]) > _MOVING
            A.append(columns[n][moving, j])
            y.append(error[moving])
            block.append(_BLOCKS * n + (robot.time[moving] - robot.time[0]) // _BLOCK)
        A, y, block = np.concatenate(A), np.concatenate(y), np.concatenate(block)
        step = min(float(np.median(np.diff(r.robot.time))) for r in recordings)
        spread = max(float(np.ptp(r.robot["target_qdd"][:, j])) for r in recordings)
        if len(y) * step < _LEAST_TIME or spread < _LEAST_ACCELERATION:
            continue
        solution, half = _robust(A, y, block)
        told[j] = True
        share[j], lag[j] = 1.0 + solution[0], max(solution[1], 0.0)
        share_interval[j] = share[j] + half[0] * np.array([-1.0, 1.0])
        lag_interval[j] = solution[1] + half[1] * np.array([-1.0, 1.0])
    if not told.any():
        raise IdentificationError(
            f"{', '.join(r.source for r in recordings)}: no joint's target moves for {_LEAST_TIME:g} s with changes of "
            f"speed (target_qd above {_MOVING:g} rad/s); record some moves of every joint"
        )
    return Tracking(replace(gains, lag=lag, share=share), lag_interval, share_interval, told)


def _columns(recording: Recording, gains: Gains) -> np.ndarray:
    """(n, 6, 2) what the error is per unit of A - 1 and of T."""
    robot = recording.robot
    time = robot.time - robot.time[0]
    fine = np.arange(0.0, time[-1] + _STEP, _STEP)
    found = np.empty((len(time), N_JOINTS, 2))
    for j in range(N_JOINTS):
        qd, qdd = robot["target_qd"][:, j], robot["target_qdd"][:, j]
        acceleration = np.interp(fine, time, qdd)
        loop = [1.0, gains.kappa1[j], gains.kappa0[j], gains.kappai[j]]
        numerator, denominator = bilinear([1.0, 0.0], loop, 1.0 / _STEP)
        jerk = np.gradient(acceleration, _STEP)
        answers = (lfilter(numerator, denominator, x) for x in (acceleration, jerk))
        found[:, j] = np.stack([np.interp(time, fine, x) for x in answers], axis=1)
        found[:, j, 1] -= qd
    return found


def _robust(columns: np.ndarray, answer: np.ndarray, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least absolute deviations, and half-widths of the jackknife's 95 % intervals over blocks."""
    weight = np.ones(len(answer))
    solution = np.zeros(columns.shape[1])
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)[:, None]
        solution = np.linalg.lstsq(columns * root, answer * root[:, 0], rcond=None)[0]
        weight = 1.0 / np.maximum(np.abs(answer - columns @ solution), _SMALL)
    residual = answer - columns @ solution
    # What is minimised is |r| rounded off below _SMALL; its curvature is there alone.
    loss = (residual * weight, (np.abs(residual) < _SMALL) / _SMALL)
    half = half_widths(columns, residual, block, *loss)
    log = block // _BLOCKS
    if len(np.unique(log)) > 2:
        half = np.maximum(half, half_widths(columns, residual, log, *loss))
    return solution, half
