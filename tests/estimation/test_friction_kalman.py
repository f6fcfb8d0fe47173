"""Our estimator: its recursion against a Gaussian process over all samples at once, and what it says of real logs."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from ur5_twin.drives import terms
from ur5_twin.drives.current_map import TURNING, load_current_map
from ur5_twin.errors import EstimationError
from ur5_twin.estimation import create, estimate, load_nominal, samples_of
from ur5_twin.estimation import friction_kalman as kalman
from ur5_twin.estimation.expected_current import ExpectedCurrent
from ur5_twin.estimation.intake import Intake
from ur5_twin.evaluation.truths import against_sensor
from ur5_twin.recording import read

DT, LENGTH = 0.008, 0.3
PRIOR = np.array([20.0**2] * 3 + [2.0**2] * 3)
SLOPE = np.full(6, 0.1)
#: Of a joint: slow and fast part in motion, then at rest, A and s; the level of turned friction, A.
ERROR = np.tile([0.1, 0.3, 0.3, 0.02, 0.6, 4.0, 0.02, 0.05, 0.3], (6, 1))
#: Of what friction turns to, A.
SPREAD = np.full(6, 0.5)
#: Even odds of contact before anything is measured.
CONTACT = kalman._Contact(PRIOR, LENGTH, 0.0)


def posture(singular: bool = False) -> np.ndarray:
    """A Jacobian (6, 6), and one that no joint feels a force along z of."""
    J = np.random.default_rng(3).normal(size=(6, 6)) * 0.4
    if singular:
        J[2] = 0.0
    return J


def angles(n: int) -> np.ndarray:
    """(n, 6) positions of joints that give way by up to 0.2 mrad now and then, each at its own time and direction."""
    rng = np.random.default_rng(11)
    return np.cumsum(rng.normal(scale=1e-4, size=(n, 6)) * (rng.random((n, 6)) < 0.1), axis=0)


def filtered(
    torque: np.ndarray, J: np.ndarray, moving: bool, angle: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, float]:
    """Wrench, covariance and probability of contact after all rows of torque (n, 6)."""
    angle = np.zeros_like(torque) if angle is None else angle
    x, P = np.zeros(18), np.zeros((18, 18))
    kalman._begin(x, P, ERROR, SLOPE, CONTACT, 1.0)
    if moving:
        # The slow and the fast part begin as they are at rest; here they begin as they go on.
        for j in range(6):
            P[6 + j, 6 + j] = (ERROR[j, 0] / SLOPE[j]) ** 2
            P[12 + j, 12 + j] = (ERROR[j, 2] / SLOPE[j]) ** 2
    rested, q = np.full(6, np.inf), angle[0].copy()
    wrench, covariance, tau = np.empty(6), np.empty((6, 6)), np.empty(6)
    contact = 0.0
    for k, row in enumerate(torque):
        current = -row * SLOPE
        contact = kalman._step(
            x, P, rested, q, 0.0 if k == 0 else DT, ERROR, SPREAD, CONTACT, J, angle[k], current, np.zeros(6), SLOPE,
            np.full(6, moving), wrench, covariance, tau,
        )  # fmt: skip
    assert np.allclose(tau, J.T @ wrench)
    return wrench, covariance, contact


def friction(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n,) and covariance (n, n) of one resting joint's slow part, Nm, from its increments all at once."""
    n = len(angle)
    size, time, level, spread = ERROR[0, 4] / SLOPE[0], ERROR[0, 5], ERROR[0, 8] / SLOPE[0], SPREAD[0] / SLOPE[0]
    way = np.diff(angle, prepend=angle[0])
    waits, turns = np.exp(-np.where(np.arange(n) == 0, 0.0, DT) / time), np.exp(-np.abs(way) / TURNING)
    variance = (1.0 - waits**2) * size**2 * turns**2 + (1.0 - turns**2) * spread**2
    variance[0] += size**2
    inverse = np.linalg.inv(np.eye(n) - np.diag((waits * turns)[1:], -1))
    return inverse @ (-(1.0 - turns) * level * np.sign(way)), inverse @ np.diag(variance) @ inverse.T


def process(torque: np.ndarray, J: np.ndarray, moving: bool, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The last row's wrench of an arm that is touched, and its covariance, by Gaussian process regression."""
    n = len(torque)
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) * DT
    touch = np.exp(-apart / LENGTH)
    K = np.kron(touch, J.T @ np.diag(PRIOR) @ J) + 1e-3 * np.eye(6 * n)
    mean = np.zeros((n, 6))
    size, time = ERROR[0, 2:4] if moving else ERROR[0, 6:8]
    fast = (size / SLOPE[0]) ** 2 * np.exp(-apart / time)
    for j in range(6):
        slow = (ERROR[0, 0] / SLOPE[0]) ** 2 * np.exp(-apart / ERROR[0, 1])
        if not moving:
            mean[:, j], slow = friction(angle[:, j])
        one = np.zeros((6, 6))
        one[j, j] = 1.0
        K += np.kron(slow + fast, one)
    cross = np.kron(touch[-1:], np.diag(PRIOR) @ J)
    gain = np.linalg.solve(K, cross.T).T
    return gain @ (torque - mean).ravel(), np.diag(PRIOR) - gain @ cross.T


@pytest.mark.parametrize("state", ["moving", "at rest", "giving way"])
@pytest.mark.parametrize("singular", [True, False])
def test_the_filter_is_the_gaussian_process_weighed_against_nothing(state: str, singular: bool) -> None:
    J, moving = posture(singular), state == "moving"
    rng = np.random.default_rng(5)
    angle = angles(50) if state == "giving way" else np.zeros((50, 6))
    rise = np.linspace(0.0, 1.0, 50)[:, None]
    torque = rise * (J.T @ np.array([5.0, -3.0, 4.0, 0.1, 0.0, 0.2])) + rng.normal(scale=0.3, size=(50, 6))
    wrench, covariance, contact = filtered(torque, J, moving, angle)
    touched, spread = process(torque, J, moving, angle)
    none = np.zeros(6)
    bayes = multivariate_normal.logpdf(none, touched, spread) - multivariate_normal.logpdf(none, none, np.diag(PRIOR))
    # Rounding of 300 updates of a covariance that spans six orders of magnitude.
    assert contact == pytest.approx(1.0 / (1.0 + math.exp(bayes)), rel=1e-3)
    assert np.allclose(wrench, contact * touched, rtol=1e-4, atol=1e-5)
    shrunk = (1.0 - contact) * touched
    assert np.allclose(covariance, spread + np.outer(shrunk, shrunk), rtol=1e-4, atol=1e-4)
    if singular:
        # No joint feels it: neither an estimate nor an opinion.
        assert wrench[2] == 0.0
        assert covariance[2, 2] == pytest.approx(PRIOR[2])


def test_untouched_is_nothing_and_a_push_comes_through() -> None:
    J, rng = posture(), np.random.default_rng(9)
    noise = rng.normal(scale=0.3, size=(100, 6)) / SLOPE[0] * 0.1
    wrench, covariance, contact = filtered(noise, J, moving=True)
    assert contact < 0.1
    assert np.abs(wrench[:3]).max() < 1.0
    # What a touched arm might hide is still in the interval.
    assert np.sqrt(covariance[0, 0]) > 1.0
    push = np.array([30.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    wrench, covariance, contact = filtered(noise + J.T @ push, J, moving=True)
    assert contact > 0.99
    assert np.abs(wrench - push)[:3].max() < 3.0 * np.sqrt(np.diag(covariance)[:3].max())


def test_a_joint_that_gives_way_has_turned_its_friction() -> None:
    """The current has not answered yet, the encoder has: what friction holds counts for the push."""
    J = np.eye(6)
    torque, angle = np.zeros((40, 6)), np.zeros((40, 6))
    angle[30:, 0] = 5.0 * TURNING
    still, _, _ = filtered(torque, J, False)
    moved, _, _ = filtered(torque, J, False, angle)
    assert still[0] == pytest.approx(0.0, abs=1e-6)
    assert moved[0] > 0.0
    assert np.abs(moved[1:]).max() < 1e-6


def test_intervals_hold_where_the_world_is_as_believed() -> None:
    rng = np.random.default_rng(7)
    J = posture()
    inside = []
    for _ in range(60):
        n = 60
        apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) * DT
        w = np.linalg.cholesky(np.exp(-apart / LENGTH)) @ rng.normal(size=(n, 6)) * np.sqrt(PRIOR)
        noise = np.zeros((n, 6))
        for size, time in (ERROR[0, :2], ERROR[0, 2:4]):
            noise += np.linalg.cholesky(np.exp(-apart / time)) @ rng.normal(size=(n, 6)) * size / SLOPE[0]
        wrench, covariance, _ = filtered(w @ J + noise, J, moving=True)
        inside.append(np.abs(wrench - w[-1]) < 1.645 * np.sqrt(np.diag(covariance)))
    # 360 numbers, partly dependent, of touched arms: 90 % within three standard errors of 1.6 %, and a little more for
    # the doubt whether they are touched.
    assert 0.85 < np.mean(inside) < 0.97


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
    # And below saying nothing.
    assert (error[:3] < np.abs(truth).mean(axis=0)[:3]).all()
    alike = [np.corrcoef(found.wrench[:, a], truth[:, a])[0, 1] for a in range(3)]
    assert min(alike) > 0.7
    inside = np.abs(found.wrench - truth) < 1.645 * np.sqrt(np.einsum("nii->ni", found.covariance))
    assert (inside.mean(axis=0) > 0.85).all()
