"""From torques to a wrench, at singular postures too, and whether anything acts at all."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from ur5_twin.arm import kinematics
from ur5_twin.arm.singularities import smallest_singular_value
from ur5_twin.errors import ModelError
from ur5_twin.estimation import NominalModel, create, estimate, estimator_names, load_nominal, samples_of
from ur5_twin.estimation.detection import ContactDetector, Thresholds
from ur5_twin.estimation.wrench import WrenchSolver
from ur5_twin.scenario import load_scenario

REGULAR = np.array([0.3, -1.4, 1.2, -0.9, 1.1, 0.4])
VARIANCE = np.array([4.0, 4.0, 2.0, 0.3, 0.3, 0.2])
SINGULAR = {
    "wrist": np.array([0.3, -1.4, 1.2, -0.9, 0.0, 0.4]),
    "elbow": np.array([0.3, -1.4, 0.0, -0.9, 1.1, 0.4]),
    "all": np.zeros(6),
}


@pytest.mark.parametrize("q", [REGULAR, *SINGULAR.values()])
def test_the_wrench_is_the_gaussian_posterior(nominal: NominalModel, q: np.ndarray) -> None:
    """Against conditioning the joint normal distribution of torques and wrench, which inverts other matrices."""
    solver = WrenchSolver(nominal)
    solver.look(q)
    tau = np.array([3.0, -8.0, 5.0, 1.0, -0.5, 0.4])
    found = solver.solve(tau, VARIANCE)
    J = kinematics.jacobian(nominal.arm, q)
    S0, R = np.diag(solver.prior), np.diag(VARIANCE)
    total = J.T @ S0 @ J + R
    gain = S0 @ J @ np.linalg.inv(total)
    np.testing.assert_allclose(found.wrench, gain @ tau, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(found.covariance, S0 - gain @ J.T @ S0, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(found.covariance, found.covariance.T)
    assert found.sigma_min == pytest.approx(smallest_singular_value(nominal.arm, q), abs=1e-12)
    against = multivariate_normal(np.zeros(6), total).logpdf(tau) - multivariate_normal(np.zeros(6), R).logpdf(tau)
    odds = math.exp(against) * nominal.settings.wrench.prior_contact / (1.0 - nominal.settings.wrench.prior_contact)
    assert found.contact == pytest.approx(odds / (1.0 + odds), rel=1e-9)


def test_well_known_torques_give_the_plain_inverse(nominal: NominalModel) -> None:
    solver = WrenchSolver(nominal)
    solver.look(REGULAR)
    wrench = np.array([20.0, -30.0, 10.0, 1.0, 2.0, -1.0])
    tau = kinematics.jacobian(nominal.arm, REGULAR).T @ wrench
    # The prior of 150 N and 15 Nm pulls by variance over prior variance, over the Jacobian's square: 1e-5.
    np.testing.assert_allclose(solver.solve(tau, np.full(6, 1e-6)).wrench, wrench, rtol=1e-4)


@pytest.mark.parametrize("name", list(SINGULAR))
def test_what_no_joint_feels_stays_unknown(nominal: NominalModel, name: str) -> None:
    """At a singular posture the lost direction keeps the prior's spread and gets nothing of a torque's error."""
    solver = WrenchSolver(nominal)
    solver.look(SINGULAR[name])
    lost = np.linalg.svd(solver.J.T)[2][-1]
    found = solver.solve(np.array([5.0, -5.0, 5.0, -5.0, 5.0, -5.0]), VARIANCE)
    assert found.sigma_min < 1e-12
    scaled = lost / solver.prior
    # S0^-1 and the lost direction are what is left of the information there.
    assert scaled @ found.wrench * 1.0 == pytest.approx(0.0, abs=1e-9)
    assert lost @ np.linalg.inv(found.covariance) @ lost == pytest.approx(lost @ scaled, rel=1e-6)


def test_torques_of_any_size_give_finite_wrenches(nominal: NominalModel) -> None:
    """Errors come through at most as far as the prior lets them: 1/2 sqrt(prior / variance) per Nm, whatever J is."""
    rng = np.random.default_rng(5)
    solver = WrenchSolver(nominal)
    most = 0.5 * np.sqrt(solver.prior.max() / VARIANCE.min())
    for _ in range(300):
        solver.look(np.where(rng.random(6) < 0.4, 0.0, rng.uniform(-np.pi, np.pi, 6)))
        tau = rng.normal(size=6)
        found = solver.solve(tau / np.linalg.norm(tau), VARIANCE)
        assert np.linalg.norm(found.wrench) <= most
        assert (np.linalg.eigvalsh(found.covariance) > 0).all()
        assert (np.diag(found.covariance) <= solver.prior * (1 + 1e-9)).all()


@pytest.mark.parametrize("scenario", ["singularity_wrist", "singularity_elbow", "singularity_shoulder"])
def test_no_estimator_blows_up_through_a_singularity(run_of, scenario: str) -> None:
    nominal = load_nominal("plant", load_scenario(scenario).arm.tool)
    recording = run_of(scenario)
    least = smallest_singular_value(nominal.arm, recording.robot["actual_q"]).min()
    assert least < 0.05
    for name in estimator_names():
        found = estimate(create(name, nominal), samples_of(recording))
        assert np.isfinite(found.wrench).all()
        # Nobody touches the arm. An inverse makes 5 Nm into 130 to 700 N here; F takes friction of 10 Nm for force.
        assert np.abs(found.wrench[:, :3]).max() < (400.0 if name == "direct" else 150.0), name
        # Conditioning does not make the estimate unsure of nothing: the wrench is within what is said of it.
        spread = np.sqrt(np.einsum("nii->ni", found.covariance))
        assert (np.abs(found.wrench) < 6.0 * spread).mean() > 0.95, name


class TestDetection:
    """Threshold, delay and hysteresis."""

    limits = Thresholds(on=0.9, off=0.5, rise=0.016, fall=0.1)

    def test_begins_after_rise_and_ends_after_fall(self) -> None:
        detector = ContactDetector(self.limits)
        level = [0.0] * 10 + [0.95] * 20 + [0.7] * 20 + [0.1] * 30
        told = [detector.update(0.008 * k, value) for k, value in enumerate(level)]
        # Two ticks after the tenth; 0.7 is neither; 0.1 s are 12.5 ticks after the fiftieth.
        assert told.index(True) == 12
        assert told[12:].index(False) + 12 == 63
        assert detector.since == pytest.approx(50 * 0.008)

    def test_a_spike_is_no_contact_and_a_dip_no_end(self) -> None:
        detector = ContactDetector(self.limits)
        for k in range(50):
            assert not detector.update(0.008 * k, 0.99 if k % 3 < 2 else 0.0)
        for k in range(50, 60):
            detector.update(0.008 * k, 0.99)
        assert all(detector.update(0.008 * k, 0.0 if k % 12 else 0.99) for k in range(60, 120))

    def test_nan_changes_nothing(self) -> None:
        detector = ContactDetector(self.limits)
        told = [detector.update(0.008 * k, math.nan if k % 2 else 0.99) for k in range(6)]
        assert told == [False, False, True, True, True, True]

    def test_off_above_on_is_refused(self) -> None:
        with pytest.raises(ModelError, match=r"off \(0.9\) must not be above on \(0.5\)"):
            Thresholds(0.5, 0.9, 0.0, 0.0)

    def test_pushes_are_found_and_their_pauses_too(self, nominal: NominalModel, run_of) -> None:
        """Pushes of 20, 40 and 60 N at standstill, with the lab's noise."""
        recording = run_of("push_x")
        found = estimate(create("momentum_observer", nominal), samples_of(recording))
        detector = ContactDetector(Thresholds.of(nominal.settings))
        told = np.array([detector.update(t, p) for t, p in zip(found.time, found.contact, strict=True)])
        force = np.linalg.norm(recording.robot["truth_wrench"][:, :3], axis=1)
        assert told[force > 35.0].mean() > 0.95
        assert told[force < 0.01].mean() < 0.2
