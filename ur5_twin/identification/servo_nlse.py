"""The thesis' estimate of PD gains, equation (2.83), and whether the data can tell them.

    min over kappa of J = sum over joints and rows of (q(t, kappa) - q_m)^2 + (qd(t, kappa) - qd_m)^2

The model is the closed loop (2.80) with exact linearisation, where every joint is e'' + K1 e' + K0 e = 0 from the
measured start on, and q = q_d + e: J is a sum over joints of functions of two gains. In free motion e is over before
the arm moves; J then is the same whatever the gains are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from ur5_twin.arm.parameters import N_JOINTS
from ur5_twin.evaluation.reporting import held_targets
from ur5_twin.identification.jackknife import student_factor
from ur5_twin.recording.table import Recording

#: Bounds of both gains, 1/s^2 and 1/s: from what the thesis prints to the stiffest servo that 8 ms allow, and beyond.
LOWEST, HIGHEST = 1.0, 1e5
_STARTS = ((40.0, 40.0), (5000.0, 150.0))
#: Gains are told where the interval of their logarithm is no wider than a factor of two to either side ...
_FACTOR = np.log(2.0)
#: ... and where gains far off, to either side, leave this much more of J.
_WORTH = 0.05
#: Points of a profile.
_POINTS = 41


@dataclass(frozen=True)
class Nlse:
    """The fit of (2.83), per joint.

    Attributes:
        kappa: (2, 6) K0 in 1/s^2, K1 in 1/s.
        log_half: (2, 6) half-width of the 95 % interval of their logarithm, independent residuals assumed (they are
            not, so that the true one is wider); inf where the cost does not depend on the gain.
        condition: (6,) condition number of the Jacobian by the logarithms of the gains.
        mae: (6,) rad, of the position.
        grid: (n,) values of a gain that the profiles are taken at.
        profile: (2, 6, n) J over its minimum, one gain given and the other at its best.
        told: (6,).
    """

    kappa: np.ndarray
    log_half: np.ndarray
    condition: np.ndarray
    mae: np.ndarray
    grid: np.ndarray
    profile: np.ndarray
    told: np.ndarray


def fit_nlse(recordings: Sequence[Recording]) -> Nlse:
    """Equation (2.83) on moving logs, joint by joint."""
    grid = np.geomspace(LOWEST, HIGHEST, _POINTS)
    kappa, log_half, profile = np.empty((2, 6)), np.empty((2, 6)), np.empty((2, 6, _POINTS))
    condition, mae, told = np.empty(6), np.empty(6), np.zeros(6, dtype=bool)
    bounds = (np.log([LOWEST, LOWEST]), np.log([HIGHEST, HIGHEST]))
    data = [(r.robot.time - r.robot.time[0], *_errors(r)) for r in recordings]
    for j in range(N_JOINTS):

        def residual(logs: np.ndarray, j: int = j) -> np.ndarray:
            left = [
                np.stack([e[:, j], de[:, j]]) - _decay(time, e[0, j], de[0, j], *np.exp(logs)) for time, e, de in data
            ]
            return np.concatenate(left, axis=1).ravel()

        fits = [least_squares(residual, np.log(start), bounds=bounds) for start in _STARTS]
        best = min(fits, key=lambda fit: fit.cost)
        spectrum = np.linalg.svd(best.jac, compute_uv=False)
        condition[j] = spectrum[0] / spectrum[-1] if spectrum[-1] > 0 else np.inf
        freedom = len(best.fun) - 2
        information = best.jac.T @ best.jac
        singular = not np.isfinite(condition[j]) or condition[j] > 1e8
        covariance = np.full((2, 2), np.inf) if singular else np.linalg.inv(information) * 2.0 * best.cost / freedom
        log_half[:, j] = student_factor(freedom) * np.sqrt(np.diag(covariance))
        kappa[:, j] = np.exp(best.x)
        half = len(best.fun) // 2
        mae[j] = np.abs(best.fun[:half]).mean()
        table = np.array([[_cost(residual, k0, k1) for k1 in grid] for k0 in grid])
        least = min(table.min(), 2.0 * best.cost)
        profile[0, j], profile[1, j] = table.min(axis=1) / least, table.min(axis=0) / least
        rise = profile[:, j, [0, -1]].min(axis=1)
        told[j] = bool((log_half[:, j] < _FACTOR).all() and (rise > 1.0 + _WORTH).all())
    return Nlse(kappa, log_half, condition, mae, grid, profile, told)


def _errors(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    robot = recording.robot
    return robot["actual_q"] - held_targets(robot), robot["actual_qd"] - robot["target_qd"]


def _cost(residual, k0: float, k1: float) -> float:
    return float((residual(np.log([k0, k1])) ** 2).sum())


def _decay(time: np.ndarray, e: float, de: float, k0: float, k1: float) -> np.ndarray:
    """(2, n) e and e' of e'' + K1 e' + K0 e = 0 from (e, e') on."""
    # Twice the same root has no two eigenvectors; a part in a million apart it has.
    root = np.sqrt(complex(k1 * k1 - 4.0 * k0) + 1e-6 * k0)
    fast, slow = 0.5 * (-k1 - root), 0.5 * (-k1 + root)
    a = (de - slow * e) / (fast - slow)
    b = e - a
    x, y = a * np.exp(fast * time), b * np.exp(slow * time)
    return np.stack([(x + y).real, (fast * x + slow * y).real])
