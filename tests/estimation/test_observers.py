"""Each recursion against another formulation of the same thing."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.signal import lfilter, sosfilt, sosfilt_zi

from ur5_twin.arm import kinematics
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.control.tcp_force import TcpForce
from ur5_twin.estimation import NominalModel, Sample, create, estimate, load_nominal, samples_of
from ur5_twin.estimation._kernels import averaged_variance
from ur5_twin.estimation.adaptive_observer import AdaptiveObserver
from ur5_twin.estimation.direct import DirectFriction, butter_of, zero_phase_friction
from ur5_twin.estimation.disturbance_kalman import _LEAST, kalman
from ur5_twin.estimation.extended_state_observer import _observe as extended_state
from ur5_twin.estimation.momentum_observer import MomentumObserver, delay, first_order
from ur5_twin.estimation.motor_torque import PlantTorque
from ur5_twin.estimation.sliding_mode_observer import _slide as slide
from ur5_twin.recording import Recording
from ur5_twin.scenario import load_scenario
from ur5_twin.twin.scenario_run import ScenarioRun

PERIOD = 0.008
ZERO, ONE = np.zeros(6), np.ones(6)


def with_settings(nominal: NominalModel, **changes: dict) -> NominalModel:
    """The nominal model with other numbers in tables of its settings."""
    tables = {
        name: msgspec.structs.replace(getattr(nominal.settings, name), **change) for name, change in changes.items()
    }
    return replace(nominal, settings=msgspec.structs.replace(nominal.settings, **tables))


def mean_external_torque(nominal: NominalModel, samples: list[Sample]) -> np.ndarray:
    """(n - 1, 6) mean external torque of each step, for the whole log at once.

    C' qd comes from the kinetic energy: it is half of d(qd' M qd)/dq.
    """
    law, torque = PlantTorque(nominal), []
    for k, sample in enumerate(samples):
        law.update(sample, 0.0 if k == 0 else sample.time - samples[k - 1].time)
        torque.append(law.torque.copy())
    q, qd = np.array([s.actual_q for s in samples]), np.array([s.actual_qd for s in samples])
    time = np.array([s.time for s in samples])
    dynamics = Dynamics(nominal.arm)
    p = np.einsum("nij,nj->ni", dynamics.mass_matrix(q), qd)
    h = 1e-5
    gradient = np.stack(
        [
            (dynamics.kinetic_energy(q + h * e, qd) - dynamics.kinetic_energy(q - h * e, qd)) / (2 * h)
            for e in np.eye(6)
        ],
        axis=1,
    )
    u = np.array(torque) + gradient - dynamics.gravity(q)
    return np.diff(p, axis=0) / np.diff(time)[:, None] - 0.5 * (u[1:] + u[:-1])


def test_momentum_observer_is_a_low_pass_of_the_mean_torque(nominal: NominalModel, wandering: list[Sample]) -> None:
    mean = mean_external_torque(nominal, wandering)
    steps = np.diff([s.time for s in wandering])
    gain = np.array(nominal.settings.momentum_observer.gain_1_s)
    expected = [np.zeros(6)]
    for step, value in zip(steps, mean, strict=True):
        fade = np.exp(-gain * step)
        expected.append(fade * expected[-1] + (1 - fade) * value)
    found = estimate(create("momentum_observer", nominal), wandering).tau_ext
    # The gradient's finite differences leave 1e-9 of some Nm.
    np.testing.assert_allclose(found, np.array(expected), atol=1e-6)


@pytest.mark.parametrize(
    "name",
    [
        "filtered_dynamics",
        "momentum_observer",
        "extended_state_observer",
        "sliding_mode_observer",
        "disturbance_kalman",
        "accelerometer_aided",
    ],
)
def test_an_exact_model_gives_the_true_torque(name: str, exact: NominalModel, frictionless: Recording) -> None:
    """Behind its own delay an observer shows the truth: pushes of 30 N and more on a moving arm."""
    found = estimate(create(name, exact), samples_of(frictionless))
    truth = frictionless.robot["truth_tau_ext"]
    late = [np.abs(found.tau_ext[20:] - truth[20 - lag : len(truth) - lag]).mean(axis=0) for lag in range(8)]
    assert np.abs(truth).max() > 10.0
    # Currents are sampled once in a tick of 16 servo steps; what they do in between is what is left.
    assert np.min(late, axis=0).max() < 0.25


@pytest.mark.parametrize("name", ["momentum_observer", "disturbance_kalman", "filtered_dynamics"])
def test_an_exact_model_gives_the_true_wrench(name: str, exact: NominalModel, frictionless: Recording) -> None:
    truth = frictionless.robot["truth_wrench"]
    found = estimate(create(name, exact), samples_of(frictionless)).wrench
    pushed = np.linalg.norm(truth[:, :3], axis=1) > 20.0
    pushed[:20] = False
    assert pushed.sum() > 200
    late = []
    for lag in range(8):
        late.append(np.abs(found[lag:] - truth[: len(truth) - lag])[pushed[: len(truth) - lag]].mean(axis=0))
    # A few percent of 30 N and more, and of what a lever of 0.1 m makes of them: what currents do between two samples.
    assert np.min([row[:3].max() for row in late]) < 1.0
    assert np.min([row[3:].max() for row in late]) < 0.1


def test_first_order_delay_is_the_closed_form() -> None:
    gain, torque, threshold, dt = 50.0, 5.0, 3.0, 1e-4
    r, variance = np.zeros(6), np.zeros(6)
    steps = 0
    while r[0] < threshold:
        first_order(gain * ONE, dt, torque * ONE, ZERO, ZERO, ZERO, r, variance)
        steps += 1
    # To the step.
    assert steps * dt == pytest.approx(delay(gain, threshold, torque), abs=dt)
    assert delay(gain, threshold, torque) == pytest.approx(0.0183, abs=1e-4)
    assert math.isinf(delay(gain, threshold, 2.0))


def test_filtered_dynamics_of_first_order_is_the_momentum_observer(
    nominal: NominalModel, wandering: list[Sample]
) -> None:
    gain = nominal.settings.momentum_observer.gain_1_s
    same = with_settings(nominal, filtered_dynamics={"order": 1, "cutoff_1_s": gain})
    a = estimate(create("filtered_dynamics", same), wandering)
    b = estimate(create("momentum_observer", same), wandering)
    # Two filters of sums of 100 Nm against one of their difference: rounding.
    np.testing.assert_allclose(a.tau_ext, b.tau_ext, atol=1e-10)


def test_without_an_accelerometer_the_aided_estimator_is_the_momentum_observer(
    nominal: NominalModel, wandering: list[Sample]
) -> None:
    gain = nominal.settings.momentum_observer.gain_1_s
    same = with_settings(nominal, accelerometer_aided={"cutoff_1_s": gain})
    a = estimate(create("accelerometer_aided", same), wandering)
    b = estimate(create("momentum_observer", same), wandering)
    np.testing.assert_array_equal(a.tau_ext, b.tau_ext)
    np.testing.assert_array_equal(a.covariance, b.covariance)


def test_extended_state_observer_has_two_poles_at_its_bandwidth() -> None:
    """Its impulse response is (1 - z)^2 (n + 1) z^n, and a ramp is followed two poles' delay behind."""
    b, dt = 50.0, PERIOD
    z = math.exp(-b * dt)
    error, w, variance = np.zeros(6), np.zeros(6), np.zeros(6)
    found = []
    for k in range(40):
        extended_state(b * ONE, dt, (k == 0) * ONE, ZERO, ZERO, ZERO, error, w, variance)
        found.append(w[0])
    n = np.arange(40)
    np.testing.assert_allclose(found, (1 - z) ** 2 * (n + 1) * z**n, atol=1e-15)

    error[:], w[:] = 0.0, 0.0
    for k in range(400):
        extended_state(b * ONE, dt, 2.0 * k * dt * ONE, ZERO, ZERO, ZERO, error, w, variance)
    # The sampled poles' delay, 2 z / (1 - z) ticks, is that of 2 / b less a tick.
    assert 2.0 * 399 * dt - w[0] == pytest.approx(2.0 * 2.0 * z / (1 - z) * dt, rel=1e-9)


def test_sliding_mode_converges_in_finite_time_and_only_below_its_slope() -> None:
    s1, s2, dt = 30.0, 10.0, PERIOD

    def track(slope: float, start: float) -> tuple[np.ndarray, np.ndarray]:
        error, s, variance = np.zeros(6), np.zeros(6), np.zeros(6)
        time = np.arange(400) * dt
        torque, found = start + slope * time, []
        for value in torque:
            slide(s1 * ONE, s2 * ONE, dt, value * ONE, ZERO, ZERO, ZERO, error, s, variance)
            found.append(s[0])
        return torque, np.array(found)

    torque, found = track(0.8 * s1, 10.0)
    wrong = np.abs(found - torque)
    # Exact to rounding from some sample on, which no linear observer ever is; the start is 10 Nm off.
    reached = int(np.argmax(wrong < 1e-9))
    assert 0 < reached * dt < 3.0
    assert wrong[reached:].max() < 1e-9
    torque, found = track(3.0 * s1, 0.0)
    # Steeper than S1 can be followed only with an error, that of the linear terms.
    assert np.abs(found - torque)[100:].min() > 0.05


def test_kalman_gains_settle_where_riccati_says() -> None:
    dt, walk, white, momentum = PERIOD, 30.0**2, 4.0, 1e-4
    A, C = np.array([[1.0, dt], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    Q = np.diag([dt**2 * white, walk * dt])
    P = solve_discrete_are(A.T, C.T, Q, np.array([[momentum + _LEAST]]))
    gain = P @ C.T / (C @ P @ C.T + momentum + _LEAST)
    settled = (np.eye(2) - gain @ C) @ P

    error, w, covariance = np.zeros(6), np.zeros(6), np.zeros((3, 6))
    covariance[2] = 1e4
    for _ in range(2000):
        kalman(walk * ONE, dt, ZERO, white * ONE, momentum * ONE, error, covariance, w)
    np.testing.assert_allclose(covariance[:, 0], [settled[0, 0], settled[0, 1], settled[1, 1]], rtol=1e-9)
    # A mean torque of 1 Nm for one step is an innovation of dt.
    kalman(walk * ONE, dt, ONE, white * ONE, momentum * ONE, error, covariance, w)
    np.testing.assert_allclose([dt - error[0], w[0]], gain[:, 0] * dt, rtol=1e-9)


def test_recursive_least_squares_is_the_batch_solution(nominal: NominalModel, wandering: list[Sample]) -> None:
    samples = wandering[:60]
    estimator = create("recursive_least_squares", nominal)
    rows = []
    for sample in samples:
        found = estimator.update(sample)
        rows.append((estimator.arm.mean.copy(), estimator.variance.copy(), estimator.arm.dt))
    forgetting = nominal.settings.recursive_least_squares.forgetting
    steps = np.array([dt for _, _, dt in rows[1:]])
    ages = np.concatenate([np.cumsum(steps[::-1])[::-1][1:], [0.0]])
    weights = forgetting ** (ages / PERIOD) * (1.0 - forgetting ** (steps / PERIOD))
    J = kinematics.jacobian(nominal.arm, np.array([s.actual_q for s in samples[1:]]))
    # One tall weighted system, the prior as six more equations.
    A = [math.sqrt(w) * J_k.T / np.sqrt(row[1])[:, None] for w, J_k, row in zip(weights, J, rows[1:], strict=True)]
    b = [math.sqrt(w) * row[0] / np.sqrt(row[1]) for w, row in zip(weights, rows[1:], strict=True)]
    prior = np.diag(1.0 / np.sqrt(estimator.solver.prior))
    batch = np.linalg.lstsq(np.concatenate([*A, prior]), np.concatenate([*b, np.zeros(6)]), rcond=None)[0]
    np.testing.assert_allclose(found.wrench, batch, rtol=1e-7, atol=1e-8)


def test_direct_runs_the_filter_of_the_whole_log(nominal: NominalModel, run_of) -> None:
    """Sample by sample as scipy does it for all rows at once; to and fro it is late by nothing."""
    samples = list(samples_of(run_of("push_moving")))[:800]
    raw = []
    look = DirectFriction(nominal)
    for sample in samples:
        assert look.look(sample)
        raw.append(look.raw)
    sos = butter_of(nominal)
    expected = sosfilt(sos, np.array(raw), axis=0, zi=sosfilt_zi(sos)[:, :, None] * raw[0])[0]
    found = estimate(DirectFriction(nominal), samples).wrench
    np.testing.assert_allclose(found, expected, atol=1e-8)
    smooth = np.array([row.wrench for row in zero_phase_friction(nominal, samples)])
    shift = [np.abs(smooth[: 800 - lag] - found[lag:]).mean() for lag in range(0, 100, 2)]
    # The causal filter's group delay at low frequency: sum of 1 / (2 Q w) over its poles, 0.354 s, or 44 ticks.
    assert 2 * int(np.argmin(shift)) == pytest.approx(44, abs=8)


def test_the_controllers_estimate_is_its_own_law_where_it_is_not_published(nominal: NominalModel, run_of) -> None:
    """Rows without actual_TCP_force go on from the last that had it, to its digits."""
    recording = run_of("push_moving")
    own = replace(nominal, arm=nominal.arm)
    samples = list(samples_of(recording))[:600]
    published = -np.array([s.actual_TCP_force for s in samples])
    cut = [s._replace(actual_TCP_force=np.full(6, np.nan)) if k >= 200 else s for k, s in enumerate(samples)]
    found = estimate(create("controller", own), cut).wrench
    np.testing.assert_array_equal(found[:200], published[:200])
    # The moment of the tick before is not known where the law is taken up: one tick in 600 is a little off.
    assert np.abs(found - published)[200:].max() < 0.02 * np.abs(published).max()
    law = TcpForce(nominal.arm)
    whole = law(*(np.array([getattr(s, name) for s in samples]) for name in (
        "actual_q", "actual_qd", "actual_current", "target_qd", "target_moment", "target_current"
    )))  # fmt: skip
    alone = estimate(create("controller", own), [s._replace(actual_TCP_force=np.full(6, np.nan)) for s in samples])
    np.testing.assert_allclose(alone.wrench, -whole, atol=1e-9)


def test_variances_are_those_of_the_noise() -> None:
    """Torque and momentum with white noise through the momentum observer: the spread is what it says."""
    rng = np.random.default_rng(3)
    n, dt, gain, white, momentum = 200_000, PERIOD, 50.0, 2.0, 1e-4
    torque, p = math.sqrt(white) * rng.normal(size=n + 1), math.sqrt(momentum) * rng.normal(size=n + 1)
    mean = np.diff(p) / dt - 0.5 * (torque[1:] + torque[:-1])
    share = 1.0 - math.exp(-gain * dt)
    r = lfilter([share], [1.0, share - 1.0], mean)
    # Some 1e5 independent values: 0.5 % for a standard deviation's square, four times that.
    assert r[100:].var() == pytest.approx(averaged_variance(share, dt, white, momentum), rel=0.02)

    z = math.exp(-gain * dt)
    w = lfilter([(1 - z) ** 2], [1.0, -2 * z, z * z], mean)
    error, state, variance = np.zeros(6), np.zeros(6), np.zeros(6)
    extended_state(gain * ONE, dt, ZERO, white * ONE, momentum * ONE, ZERO, error, state, variance)
    assert w[100:].var() == pytest.approx(variance[0], rel=0.02)


class TestAdaptive:
    """What is learnt while nothing touches the arm."""

    @staticmethod
    def scaled(nominal: NominalModel, constant: float, dry: float, viscous: float) -> NominalModel:
        drives = nominal.drives
        friction = replace(
            drives.friction,
            coulomb_positive=drives.friction.coulomb_positive / dry,
            coulomb_negative=drives.friction.coulomb_negative / dry,
            stribeck=drives.friction.stribeck / dry,
            load=drives.friction.load / dry,
            viscous=drives.friction.viscous / viscous,
        )
        constants = drives.torque_constant / constant
        return replace(nominal, drives=replace(drives, torque_constant=constants, friction=friction))

    def test_learns_friction_that_is_believed_too_small(self, nominal: NominalModel, run_of) -> None:
        """Free motion with a nominal friction that is 30 % less than the arm's: most of the residual goes."""
        recording = run_of("free_motion")
        wrong = self.scaled(nominal, 1.0, 1.3, 1.3)
        learning = AdaptiveObserver(wrong)
        found = estimate(learning, samples_of(recording)).tau_ext
        fixed = estimate(MomentumObserver(wrong), samples_of(recording)).tau_ext
        half = len(found) // 2
        left = np.abs(found[half:]).mean(axis=0) / np.abs(fixed[half:]).mean(axis=0)
        # What remains is the noise of currents in motion, a third to a half of the residual.
        assert left.mean() < 0.7
        assert left.max() < 0.95
        # Joints 2 and 3 carry load, so that friction and torque constant can be told apart.
        assert (np.abs(learning.scale[1:3, 1] - 1.3) < 0.15).all()
        assert (np.abs(learning.scale[1:3, 0] - 1.0) < 0.05).all()

    def test_learns_nothing_in_contact_or_at_rest(self, nominal: NominalModel, run_of) -> None:
        recording = run_of("push_x")
        learning = AdaptiveObserver(self.scaled(nominal, 1.1, 1.3, 1.3))
        estimate(learning, samples_of(recording))
        np.testing.assert_array_equal(learning.scale, np.tile([1.0, 1.0, 1.0, 0.0], (6, 1)))

    def test_begins_as_the_momentum_observer(self, nominal: NominalModel, wandering: list[Sample]) -> None:
        gain = nominal.settings.momentum_observer.gain_1_s
        never = with_settings(nominal, adaptive_observer={"gain_1_s": gain, "quiet_s": 1e9})
        a = estimate(create("adaptive_observer", never), wandering).tau_ext
        b = estimate(create("momentum_observer", never), wandering).tau_ext
        # The first mean of the torques takes the first sample twice; a tenth of a second later that is forgotten.
        np.testing.assert_allclose(a[80:], b[80:], atol=1e-6)


def test_the_accelerometer_helps_where_speeds_are_coarse(nominal: NominalModel, run_of) -> None:
    """Speeds with 5 mrad/s of noise make 0.9 rad/s^2 of a tick's difference; the IMU at the flange knows better."""
    scenario = load_scenario("free_motion")
    scenario = replace(
        scenario, arm=replace(scenario.arm, tool="both", declared="both"), duration=8.0,
        sensors=replace(scenario.sensors, preset="ideal"),
    )  # fmt: skip
    recording = ScenarioRun(scenario).finish()
    noise = 5e-3
    believed = load_nominal("plant", "both", sensors="ideal")
    believed = replace(believed, noise=replace(believed.noise, velocity=np.full(6, noise)))
    rng = np.random.default_rng(1)
    samples = [s._replace(actual_qd=s.actual_qd + noise * rng.normal(size=6)) for s in samples_of(recording)]
    blind = [s._replace(imu_acc=np.full(3, np.nan)) for s in samples]
    aided, alone = (estimate(create("accelerometer_aided", believed), rows) for rows in (samples, blind))
    ratio = aided.tau_ext[100:].std(axis=0) / alone.tau_ext[100:].std(axis=0)
    # Three numbers for six joints, of which the wrist's ripple takes its part: joint 2, which moves the flange most,
    # loses a sixth of its noise.
    assert ratio[1] < 0.9
    assert ratio.max() < 1.1
    trace = np.trace(aided.covariance[500]), np.trace(alone.covariance[500])
    assert trace[0] < trace[1]
