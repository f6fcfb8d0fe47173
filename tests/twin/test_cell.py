"""The cell: truth in contact, stops, payloads, and odd ends."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.arm import kinematics
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.mjcf import Obstacle
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.program import plan
from ur5_twin.control.trajectory import rest
from ur5_twin.errors import ScenarioError, SimulationError
from ur5_twin.recording import read
from ur5_twin.recording.force_sensor import sensor_bias
from ur5_twin.resources import data_dir
from ur5_twin.scenario import LogPush, Push, Scenario, load_scenario
from ur5_twin.scenario.program import program_of
from ur5_twin.twin import _loop_kernel as kernel
from ur5_twin.twin.cell import PERIOD, Cell, Payload, Setup, concatenate
from ur5_twin.twin.closed_loop import Limits
from ur5_twin.twin.fleet import advance_all
from ur5_twin.twin.setup import carrying, setup_of


def cell_of(scenario: Scenario, **changes) -> tuple[Cell, np.ndarray]:
    """A scenario's cell and its target rows."""
    setup = replace(setup_of(scenario), **changes)
    return Cell(setup), plan(setup.controller, scenario.q_start, program_of(scenario), period=PERIOD).rows


def run(scenario: str | Scenario, **changes) -> tuple[Cell, kernel.Trace]:
    made = load_scenario(scenario) if isinstance(scenario, str) else scenario
    cell, rows = cell_of(made, **changes)
    return cell, concatenate([piece.trace for piece in cell.advance(rows[1:])])


def standing(setup: Setup, seconds: float) -> tuple[Cell, kernel.Trace]:
    cell = Cell(setup)
    rows = rest(setup.q_start, seconds=seconds, period=PERIOD)
    return cell, concatenate([piece.trace for piece in cell.advance(rows)])


@pytest.fixture(scope="module")
def pressed() -> tuple[Cell, kernel.Trace]:
    return run("press_plate")


def test_pressed_into_a_plate_the_force_is_stiffness_times_depth(pressed: tuple[Cell, kernel.Trace]) -> None:
    """Held 1, 2 and 3 mm deep in a plate of 2e4 N/m: 20, 40 and 60 N, as deep as the flange itself says it is."""
    cell, trace = pressed
    plant = cell.setup.plant
    X_BF = kinematics.forward(plant, trace.q)
    tip = X_BF[:, 2, 3] - (151.0 - 0.0) * 1e-3
    depth = 0.2 - tip
    # The last tick of each wait, when the servo has brought the flange where it belongs.
    held = [np.searchsorted(trace.time, t) for t in (4.9, 8.0, 11.1)]
    for row in held:
        assert trace.wrench[row, 2] == pytest.approx(2e4 * depth[row], rel=0.05)
    assert trace.wrench[held[2], 2] == pytest.approx(60.0, rel=0.02)


def test_at_rest_every_way_to_the_truth_agrees(pressed: tuple[Cell, kernel.Trace]) -> None:
    """Contact sum, J^-T of the joint torque that the contacts make, and what dynamics miss, at rest in contact."""
    cell, trace = pressed
    plant = cell.setup.plant
    row = np.searchsorted(trace.time, 11.1)
    J = kinematics.jacobian(plant, trace.q[row])
    from_joints = np.linalg.solve(J.T, trace.tau_ext[row])
    # 0.05 N and 0.005 Nm are asked for; rounding is what there is.
    np.testing.assert_allclose(from_joints[:3], trace.wrench[row, :3], atol=1e-6)
    np.testing.assert_allclose(from_joints[3:], trace.wrench[row, 3:], atol=1e-6)
    missed = Dynamics(plant).gravity(trace.q[row]) - trace.motor_torque[row] + trace.friction_torque[row]
    balance = np.linalg.solve(J.T, missed)
    np.testing.assert_allclose(balance[:3], trace.wrench[row, :3], atol=0.05)
    np.testing.assert_allclose(balance[3:], trace.wrench[row, 3:], atol=0.005)
    listed = trace.contact_row == row - row % 4
    total = trace.contact_force[listed].sum(axis=0)
    np.testing.assert_allclose(total, trace.wrench[row - row % 4, :3], atol=1e-9)


def test_contacts_are_listed_with_body_and_point(pressed: tuple[Cell, kernel.Trace]) -> None:
    cell, trace = pressed
    assert (trace.contact_link == 7).all()
    assert {cell.geoms[geom] for geom in trace.contact_geoms[:, 1]} == {"obstacle_plate"}
    assert {cell.geoms[geom] for geom in trace.contact_geoms[:, 0]} == {"tool_probe_ball"}
    # On the plate's top face, half the depth below it at most 1.5 mm.
    assert np.abs(trace.contact_point[:, 2] - 0.2).max() < 2e-3
    np.testing.assert_allclose(trace.contact_point[:, 0], 0.45, atol=2e-3)


def test_in_contact_and_motion_the_equations_of_motion_close() -> None:
    cell, trace = run("slide_plate")
    needed = Dynamics(cell.setup.plant).inverse(trace.q, trace.qd, trace.qdd)
    given = trace.motor_torque - trace.friction_torque + trace.tau_ext
    assert np.linalg.norm(trace.wrench[:, :3], axis=1).max() > 20.0
    assert (np.abs(needed - given).max(axis=0) < 0.01 * np.abs(given).max(axis=0)).all()


def test_a_contact_elsewhere_is_no_wrench_at_the_flange() -> None:
    _, trace = run("forearm_contact")
    assert np.abs(trace.tau_ext).max() > 10.0
    np.testing.assert_array_equal(trace.wrench, 0.0)
    assert set(trace.contact_link) == {3}


def test_a_payload_weighs_what_it_weighs() -> None:
    """After it is picked up the motors carry it; a controller that was told asks for just that."""
    setup = setup_of(load_scenario("push_x"))
    center, tensor = np.array([0.02, 0.0, 0.1]), np.diag([0.01, 0.01, 0.005])
    picked = replace(setup, pushes=(), payloads=(Payload(0.5, 1.5, center, tensor),))
    told = replace(picked, told=((1.0, carrying(setup.controller, 1.5, center, tensor)),))
    q = setup.q_start
    gain = Dynamics(carrying(setup.plant, 1.5, center, tensor)).gravity(q) - Dynamics(setup.plant).gravity(q)
    for changed in (picked, told):
        cell, trace = standing(changed, 6.0)
        held = trace.motor_torque - trace.friction_torque
        # The servo's milliradians move gravity by some thousandths of a Nm.
        np.testing.assert_allclose(held[-1] - held[200], gain, atol=0.02)
        assert cell.failure is None
        np.testing.assert_array_equal(trace.tau_ext, 0.0)


def test_a_collision_ends_in_a_protective_stop() -> None:
    """It brakes, and then holds where it is, whatever the program says."""
    cell, rows = cell_of(load_scenario("collide_025"))
    pieces = cell.advance(rows[1:])
    assert cell.stop_reason is not None
    assert cell.stop_reason.startswith("protective stop at ")
    assert cell.failure is None
    assert not pieces[0].stopped.any()
    assert pieces[-1].stopped.all()
    targets = np.concatenate([piece.targets for piece in pieces])
    assert len(targets) == len(rows) - 1
    stopped = cell.stop_tick
    assert stopped is not None
    # From 0.25 m/s the brakes need less than 0.2 s.
    np.testing.assert_array_equal(targets[stopped + 25 :, 1], 0.0)
    assert np.ptp(targets[stopped + 25 :, 0], axis=0).max() == 0.0


def test_no_limit_no_stop() -> None:
    cell, _ = run("collide_025", limits=Limits())
    assert cell.stop_reason is None


def strong_push(newtons: float) -> Push:
    return Push(
        body="tool",
        point=np.zeros(3),
        turning=False,
        profile="step",
        at=0.5,
        duration=3.0,
        rise=0.0,
        peak=np.array([0.0, -newtons, 0.0, 0.0, 0.0, 0.0]),
    )


def test_two_thousand_newtons_overpower_the_arm() -> None:
    """The stop comes at once; what cannot be held ends the run, with everything up to there kept."""
    setup = replace(setup_of(load_scenario("push_x")), pushes=(strong_push(2000.0),), limits=Limits(deviation=0.1))
    cell, trace = standing(setup, 4.0)
    assert cell.stop_reason is not None
    assert cell.failure is not None
    assert "something overpowers the stopped arm" in cell.failure
    assert "0." in cell.failure.split()[1]
    assert 0.5 < trace.time[-1] < 1.5
    assert np.isfinite(trace.q).all()
    assert cell.advance(rest(setup.q_start, seconds=1.0, period=PERIOD)) == []


def test_an_unstable_simulation_ends_with_the_time() -> None:
    """Drives made for rotors on an arm without them: its wrist weighs a thousandth of what they expect."""
    setup = setup_of(load_scenario("push_x"))
    strong = replace(load_model("c", "ati_gamma"), limits=replace(setup.plant.limits, torque=np.full(6, 1e6)))
    with pytest.raises(SimulationError, match="does not hold its start: the simulation diverged"):
        Cell(replace(setup, plant=strong))


def test_a_start_inside_an_obstacle_says_what_overlaps() -> None:
    setup = setup_of(load_scenario("push_x"))
    p = kinematics.forward(setup.plant, setup.q_start)[:3, 3]
    block = Obstacle("block", "box", p, np.zeros(3), np.full(3, 0.1), 1e4, 100.0, 0.3)
    with pytest.raises(ScenarioError, match=r"starts inside something: .*obstacle_block.* overlap by .* mm at 0.000 s"):
        Cell(replace(setup, obstacles=(block,)))


def test_a_reset_cell_does_the_same_again() -> None:
    cell, rows = cell_of(load_scenario("payload_pickup"))
    first = concatenate([piece.trace for piece in cell.advance(rows[1:])])
    cell.reset()
    again = concatenate([piece.trace for piece in cell.advance(rows[1:])])
    for name in ("q", "qd", "motor_torque", "friction_torque", "current"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))


def test_pieces_of_any_length_make_the_same_run() -> None:
    cell, rows = cell_of(load_scenario("payload_pickup"))
    whole = concatenate([piece.trace for piece in cell.advance(rows[1:])])
    cell.reset()
    pieces = []
    for k in range(1, len(rows), 37):
        pieces += cell.advance(rows[k : k + 37])
    np.testing.assert_array_equal(concatenate([piece.trace for piece in pieces]).q, whole.q)


def test_many_cells_on_many_threads_are_each_the_one() -> None:
    scenario = load_scenario("push_x")
    setup = setup_of(scenario)
    rows = rest(setup.q_start, seconds=1.5, period=PERIOD)
    alone = Cell(setup)
    expected = concatenate([piece.trace for piece in alone.advance(rows)])
    cells = [Cell(setup) for _ in range(4)]
    for pieces in advance_all(cells, rows, threads=2):
        np.testing.assert_array_equal(concatenate([piece.trace for piece in pieces]).q, expected.q)


def test_mismatch_reaches_the_plant_and_not_the_controller() -> None:
    scenario = load_scenario("push_x")
    mismatch = replace(
        scenario.mismatch,
        link_mass_scale=np.full(6, 1.1),
        torque_constant_scale=np.full(6, 0.9),
        offset=np.full(6, 0.5),
    )
    setup, plain = setup_of(replace(scenario, mismatch=mismatch)), setup_of(scenario)
    np.testing.assert_allclose(
        [link.mass for link in setup.plant.links], [1.1 * link.mass for link in plain.plant.links]
    )
    np.testing.assert_allclose(setup.drives.torque_constant, 0.9 * plain.drives.torque_constant)
    np.testing.assert_allclose(setup.drives.offset, plain.drives.offset + 0.5)
    assert setup.controller.name == load_model("controller").name
    np.testing.assert_array_equal(
        [link.mass for link in setup.controller.links], [link.mass for link in plain.controller.links]
    )


def test_a_plant_brings_its_own_joints(tmp_path: Path) -> None:
    """A model file that names its motors and gears is simulated with them."""
    joints = (data_dir("models") / "ur5_joints.toml").read_text(encoding="utf-8")
    constants = "torque_constant_nm_a = [9.26, 10.98, 10.23, 7.17, 7.11, 9.19]"
    assert constants in joints
    (tmp_path / "mine.toml").write_text(joints.replace(constants, "torque_constant_nm_a = [8, 8, 8, 8, 8, 8]"))
    plant = (data_dir("models") / "ur5_plant.toml").read_text(encoding="utf-8")
    (tmp_path / "arm.toml").write_text(plant.replace("ur5_joints.toml", "mine.toml"))
    scenario = load_scenario("push_x")
    setup = setup_of(replace(scenario, arm=replace(scenario.arm, plant=tmp_path / "arm.toml")))
    np.testing.assert_array_equal(setup.drives.torque_constant, np.full(6, 8.0))


def test_a_log_s_push_comes_again(lab_logs: Path) -> None:
    """The force that the lab's sensor read, put on the twin's arm in the same posture, is the truth's wrench there."""
    log = lab_logs / "Movement_No10_Standstill_ForceSensor_Fx"
    recording = read(log, repair=True)
    scenario = load_scenario("push_x")
    push = LogPush(body="wrist_3_link", point=np.zeros(3), at=0.5, path=log, first=8.0, last=13.0, scale=1.0)
    setup = setup_of(replace(scenario, pushes=(push,), q_start=recording.robot["actual_q"][0]))
    _, trace = standing(setup, 6.0)
    # At 9.6 s of the log, 2.1 s of the run, somebody pushes with some 60 N.
    assert np.linalg.norm(trace.wrench[:, :3], axis=1).max() > 55.0
    assert np.abs(trace.wrench[trace.time < 0.49]).max() == 0.0
    sizes = np.linalg.norm(recording.tables["ft"]["ft_wrench"][:, :3] - sensor_bias(recording)[:3], axis=1)
    during = (recording.tables["ft"].time > 8.0) & (recording.tables["ft"].time < 13.0)
    assert np.linalg.norm(trace.wrench[:, :3], axis=1).max() == pytest.approx(sizes[during].max(), rel=0.03)
