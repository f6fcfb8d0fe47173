"""The closed loop and the two twins against what the equations say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.gains import Gains, load_gains
from ur5_twin.errors import ReplayError, SimulationError
from ur5_twin.twin.closed_loop import ClosedLoop
from ur5_twin.twin.lockstep import LONGEST_GAP, ServoTwin, ShadowTwin
from ur5_twin.twin.sample import Sample

HOME = np.array([0.3, -1.4, 1.1, -0.9, 0.7, 0.2])
TICK = 0.008


def sinusoids(t: np.ndarray) -> np.ndarray:
    """(n, 3, 6) targets of a motion that swings every joint, up to 1 rad/s and 4 rad/s^2."""
    w = np.array([1.0, 1.7, 2.3, 3.1, 3.9, 4.4])
    amplitude = np.array([0.6, 0.4, 0.3, 0.3, 0.25, 0.2])
    phase = np.outer(t, w)
    # 1 - cos has no velocity at t = 0.
    q = HOME + amplitude * (1.0 - np.cos(phase))
    return np.stack([q, amplitude * w * np.sin(phase), amplitude * w**2 * np.cos(phase)], axis=1)


def samples(t: np.ndarray, targets: np.ndarray) -> list[Sample]:
    """What a robot without tracking error reports."""
    return [
        Sample(time, target[0], target[1], target)
        for time, target in zip(t.tolist(), np.ascontiguousarray(targets), strict=True)
    ]


def follow(t: np.ndarray, targets: np.ndarray, twin: ServoTwin) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q, qd, moment = zip(*(twin.tick(sample)[:3] for sample in samples(t, targets)), strict=True)
    return np.array(q), np.array(qd), np.array(moment)


def loop(model: str = "controller", gains: Gains | None = None, plant: str | None = None, **options) -> ClosedLoop:
    return ClosedLoop(load_model(model), load_model(plant or model), gains or load_gains(), **options)


@pytest.mark.parametrize("model", ["a", "b", "c", "controller", "plant"])
@pytest.mark.parametrize("gains", ["thesis_21", "thesis_c"])
def test_exact_linearisation_follows_a_smooth_target_whatever_the_gains(model: str, gains: str) -> None:
    t = np.arange(400) * TICK
    targets = sinusoids(t)
    q, qd, _ = follow(t, targets, ServoTwin(loop(model, load_gains(gains))))
    # Second order in the 2 ms substep, 4e-5 rad with a closed-loop pole near 1 1/s; a held reference would be 4 mrad
    # off, first-order stepping 1 mrad.
    assert np.abs(q - targets[:, 0]).max() < 1e-4
    assert np.abs(qd - targets[:, 1]).max() < 2e-4


def test_error_falls_with_the_square_of_the_substep() -> None:
    t = np.arange(250) * TICK
    targets = sinusoids(t)
    error = [
        np.abs(follow(t, targets, ServoTwin(loop(substep=substep)))[0] - targets[:, 0]).max()
        for substep in (0.008, 0.004, 0.002)
    ]
    assert error[0] / error[1] > 3.0
    assert error[1] / error[2] > 3.0


def test_an_initial_error_decays_as_the_pd_law_says() -> None:
    """e'' + K1 e' + K0 e = 0 with e(0) = e0, e'(0) = 0 has two real poles for these gains."""
    gains = load_gains("thesis_c")
    t = np.arange(300) * TICK
    target = np.stack([HOME, np.zeros(6), np.zeros(6)])
    twin = loop(gains=gains)
    e0 = np.full(6, 2e-3)
    twin.reset(HOME + e0, np.zeros(6))
    error = [e0]
    for _ in t[1:]:
        twin.advance(target, target, TICK)
        error.append(twin.state(target).q - HOME)
    root = np.sqrt(gains.kappa1**2 / 4 - gains.kappa0)
    p1, p2 = -gains.kappa1 / 2 + root, -gains.kappa1 / 2 - root
    expected = e0 * (p2 * np.exp(np.outer(t, p1)) - p1 * np.exp(np.outer(t, p2))) / (p2 - p1)
    # 2 ms steps against a fast pole of up to 83 1/s: (pole * h)^2 / 12 = 0.2 % of the error that is left.
    assert np.abs(np.array(error) - expected).max() < 5e-3 * e0.max()


def test_jitter_and_gaps_are_honoured() -> None:
    rng = np.random.default_rng(7)
    t = np.cumsum(rng.uniform(0.0075, 0.0085, 500))
    t = np.delete(t, [50, 51, 120, 300, 301, 302])  # lost packets: gaps of up to four ticks
    targets = sinusoids(t)
    q, _, _ = follow(t, targets, ServoTwin(loop()))
    # Over a gap of 34 ms the quintic bridges what was not said, to 1e-4 rad at these frequencies.
    assert np.abs(q - targets[:, 0]).max() < 2e-4


def test_a_step_of_the_target_carries_the_twin_and_costs_no_torque() -> None:
    t = np.arange(60) * TICK
    targets = np.tile(np.stack([HOME, np.zeros(6), np.zeros(6)]), (len(t), 1, 1))
    targets[30:, 0] += 3e-3
    closed = loop()
    q, _, moment = follow(t, targets, ServoTwin(closed))
    assert np.abs(q - targets[:, 0]).max() < 1e-9
    assert np.allclose(closed.largest_step, 3e-3, atol=1e-9)
    gravity = Dynamics(load_model("controller")).gravity(q)
    assert np.abs(moment - gravity).max() < 1e-6


def test_torque_is_the_inverse_dynamics_of_the_motion() -> None:
    t = np.arange(200) * TICK
    targets = sinusoids(t)
    _, _, moment = follow(t, targets, ServoTwin(loop("plant")))
    expected = Dynamics(load_model("plant")).inverse(targets[:, 0], targets[:, 1], targets[:, 2])
    # The tracking error above times the gains and an inertia of up to 5 kg m^2.
    assert np.abs(moment - expected).max() < 0.1


def test_a_wrong_model_shows_in_the_tracking() -> None:
    t = np.arange(400) * TICK
    targets = sinusoids(t)
    right = follow(t, targets, ServoTwin(loop("plant")))[0]
    wrong = follow(t, targets, ServoTwin(loop("controller", plant="plant")))[0]
    assert np.abs(wrong - targets[:, 0]).max() > 20 * np.abs(right - targets[:, 0]).max()


@pytest.mark.parametrize(("tick", "substep"), [(0.008, 0.002), (0.008, 0.0005), (0.002, 0.002)])
def test_an_unknown_load_pulls_the_loop_off_by_what_statics_say(tick: float, substep: float) -> None:
    """At rest K0 e = M^-1 (g of the controller - g of the plant), whatever the steps."""
    gains = load_gains()
    controller, plant = load_model("controller"), load_model("controller", "ati_gamma")
    closed = ClosedLoop(controller, plant, gains, substep=substep)
    still = np.stack([HOME, np.zeros(6), np.zeros(6)])
    closed.reset(HOME, np.zeros(6))
    for _ in range(round(15.0 / tick)):
        closed.advance(still, still, tick)
    q = closed.state(still).q
    unknown = Dynamics(controller).gravity(q) - Dynamics(plant).gravity(q)
    expected = np.linalg.solve(Dynamics(controller).mass_matrix(q), unknown) / gains.kappa0
    assert np.abs(expected).max() > 0.04
    # The slow pole of 1 1/s has 3e-7 of the way left after 15 s.
    assert np.allclose(q - HOME, expected, atol=1e-6)


def test_a_step_no_arm_can_make_is_an_error() -> None:
    closed = loop()
    closed.reset(HOME, np.zeros(6))
    still = np.stack([HOME, np.zeros(6), np.zeros(6)])
    degrees = still * 57.3
    with pytest.raises(SimulationError, match="is it in rad"):
        closed.advance(still, degrees, TICK)


def test_the_twin_does_not_know_the_future() -> None:
    t = np.arange(100) * TICK
    targets = sinusoids(t)
    whole = follow(t, targets, ServoTwin(loop()))
    start = follow(t[:40], targets[:40], ServoTwin(loop()))
    for ours, theirs in zip(whole, start, strict=True):
        assert np.array_equal(ours[:40], theirs)


def test_a_long_silence_starts_the_twin_again() -> None:
    t = np.concatenate([np.arange(20) * TICK, 5.0 + np.arange(20) * TICK])
    targets = sinusoids(t)
    twin = ServoTwin(loop())
    q, _, _ = follow(t, targets, twin)
    assert twin.restarts == [5.0]
    assert 5.0 - t[19] > LONGEST_GAP
    assert np.abs(q - targets[:, 0]).max() < 1e-4


def test_motors_have_limits() -> None:
    """A motion that needs 500 Nm is not followed: the motors give 150 and 28 Nm."""
    t = np.arange(60) * TICK
    targets = sinusoids(t)
    targets[:, 0] = HOME + 60.0 * 0.5 * t[:, None] ** 2
    targets[:, 1], targets[:, 2] = 60.0 * t[:, None], 60.0
    q, _, moment = follow(t, targets, ServoTwin(loop("plant")))
    limits = load_model("plant").limits.torque
    assert (np.abs(moment) <= limits).all()
    assert np.abs(moment[10:, 1]).max() == limits[1]
    assert np.abs(q - targets[:, 0])[-1, 1] > 0.1


@pytest.mark.parametrize("twin", ["servo", "shadow"])
def test_a_clock_that_stands_or_runs_back_is_an_error(twin: str) -> None:
    t = np.array([0.0, TICK, TICK])
    model = load_model("controller")
    made = ServoTwin(loop()) if twin == "servo" else ShadowTwin(loop(), model)
    sent = samples(t, sinusoids(t))
    made.tick(sent[0])
    made.tick(sent[1])
    with pytest.raises(ReplayError, match=r"0\.008000 s.*must increase"):
        made.tick(sent[2])


def test_servo_needs_targets() -> None:
    twin = ServoTwin(loop())
    with pytest.raises(ReplayError, match="shadow"):
        twin.tick(Sample(0.0, HOME, np.zeros(6)))


def test_shadow_gives_the_torque_of_the_measured_motion() -> None:
    t = np.arange(50) * TICK
    targets = sinusoids(t)
    model = load_model("plant")
    twin = ShadowTwin(loop("plant"), model)
    measured = [
        sample._replace(actual_q=sample.actual_q + 1e-3, actual_qd=sample.actual_qd * 0.99)
        for sample in samples(t, targets)
    ]
    predictions = [twin.tick(sample) for sample in measured]
    dynamics = Dynamics(model)
    for sample, prediction in zip(measured, predictions, strict=True):
        assert sample.target is not None
        expected = dynamics.inverse(sample.actual_q, sample.actual_qd, sample.target[2])
        assert np.allclose(prediction.moment, expected, atol=1e-12)
    # One tick ahead of the measured state, not of the target: an offset of 1 mrad stays.
    ahead = np.array([p.q for p in predictions]) - targets[:, 0]
    assert np.abs(ahead[1:] - 1e-3).max() < 2e-4


def test_shadow_without_targets_takes_the_acceleration_from_the_velocities() -> None:
    t = np.arange(50) * TICK
    qdd = np.array([0.5, -0.4, 0.3, 0.2, -0.6, 1.0])
    model = load_model("plant")
    twin = ShadowTwin(loop("plant"), model)
    sent = [Sample(float(x), HOME + 0.5 * qdd * x**2, qdd * x) for x in t]
    predictions = [twin.tick(sample) for sample in sent]
    last = sent[-1]
    expected = Dynamics(model).inverse(last.actual_q, last.actual_qd, qdd)
    assert np.allclose(predictions[-1].moment, expected, atol=1e-9)
    assert np.allclose(predictions[-1].q, last.actual_q, atol=1e-12)


def test_a_tool_is_carried() -> None:
    """The torque at rest is gravity's, tool included."""
    bare, tooled = load_model("plant"), load_model("plant", "ati_gamma")
    still = np.stack([HOME, np.zeros(6), np.zeros(6)])
    closed = ClosedLoop(tooled, tooled, load_gains())
    closed.reset(HOME, np.zeros(6))
    closed.advance(still, still, TICK)
    prediction = closed.state(still)
    assert np.allclose(prediction.q, HOME, atol=1e-9)
    assert np.allclose(prediction.moment, Dynamics(tooled).gravity(HOME), atol=1e-6)
    assert np.abs(prediction.moment - Dynamics(bare).gravity(HOME)).max() > 1.0


def test_instability_is_reported() -> None:
    wild = Gains("wild", "test", np.full(6, 1e9), np.full(6, -1e6))
    start = np.stack([HOME, np.zeros(6), np.zeros(6)])
    model = load_model("controller")
    strong = replace(model, limits=replace(model.limits, torque=np.full(6, 1e12)))
    closed = ClosedLoop(strong, strong, wild)
    closed.reset(HOME + 1e-3, np.zeros(6))

    def run() -> None:
        for _ in range(200):
            closed.advance(start, start, TICK)

    with pytest.raises(SimulationError, match="diverged"):
        run()
