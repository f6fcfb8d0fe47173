"""What a cell's devices report beside the truth: contacts, payloads, the controller's own signals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ur5_twin.arm import kinematics
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.mjcf import BODY_NAMES
from ur5_twin.recording import Recording
from ur5_twin.scenario import Scenario, load_scenario
from ur5_twin.scenario.scenario import Payload, Sensors
from ur5_twin.twin.cell import PERIOD
from ur5_twin.twin.scenario_run import ScenarioRun
from ur5_twin.twin.telemetry import A_PUSH, LINKS


def run_of(scenario: str | Scenario, **changes: object) -> tuple[ScenarioRun, Recording]:
    loaded = load_scenario(scenario) if isinstance(scenario, str) else scenario
    run = ScenarioRun(replace(loaded, **changes), keep_trace=True)
    return run, run.finish()


@pytest.fixture(scope="module")
def pressed() -> tuple[ScenarioRun, Recording]:
    return run_of("press_plate", duration=6.0)


def ticks(time: np.ndarray) -> np.ndarray:
    return np.round(time / PERIOD).astype(int)


def test_contacts_add_up_to_the_true_wrench(pressed: tuple[ScenarioRun, Recording]) -> None:
    """Forces, and their moments about the flange, of the rows of one tick."""
    run, recording = pressed
    contact, robot = recording.tables["contact"], recording.robot
    assert len(contact) > 100
    at = ticks(contact.time)
    np.testing.assert_allclose(contact.time, robot.time[at], atol=1e-9)
    force = np.zeros((len(robot), 3))
    moment = np.zeros((len(robot), 3))
    flange = kinematics.forward(run.setup.plant, robot["truth_q"])[:, :3, 3]
    np.add.at(force, at, contact["contact_force"])
    lever = contact["contact_point"] - flange[at]
    np.add.at(moment, at, np.cross(lever, contact["contact_force"]))
    # Sums in another order, and the engine's float64 frames: rounding.
    np.testing.assert_allclose(force, robot["truth_wrench"][:, :3], atol=1e-9)
    np.testing.assert_allclose(moment, robot["truth_wrench"][:, 3:], atol=1e-9)


def test_contacts_name_the_tool_and_the_plate(pressed: tuple[ScenarioRun, Recording]) -> None:
    contact = pressed[1].tables["contact"]
    assert set(contact["contact_link"][:, 0]) == {float(LINKS.index("tool") + 1)}
    assert set(contact["contact_obstacle"][:, 0]) == {0.0}


def test_the_truth_is_the_trace_at_the_ticks(pressed: tuple[ScenarioRun, Recording]) -> None:
    run, recording = pressed
    trace, robot = run.trace(), recording.robot
    for name, values in (
        ("truth_q", trace.q),
        ("truth_qd", trace.qd),
        ("truth_qdd", trace.qdd),
        ("truth_wrench", trace.wrench),
        ("truth_tau_ext", trace.tau_ext),
        ("truth_friction", trace.friction_torque),
        ("truth_moment", trace.motor_torque),
    ):
        np.testing.assert_array_equal(robot[name], values[::4], err_msg=name)


@pytest.mark.parametrize("turning", [False, True])
@pytest.mark.parametrize("body", ["forearm_link", "wrist_3_link", "tool"])
def test_a_push_is_a_row_with_its_body_point_and_force(body: str, turning: bool) -> None:
    push = load_scenario("push_x").pushes[0]
    peak = np.array([3.0, -4.0, 12.0, 0.0, 0.0, 0.0])
    mine = replace(push, body=body, turning=turning, profile="step", at=0.4, duration=0.197, peak=peak)
    run, recording = run_of("push_x", duration=1.0, pushes=(mine,))
    contact, robot = recording.tables["contact"], recording.robot
    at = ticks(contact.time)
    np.testing.assert_array_equal(at, np.arange(50, 75))
    np.testing.assert_array_equal(contact["contact_obstacle"], A_PUSH)
    link = LINKS.index(body) + 1
    np.testing.assert_array_equal(contact["contact_link"], float(link))
    # A tool's frame is the flange's, link 6's.
    X = kinematics.link_frames(run.setup.plant, robot["truth_q"])[at, min(link, 6)]
    np.testing.assert_allclose(contact["contact_point"], X[:, :3, :3] @ push.point + X[:, :3, 3], atol=1e-12)
    expected = X[:, :3, :3] @ peak[:3] if turning else np.tile(peak[:3], (25, 1))
    np.testing.assert_allclose(contact["contact_force"], expected, atol=1e-12)
    # The truth knows it as the engine applied it, with the lever of the step before: the arm gives way with up to
    # 30 mm/s, 0.06 mm in 2 ms, under 13 N.
    J = kinematics.point_jacobian(run.setup.plant, robot["truth_q"][at], min(link, 6), push.point)
    tau = (np.swapaxes(J, 1, 2)[:, :, :3] @ expected[:, :, None])[:, :, 0]
    np.testing.assert_allclose(robot["truth_tau_ext"][at], tau, atol=1e-3)
    if body == "forearm_link":
        np.testing.assert_array_equal(robot["truth_wrench"], 0.0)


def test_links_are_numbered_as_the_arm_has_them() -> None:
    assert (*BODY_NAMES, "tool") == LINKS


def test_the_controllers_torque_and_current_are_those_of_its_target(pressed: tuple[ScenarioRun, Recording]) -> None:
    run, recording = pressed
    robot = recording.robot
    moment = Dynamics(run.setup.controller).inverse(robot["target_q"], robot["target_qd"], robot["target_qdd"])
    # The same function of the same numbers, in pieces.
    np.testing.assert_allclose(robot["target_moment"], moment, rtol=1e-12, atol=1e-12)
    current = run.setup.law.current(moment, robot["target_qd"])
    np.testing.assert_allclose(robot["target_current"], current, rtol=1e-12, atol=1e-12)


def test_pressing_on_a_plate_the_controller_says_what_the_arm_does_to_it(
    pressed: tuple[ScenarioRun, Recording],
) -> None:
    """actual_TCP_force is the wrench on the surroundings: down, where the truth on the arm is up."""
    robot = pressed[1].robot
    row = int(np.searchsorted(robot.time, 4.9))
    assert robot["truth_wrench"][row, 2] > 15.0
    assert robot["actual_TCP_force"][row, 2] < 0.0


def payload_scenario(declared_at: float | None) -> Scenario:
    payload = Payload(1.0, 1.2, np.array([0.0, 0.0, 0.1]), np.zeros((3, 3)), declared_at)
    return replace(load_scenario("push_x"), duration=4.0, pushes=(), payloads=(payload,), sensors=Sensors("ideal"))


def test_a_payload_hangs_on_the_force_sensor() -> None:
    """Its weight appears in the readings from the tick on at which it is picked up, with its lever to the sensor."""
    run, recording = run_of(payload_scenario(None))
    robot = recording.robot
    np.testing.assert_array_equal(robot["truth_payload_mass"][:, 0], np.where(robot.time < 1.0 - 1e-9, 0.0, 1.2))
    ft = recording.tables["ft"]
    down = kinematics.forward(run.setup.plant, robot["truth_q"])[-1, :3, :3].T @ [0.0, 0.0, -1.0]
    weight = 1.2 * 9.82 * down
    p_FS = np.array([0.0, 0.0, 0.0286])
    assert np.abs(ft["ft_wrench"][ft.time < 0.995]).max() < 1e-6
    # The arm has come to rest: its last microradians a second swing the load by less.
    np.testing.assert_allclose(ft["ft_wrench"][-1, :3], weight, atol=1e-3)
    np.testing.assert_allclose(ft["ft_wrench"][-1, 3:], np.cross(np.array([0.0, 0.0, 0.1]) - p_FS, weight), atol=1e-3)
    np.testing.assert_array_equal(robot["truth_wrench"], 0.0)


def test_a_controller_that_is_told_of_a_payload_plans_its_torque() -> None:
    _, silent = run_of(payload_scenario(None))
    _, told = run_of(payload_scenario(2.0))
    before, after = (told.robot.time < 2.0 - 1e-9), (told.robot.time > 3.5)
    np.testing.assert_array_equal(told.robot["target_moment"][before], silent.robot["target_moment"][before])
    gain = (told.robot["target_moment"] - silent.robot["target_moment"])[after]
    q = told.robot["target_q"][after]
    arm = load_scenario("push_x").plant_model()
    J = kinematics.point_jacobian(arm, q, 6, np.array([0.0, 0.0, 0.1]))
    # Holding 1.2 kg up; the two arms stand milliradians apart, which moves gravity by some hundredths of a Nm.
    np.testing.assert_allclose(gain, J[:, 2] * 1.2 * 9.82, atol=0.1)
    assert np.abs(gain).max() > 5.0


def test_without_payloads_there_is_no_column_of_them(pressed: tuple[ScenarioRun, Recording]) -> None:
    assert "truth_payload_mass" not in pressed[1].robot
