"""The cell in somebody else's loop: dm_env's contract, actions, ends, seeds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from absl.testing import absltest
from dm_env import test_utils

from ur5_twin.errors import SimulationError
from ur5_twin.scenario import Scenario, load_scenario
from ur5_twin.scenario.scenario import Sensors, StopLimits
from ur5_twin.twin.cell import PERIOD
from ur5_twin.twin.environment import CellEnvironment


def standing(**changes: object) -> Scenario:
    """The lab's standstill, without its pushes."""
    return replace(load_scenario("push_x"), pushes=(), **changes)


class TestContract(test_utils.EnvironmentTestMixin, absltest.TestCase):
    """dm_env's own checks, with episodes of ten ticks that come to their end."""

    def make_object_under_test(self) -> CellEnvironment:
        return CellEnvironment(standing(), duration=10 * PERIOD)

    def make_action(self) -> np.ndarray:
        return standing().q_start

    def make_action_sequence(self) -> Iterator[np.ndarray]:
        for _ in range(25):
            yield self.make_action()


@pytest.mark.parametrize("scenario", ["push_x", "payload_pickup", "press_plate"])
@pytest.mark.parametrize("truth", [True, False])
def test_observations_are_as_their_specs_say(scenario: str, truth: bool) -> None:
    environment = CellEnvironment(scenario, truth=truth)
    spec = environment.observation_spec()
    step = environment.reset()
    for _ in range(3):
        assert set(step.observation) == set(spec)
        for name, value in step.observation.items():
            spec[name].validate(value)
        step = environment.step(environment.action_spec().validate(load_scenario(scenario).q_start))
    assert any(name.startswith("truth_") for name in spec) == truth
    assert spec["time"].shape == ()
    for name in ("actual_q", "actual_qd", "actual_current", "target_q", "actual_TCP_force", "ft_wrench"):
        assert spec[name].shape == (6,)


def test_an_arm_with_both_sensors_reads_both_and_one_without_none() -> None:
    arm = load_scenario("push_x").arm
    both = CellEnvironment(standing(arm=replace(arm, tool="both"))).observation_spec()
    none = CellEnvironment(standing(arm=replace(arm, tool="none"))).observation_spec()
    newest = {"ft_wrench", "imu_acc", "imu_gyro", "imu_mag"}
    assert newest <= set(both)
    assert not newest & set(none)


def test_a_sensor_that_has_not_reported_yet_reads_nan() -> None:
    """An IMU whose clock begins late has its place in the observations from the first on."""
    from ur5_twin.sensing import load_sensors
    from ur5_twin.twin import environment as module

    lab = load_sensors("lab")
    late = replace(lab, imu_clock=replace(lab.imu_clock, offset=0.1))
    arm = load_scenario("push_x").arm
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "load_sensors", lambda *_, **__: late)
        environment = CellEnvironment(standing(arm=replace(arm, tool="both")))
        step = environment.reset()
        assert np.isnan(step.observation["imu_acc"]).all()
        assert set(step.observation) == set(environment.observation_spec())
        for _ in range(15):
            step = environment.step(standing().q_start)
        assert np.linalg.norm(step.observation["imu_acc"]) == pytest.approx(9.82, abs=0.5)


def test_an_action_is_reached_in_the_observation_after_next() -> None:
    environment = CellEnvironment(standing(sensors=Sensors("ideal")))
    q = environment.reset().observation["truth_q"]
    goal = standing().q_start + 1e-3
    first = environment.step(goal).observation
    np.testing.assert_array_equal(first["target_qd"], 0.0)
    second = environment.step(goal).observation
    np.testing.assert_allclose(second["target_q"], goal, atol=1e-12)
    assert second["time"] == pytest.approx(2 * PERIOD)
    assert np.abs(second["truth_q"] - q).max() > 1e-5


def test_an_action_beyond_the_joints_speed_is_cut_to_it() -> None:
    environment = CellEnvironment(standing())
    environment.reset()
    fastest = load_scenario("push_x").controller_model().limits.qd[:2] * np.array([1.0, -1.0])
    start = standing().q_start
    far = start + np.array([1.0, -1.0, 0.0, 0.0, 0.0, 0.0])
    environment.step(far)
    seen = environment.step(far).observation
    # Rounding.
    np.testing.assert_allclose(seen["target_q"][:2], start[:2] + fastest * PERIOD, atol=1e-12)
    np.testing.assert_allclose(seen["target_qd"][:2], fastest, rtol=1e-9)
    np.testing.assert_allclose(seen["target_q"][2:], start[2:], atol=1e-12)


def test_following_its_own_target_the_arm_moves_where_it_is_led() -> None:
    environment = CellEnvironment(standing(sensors=Sensors("ideal")), duration=2.0)
    target = standing().q_start.copy()
    step = environment.reset()
    while not step.last():
        target[0] += 0.1 * PERIOD
        step = environment.step(target)
    # At 0.1 rad/s for two seconds, one tick behind its command; friction holds it a milliradian back.
    assert step.observation["truth_q"][0] == pytest.approx(target[0], abs=3e-3)
    assert environment.why is None


def test_an_episode_ends_with_its_time_and_goes_on_to_the_next() -> None:
    environment = CellEnvironment(standing(), duration=0.08)
    step = environment.reset()
    steps = 0
    while not step.last():
        step = environment.step(standing().q_start)
        steps += 1
    # The reset does the first of ten ticks.
    assert steps == 9
    assert step.discount == 1.0
    assert step.reward == 0.0
    assert environment.why is None
    assert environment.step(standing().q_start).first()


def test_its_duration_is_the_scenarios_if_it_has_one() -> None:
    environment = CellEnvironment(standing(duration=0.04))
    step, steps = environment.reset(), 1
    while not step.last():
        step, steps = environment.step(standing().q_start), steps + 1
    assert steps == 5


def test_a_protective_stop_ends_an_episode_with_discount_0_and_says_why() -> None:
    environment = CellEnvironment(standing(limits=StopLimits(speed=0.05)), duration=5.0)
    target = standing().q_start.copy()
    step = environment.reset()
    while not step.last():
        target[5] += 1.0 * PERIOD
        step = environment.step(target)
    assert step.discount == 0.0
    assert environment.why is not None
    assert environment.why.startswith("protective stop at ")
    assert "joint 6" in environment.why
    assert environment.recording().robot.time[-1] < 1.0
    assert environment.step(target).first()
    assert environment.why is None


def test_what_overpowers_the_arm_ends_the_episode_too() -> None:
    push = load_scenario("push_x").pushes[0]
    strong = replace(push, profile="step", at=0.1, peak=np.array([0.0, -2000.0, 0.0, 0.0, 0.0, 0.0]))
    environment = CellEnvironment(replace(standing(limits=StopLimits(deviation=0.1)), pushes=(strong,)), duration=5.0)
    step = environment.reset()
    while not step.last():
        step = environment.step(standing().q_start)
    assert step.discount == 0.0
    assert environment.why is not None
    spec = environment.observation_spec()
    assert set(step.observation) == set(spec)


def noise(environment: CellEnvironment, steps: int = 5) -> np.ndarray:
    """(steps, 6) currents of an episode."""
    environment.reset()
    return np.stack([environment.step(standing().q_start).observation["actual_current"] for _ in range(steps)])


def test_seeds() -> None:
    """The same seed is the same row of episodes, each with noise of its own."""
    one, same, other = (CellEnvironment(standing(), seed=seed) for seed in (1, 1, 2))
    first, second = noise(one), noise(one)
    np.testing.assert_array_equal(first, noise(same))
    np.testing.assert_array_equal(second, noise(same))
    assert (first != second).any()
    assert (first != noise(other)).any()


def test_without_a_seed_it_is_the_scenarios() -> None:
    np.testing.assert_array_equal(noise(CellEnvironment(standing(seed=5))), noise(CellEnvironment(standing(), seed=5)))


def test_the_reward_is_the_users() -> None:
    environment = CellEnvironment(standing(), reward=lambda seen: float(seen["time"]))
    assert environment.reset().reward is None
    assert environment.step(standing().q_start).reward == pytest.approx(PERIOD)


@pytest.mark.parametrize(
    "action", [np.zeros(5), np.zeros((6, 1)), np.full(6, np.nan), [np.inf] * 6, None, "home", [[1.0], [2.0, 3.0]]]
)
def test_a_bad_action_is_refused(action: object) -> None:
    environment = CellEnvironment(standing())
    environment.reset()
    with pytest.raises(SimulationError, match="six finite numbers in rad"):
        environment.step(action)  # type: ignore[arg-type]
    # And does no harm.
    assert environment.step(standing().q_start).mid()


def test_its_recording_holds_what_was_observed_and_all_that_sensors_read() -> None:
    environment = CellEnvironment(standing(), duration=0.8)
    step = environment.reset()
    seen = [step.observation]
    while not step.last():
        step = environment.step(standing().q_start)
        seen.append(step.observation)
    recording = environment.recording()
    assert len(recording.robot) == 100
    for name in ("actual_q", "actual_current", "truth_q", "target_current"):
        np.testing.assert_array_equal(recording.robot[name], np.stack([one[name] for one in seen]))
    # 207.66 rows a second, the 75 ms that the sensor is late, which it knows before, and 4 ms that it begins before.
    assert len(recording.tables["ft"]) == pytest.approx(207.66 * (0.8 + 0.079), abs=2)
    np.testing.assert_array_equal(recording.tables["ft"]["ft_wrench"][-1], seen[-1]["ft_wrench"])
