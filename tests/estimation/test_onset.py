"""Small pushes that last: the recursion against a Gaussian process over all samples at once, and what is learnt."""

from __future__ import annotations

import numpy as np
import pytest

from ur5_twin.drives.current_map import Residual
from ur5_twin.estimation.onset import Onset
from ur5_twin.estimation.settings import OnsetSpec

DT = 0.008
SPEC = OnsetSpec("test", force_n=15.0, moment_nm=0.3, friction_share=0.05, torque_share=0.01, prior=1e-4)
#: Slow and fast part, A and s; at rest, which plays no part; and what a joint may have stuck with, A.
ERROR = Residual(0.06, 0.13, 0.4, 0.016, 0.1, 10.0, 0.01, 0.01, 0.0)
SLOPE, FRICTION, TORQUE = np.full(6, 0.1), np.array([9.0, -8.0, 9.0, 1.5, -1.5, 1.5]), np.full(6, 20.0)
MOVING = np.ones(6, dtype=bool)
#: A Jacobian of metres and radians.
J = np.random.default_rng(3).normal(size=(6, 6)) * 0.4


def onset(of: Residual = ERROR) -> Onset:
    return Onset(SPEC, [of] * 6)


def run(
    of: Onset,
    errors: np.ndarray,
    moving: np.ndarray = MOVING,
    friction: np.ndarray = FRICTION,
    torque: np.ndarray = TORQUE,
    touched: bool = False,
) -> np.ndarray:
    """(n,) odds over those before anything is measured, while rows of errors (n, 6) come in."""
    odds = [of.update(DT, row, J, SLOPE, moving, friction, torque, touched) for row in errors]
    return np.array(odds) / (SPEC.prior / (1.0 - SPEC.prior))


def noise(n: int, seed: int, of: Residual = ERROR) -> np.ndarray:
    """(n, 6) Nm of what the map does not explain."""
    rng = np.random.default_rng(seed)
    out, now = np.empty((n, 6)), np.zeros((2, 6))
    parts = ((of.slow / 0.1, of.slow_time), (of.fast / 0.1, of.fast_time))
    for k in range(n):
        for i, (size, time) in enumerate(parts):
            keep = 0.0 if k == 0 else np.exp(-DT / time)
            now[i] = keep * now[i] + size * np.sqrt(1.0 - keep**2) * rng.normal(size=6)
        out[k] = now.sum(axis=0)
    return out


def log_density(x: np.ndarray, covariance: np.ndarray) -> float:
    """Of a normal distribution about zero, but for the constant."""
    return -0.5 * float(np.linalg.slogdet(covariance)[1] + x @ np.linalg.solve(covariance, x))


def test_the_factor_is_that_of_two_gaussian_processes() -> None:
    n = 11
    errors = noise(n, 1) + J.T @ np.array([8.0, -4.0, 3.0, 0.1, 0.0, -0.1])
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) * DT
    none = np.zeros((6 * n, 6 * n))
    for j in range(6):
        shares = (SPEC.friction_share * FRICTION[j]) ** 2 + (SPEC.torque_share * TORQUE[j]) ** 2
        one = (ERROR.slow / SLOPE[j]) ** 2 * np.exp(-apart / ERROR.slow_time)
        one += (ERROR.fast / SLOPE[j]) ** 2 * np.exp(-apart / ERROR.fast_time)
        one += shares * np.exp(-apart / 100.0) + 1e-3 * np.eye(n)
        none[j::6, j::6] = one
    prior = np.diag([SPEC.force_n**2] * 3 + [SPEC.moment_nm**2] * 3)
    push = none + np.kron(np.ones((n, n)), J.T @ prior @ J)
    log = log_density(errors.ravel(), push) - log_density(errors.ravel(), none)
    # One instant only: the next is 0.096 s, twelve samples, later.
    assert np.log(run(onset(), errors)[-1]) == pytest.approx(log, rel=1e-6)


def test_a_small_push_shows_by_lasting() -> None:
    # 7 N: in every joint less than two of a sample's deviations.
    torque = J.T @ np.array([7.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert np.abs(torque).max() < 2.0 * ERROR.fast / SLOPE[0]
    quiet, pushed = noise(200, 5), noise(200, 5)
    pushed[100:175] += torque
    without, beside = run(onset(), quiet), run(onset(), pushed)
    assert without.max() < 100.0
    assert beside[:100].max() < 100.0
    assert beside[100:110].max() < 1e3
    assert beside[174] > 1e6


def test_what_is_over_is_over() -> None:
    errors = noise(300, 6)
    errors[100:175] += J.T @ np.array([15.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    odds = run(onset(), errors)
    # As odds: 99 to 1 that it acts, and a tenth of a second later as sure that it does no longer.
    assert odds[174] * SPEC.prior > 99.0
    assert odds[190:].max() * SPEC.prior < 0.01


def test_joints_at_rest_say_nothing() -> None:
    factors = run(onset(), np.full((40, 6), 50.0), moving=np.zeros(6, dtype=bool))
    assert np.isfinite(factors).all()
    assert factors[-1] == pytest.approx(1.0, rel=1e-4)


def test_what_a_joint_stuck_with_is_no_push() -> None:
    errors = noise(40, 7)
    # It dies out within the slow part's time.
    errors += 10.0 * np.exp(-np.arange(40) * DT / ERROR.slow_time)[:, None]
    sticks = ERROR._replace(turned=1.0)
    assert run(onset(sticks), errors)[3:].max() < 0.01 * run(onset(), errors)[3:].max()


def back_and_forth(of: Onset, share: float, seconds: int, seed: int) -> np.ndarray:
    """Odds over the first ones in motions of 2 s to and fro, friction being off by a share."""
    found = []
    for turn in range(seconds // 2):
        friction = FRICTION if turn % 2 else -FRICTION
        found.append(run(of, noise(250, seed + turn) + share * friction, friction=friction))
    return np.concatenate(found)


def test_friction_that_is_off_is_learnt() -> None:
    of = onset()
    early = back_and_forth(of, 0.5, 4, 20)
    back_and_forth(of, 0.5, 40, 40)
    late = back_and_forth(of, 0.5, 4, 20)
    assert early.max() > 1e4
    assert late.max() < 100.0


def test_nothing_is_learnt_from_a_touched_arm_nor_forgotten_in_a_gap() -> None:
    of = onset()
    back_and_forth(of, 0.5, 40, 40)
    known = back_and_forth(of, 0.5, 4, 20).max()
    # A second of a push of 30 N against the way, of which the arm is told.
    run(of, noise(125, 8) + J.T @ np.array([0.0, 30.0, 0.0, 0.0, 0.0, 0.0]), touched=True)
    of.restart()
    assert run(of, noise(1, 9))[0] == 0.0
    assert back_and_forth(of, 0.5, 4, 20).max() < 10.0 * max(known, 1.0)
