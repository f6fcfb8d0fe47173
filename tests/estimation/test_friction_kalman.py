"""Our estimator: its recursion against a Gaussian process over all samples at once, and what it says of real logs."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from ur5_twin.drives import terms
from ur5_twin.drives.current_map import load_current_map
from ur5_twin.errors import EstimationError
from ur5_twin.estimation import create, estimate, load_nominal, samples_of
from ur5_twin.estimation import friction_kalman as kalman
from ur5_twin.estimation.expected_current import ExpectedCurrent
from ur5_twin.estimation.intake import Intake
from ur5_twin.evaluation.truths import against_sensor
from ur5_twin.recording import read

DT, LENGTH = 0.008, 0.2
PUSH = np.array([12.0**2] * 3 + [0.5**2] * 3)
SLOPE = np.full(6, 0.1)
#: Of a joint: slow and fast part in motion, then at rest; A and s.
ERROR = np.tile([0.1, 0.3, 0.3, 0.02, 0.6, 4.0, 0.02, 0.05], (6, 1))
LASTING, LASTS = np.array([20.0**2] * 3 + [0.3**2] * 3), 3.0
PUSHES = kalman._Push(PUSH, LENGTH, LASTING, LASTS)
PRIOR = PUSH + LASTING
#: Even odds of contact before anything is measured.
ODDS = 0.0


def posture(singular: bool = False) -> np.ndarray:
    """A Jacobian (6, 6), and one that no joint feels a force along z of."""
    J = np.random.default_rng(3).normal(size=(6, 6)) * 0.4
    if singular:
        J[2] = 0.0
    return J


def filtered(torque: np.ndarray, J: np.ndarray, moving: bool) -> tuple[np.ndarray, np.ndarray, float]:
    """Wrench, covariance and probability of contact after all rows of torque (n, 6)."""
    x, P = np.zeros(30), np.zeros((30, 30))
    kalman._begin(x, P, ERROR, SLOPE, PUSHES, 1.0)
    if moving:
        # The slow and the fast part begin as they are at rest; here they begin as they go on.
        for j in range(6):
            P[18 + j, 18 + j] = (ERROR[j, 0] / SLOPE[j]) ** 2
            P[24 + j, 24 + j] = (ERROR[j, 2] / SLOPE[j]) ** 2
    rested = np.full(6, np.inf)
    wrench, covariance, tau = np.empty(6), np.empty((6, 6)), np.empty(6)
    contact = 0.0
    for k, row in enumerate(torque):
        current = -row * SLOPE
        contact = kalman._step(
            x, P, rested, 0.0 if k == 0 else DT, ERROR, PUSHES, ODDS, J, current, np.zeros(6), SLOPE,
            np.full(6, moving), wrench, covariance, tau,
        )  # fmt: skip
    assert np.allclose(tau, J.T @ wrench)
    return wrench, covariance, contact


def process(torque: np.ndarray, J: np.ndarray, moving: bool) -> tuple[np.ndarray, np.ndarray]:
    """The last row's wrench and its covariance by Gaussian process regression over all rows."""
    n = len(torque)
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) * DT
    r = math.sqrt(3.0) * apart / LENGTH
    push = (1.0 + r) * np.exp(-r)
    first = 0 if moving else 4
    noise = np.zeros((n, n))
    for size, time in (ERROR[0, first : first + 2], ERROR[0, first + 2 : first + 4]):
        noise += (size / SLOPE[0]) ** 2 * np.exp(-apart / time)
    lasting = np.exp(-apart / LASTS)
    K = np.kron(noise + 1e-3 * np.eye(n), np.eye(6))
    cross = np.zeros((6, 6 * n))
    for alike, size in ((push, PUSH), (lasting, LASTING)):
        K += np.kron(alike, J.T @ np.diag(size) @ J)
        cross += np.kron(alike[-1:], np.diag(size) @ J)
    gain = np.linalg.solve(K, cross.T).T
    return gain @ torque.ravel(), np.diag(PRIOR) - gain @ cross.T


@pytest.mark.parametrize("moving", [True, False])
@pytest.mark.parametrize("singular", [True, False])
def test_the_filter_is_the_gaussian_process(moving: bool, singular: bool) -> None:
    J = posture(singular)
    rng = np.random.default_rng(5)
    rise = np.linspace(0.0, 1.0, 50)[:, None]
    torque = rise * (J.T @ np.array([5.0, -3.0, 4.0, 0.1, 0.0, 0.2])) + rng.normal(scale=0.3, size=(50, 6))
    wrench, covariance, contact = filtered(torque, J, moving)
    expected, spread = process(torque, J, moving)
    # Rounding of 300 updates of a covariance that spans six orders of magnitude.
    assert np.allclose(wrench, expected, atol=1e-5)
    assert np.allclose(covariance, spread, rtol=1e-4, atol=1e-5)
    none = np.zeros(6)
    bayes = multivariate_normal.logpdf(none, wrench, covariance) - multivariate_normal.logpdf(
        none, none, np.diag(PRIOR)
    )
    assert contact == pytest.approx(1.0 / (1.0 + math.exp(bayes - ODDS)), rel=1e-3)
    if singular:
        # No joint feels it: neither an estimate nor an opinion.
        assert wrench[2] == 0.0
        assert covariance[2, 2] == pytest.approx(PRIOR[2])


def test_intervals_hold_where_the_world_is_as_believed() -> None:
    rng = np.random.default_rng(7)
    J = posture()
    inside = []
    for _ in range(60):
        n = 60
        apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) * DT
        r = math.sqrt(3.0) * apart / LENGTH
        w = np.linalg.cholesky((1.0 + r) * np.exp(-r) + 1e-9 * np.eye(n)) @ rng.normal(size=(n, 6)) * np.sqrt(PUSH)
        w += np.linalg.cholesky(np.exp(-apart / LASTS)) @ rng.normal(size=(n, 6)) * np.sqrt(LASTING)
        noise = np.zeros((n, 6))
        for size, time in (ERROR[0, :2], ERROR[0, 2:4]):
            noise += np.linalg.cholesky(np.exp(-apart / time)) @ rng.normal(size=(n, 6)) * size / SLOPE[0]
        wrench, covariance, _ = filtered(w @ J + noise, J, moving=True)
        inside.append(np.abs(wrench - w[-1]) < 1.645 * np.sqrt(np.diag(covariance)))
    # 360 numbers, partly dependent: 90 % within three standard errors of 1.6 %.
    assert 0.84 < np.mean(inside) < 0.95


def test_sample_by_sample_is_the_map_of_the_whole_log(lab_logs: Path) -> None:
    recording = read(lab_logs / "Movement_No4_Acc", repair=True)
    nominal, of = load_nominal(tool="xsens_mti"), load_current_map()
    whole = of.current(terms.ride(recording, nominal.arm))
    expected, intake = ExpectedCurrent(nominal), Intake()
    rows = []
    for sample in samples_of(recording):
        intake.update(sample)
        expected.update(intake.sample, intake.dt)
        rows.append(expected.current.copy())
    # The same sums in another order.
    assert np.allclose(rows, whole, atol=1e-9)


def test_a_map_that_follows_the_servo_is_refused() -> None:
    nominal = replace(load_nominal(), current_map=load_current_map("lab_following"))
    with pytest.raises(EstimationError, match="use lab"):
        create("friction_kalman", nominal)


def test_a_map_that_does_not_say_how_it_errs_is_refused() -> None:
    nominal = replace(load_nominal(), current_map=replace(load_current_map(), residuals=()))
    with pytest.raises(EstimationError, match="how it errs"):
        create("friction_kalman", nominal)


def test_below_every_printed_error_of_the_thesis(lab_logs: Path) -> None:
    """On the run of table 6.1, with a map of free motion alone, and it is pushes that it tells."""
    recording = read(lab_logs / "Movement_No9_Singularity_Free_ForceSensor", repair=True)
    nominal = load_nominal(tool="ati_gamma")
    found = estimate(create("friction_kalman", nominal), samples_of(recording))
    truth = against_sensor(recording, nominal.arm).wrench
    error = np.abs(found.wrench - truth).mean(axis=0)
    # The best of each axis in table 6.1.
    assert (error < [6.157, 8.659, 2.924, 0.996, 1.175, 1.227]).all()
    alike = [np.corrcoef(found.wrench[:, a], truth[:, a])[0, 1] for a in range(3)]
    assert min(alike) > 0.7
    inside = np.abs(found.wrench - truth) < 1.645 * np.sqrt(np.einsum("nii->ni", found.covariance))
    assert (inside.mean(axis=0) > 0.85).all()
