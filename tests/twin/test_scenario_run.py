"""A scenario from beginning to end: seeds, ends, files, and the way of a lab log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ur5_twin import spatial
from ur5_twin.arm.drive import load_drive, load_joint_drives
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.gains import load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.errors import TwinError
from ur5_twin.recording import Recording, read
from ur5_twin.scenario import Scenario, load_scenario
from ur5_twin.scenario.scenario import Sensors, StopLimits
from ur5_twin.sensing import load_sensors
from ur5_twin.twin.cell import PERIOD
from ur5_twin.twin.replay import ReplaySettings, replay
from ur5_twin.twin.scenario_run import ScenarioRun
from ur5_twin.twin.telemetry import NORMAL, PROTECTIVE_STOP
from ur5_twin.views.run_output import LOG, write_run


def scenario(name: str, **changes: object) -> Scenario:
    return replace(load_scenario(name), **changes)


@pytest.fixture(scope="module")
def moving() -> tuple[ScenarioRun, Recording]:
    """Eight seconds of the lab's devices: standstill, motion, pushes in motion."""
    run = ScenarioRun(scenario("push_moving", duration=8.0), seed=3, keep_trace=True)
    return run, run.finish()


def assert_same_bits(one: Recording, other: Recording) -> None:
    assert one.tables.keys() == other.tables.keys()
    for device, table in one.tables.items():
        np.testing.assert_array_equal(table.time, other.tables[device].time, err_msg=device)
        assert table.columns.keys() == other.tables[device].columns.keys()
        for name, values in table.columns.items():
            np.testing.assert_array_equal(values, other.tables[device][name], err_msg=f"{device}.{name}")


def test_the_same_seed_is_the_same_recording(moving: tuple[ScenarioRun, Recording]) -> None:
    again = ScenarioRun(scenario("push_moving", duration=8.0), seed=3)
    assert_same_bits(moving[1], again.finish())


def test_the_scenarios_own_seed_is_taken_if_none_is_given() -> None:
    own = scenario("push_x", duration=1.0, seed=11)
    assert_same_bits(ScenarioRun(own).finish(), ScenarioRun(own, seed=11).finish())


def test_another_seed_is_another_noise_and_the_same_motion(moving: tuple[ScenarioRun, Recording]) -> None:
    one = moving[1]
    other = ScenarioRun(scenario("push_moving", duration=8.0), seed=4).finish()
    idle = ~np.any(np.concatenate([one.robot["target_qd"], one.robot["target_qdd"]], axis=1), axis=1)
    assert 0 < idle.sum() < len(idle)
    for name, values in one.robot.columns.items():
        same = np.asarray(values == other.robot[name])
        if name.startswith("truth_") or name in ("safety_mode", "target_qd", "target_qdd"):
            assert same.all(), name
        elif name.startswith("target_"):
            # An idle controller publishes what it measured, and the torque and current that belong to that.
            assert same[~idle].all(), name
    assert (one.robot["actual_current"] != other.robot["actual_current"]).any()
    assert (one.robot["actual_TCP_force"] != other.robot["actual_TCP_force"]).any()
    n = min(len(one.tables["ft"]), len(other.tables["ft"]))
    assert (one.tables["ft"]["ft_wrench"][:n] != other.tables["ft"]["ft_wrench"][:n]).any()
    contact, theirs = one.tables["contact"], other.tables["contact"]
    for name, values in contact.columns.items():
        np.testing.assert_array_equal(values, theirs[name])


@pytest.mark.parametrize("ticks", [1, 7, 40])
def test_pieces_of_any_length_make_the_same_recording(
    moving: tuple[ScenarioRun, Recording], monkeypatch: pytest.MonkeyPatch, ticks: int
) -> None:
    monkeypatch.setattr("ur5_twin.twin.scenario_run._CHUNK", ticks)
    one, other = moving[1], ScenarioRun(scenario("push_moving", duration=8.0), seed=3).finish()
    for device, table in one.tables.items():
        theirs = other.tables[device]
        assert len(table) == len(theirs)
        for name, values in table.columns.items():
            # The truth's times are counted on from a piece's first: they differ by rounding, and samples between rows
            # with them.
            np.testing.assert_allclose(theirs[name], values, rtol=1e-9, atol=1e-9, err_msg=f"{device}.{name}")


def test_an_idle_controller_publishes_what_it_measured_the_tick_before(moving: tuple[ScenarioRun, Recording]) -> None:
    run, recording = moving
    robot = recording.robot
    idle = ~np.concatenate([robot["target_qd"], robot["target_qdd"]], axis=1).any(axis=1)
    rows = np.flatnonzero(idle)
    rows = rows[rows > 0]
    assert len(rows) > 100
    np.testing.assert_array_equal(robot["target_q"][rows], robot["actual_q"][rows - 1])
    # In motion it publishes the plan.
    planned = run.reference.rows[: len(robot)]
    np.testing.assert_array_equal(robot["target_q"][~idle], planned[~idle, 0])


def test_a_recordings_clocks_and_words(moving: tuple[ScenarioRun, Recording]) -> None:
    run, recording = moving
    assert recording.source == "push_moving"
    assert recording.format == "twin"
    assert recording.notes == ()
    assert len(recording.robot) == len(run) == 1000
    np.testing.assert_array_equal(recording.robot.time, np.arange(1000) * PERIOD)
    assert recording.offset("ft") == pytest.approx(-0.0038)
    assert recording.offset("contact") == 0.0
    assert (recording.robot["safety_mode"] == NORMAL).all()


def test_a_run_lasts_as_long_as_its_scenario_says() -> None:
    """Its duration, if it has one; otherwise until motions and pushes are over, and its settling time."""
    assert len(ScenarioRun(scenario("push_x", duration=2.0, settle=5.0))) == 250
    push = load_scenario("push_x").pushes[0]
    for settle in (0.0, 1.0):
        run = ScenarioRun(scenario("push_x", duration=None, settle=settle, pushes=(push,)))
        # The push ends at 3 s.
        assert len(run) * PERIOD == pytest.approx(3.0 + settle, abs=PERIOD)


def test_a_run_cut_in_motion_is_the_longer_runs_beginning() -> None:
    """To its last row: the tick that is cut off goes where the plan goes."""
    short, long = (ScenarioRun(scenario("push_moving", duration=seconds)).finish() for seconds in (4.0, 4.4))
    n = len(short.robot)
    assert np.abs(short.robot["target_qd"][-1]).max() > 0.1
    for name, values in short.robot.columns.items():
        np.testing.assert_array_equal(values, long.robot[name][:n], err_msg=name)


def test_a_protective_stop_ends_the_run_one_second_later() -> None:
    run = ScenarioRun(load_scenario("collide_025"))
    robot = run.finish().robot
    assert run.over
    assert run.cell.failure is None
    assert run.cell.stop_tick is not None
    stopped = robot["safety_mode"][:, 0] == PROTECTIVE_STOP
    assert np.flatnonzero(stopped)[0] == run.cell.stop_tick
    assert stopped[run.cell.stop_tick :].all()
    assert (robot["safety_mode"][~stopped] == NORMAL).all()
    # One second of 125 ticks.
    assert len(robot) == run.cell.stop_tick + 125 < len(run)
    assert np.abs(robot["truth_qd"][-1]).max() < 0.01 < np.abs(robot["truth_qd"][run.cell.stop_tick]).max()


def test_a_run_that_fails_keeps_what_came_before() -> None:
    push = load_scenario("push_x").pushes[0]
    strong = replace(push, profile="step", at=0.5, peak=np.array([0.0, -2000.0, 0.0, 0.0, 0.0, 0.0]))
    run = ScenarioRun(scenario("push_x", duration=4.0, pushes=(strong,), limits=StopLimits(deviation=0.1)))
    robot = run.finish().robot
    assert run.over
    assert run.cell.failure is not None
    assert 0.5 < robot.time[-1] < 1.5
    assert len(robot) == run.cell.tick
    assert all(np.isfinite(values).all() for values in robot.columns.values())


def test_keeping_the_trace_changes_nothing() -> None:
    short = scenario("push_x", duration=2.0)
    plain, kept = ScenarioRun(short), ScenarioRun(short, keep_trace=True)
    assert_same_bits(plain.finish(), kept.finish())
    trace = kept.trace()
    np.testing.assert_array_equal(trace.q[::4], kept.recording().robot["truth_q"])


@pytest.mark.parametrize("name", ["push_x", "push_rz"])
def test_at_rest_an_ideal_force_sensor_reads_the_true_wrench(name: str) -> None:
    """Less its bias, which is the tool's weight, and taken to the flange in base axes."""
    from ur5_twin.arm import kinematics
    from ur5_twin.recording import force_sensor

    run = ScenarioRun(scenario(name, duration=4.0, sensors=Sensors("ideal")))
    recording = run.finish()
    aligned = recording.aligned()
    tool = run.setup.plant.tool
    X_BF = kinematics.forward(run.setup.plant, aligned["truth_q"])
    bias = force_sensor.sensor_bias(recording)
    found = force_sensor.on_arm(aligned["ft_wrench"], X_BF, tool, bias)
    # On the push's plateau, between 1.5 and 2.5 s; its ramps are still by then, the arm moves by micrometres.
    plateau = (aligned.time > 1.8) & (aligned.time < 2.4)
    truth = aligned["truth_wrench"][plateau]
    assert np.abs(truth).max() == pytest.approx(20.0 if name == "push_x" else 1.0, rel=1e-6)
    # What a truth is asked for: 0.05 N and 0.005 Nm.
    np.testing.assert_allclose(found[plateau, :3], truth[:, :3], atol=0.05)
    np.testing.assert_allclose(found[plateau, 3:], truth[:, 3:], atol=0.005)


def test_with_a_probe_on_it_the_reading_is_the_probes_weight() -> None:
    """Without contact, in sensor axes: the flange looks down, so the probe of 74.6 g pulls along z."""
    recording = ScenarioRun(scenario("press_plate", duration=1.0, sensors=Sensors("ideal"))).finish()
    ft = recording.tables["ft"]["ft_wrench"]
    # 9.82 m/s^2 times the sum of the probe's parts; the servo's milliradians tilt it by less than a thousandth.
    # The last lies beside the run's last row, whose acceleration is another.
    np.testing.assert_allclose(ft[:-1, 2], 9.82 * (0.0271 + 0.0148 + 0.0327), rtol=1e-3)
    np.testing.assert_allclose(ft[:, [0, 1, 3, 4, 5]], 0.0, atol=5e-3)


def test_a_recording_goes_the_way_of_a_lab_log(moving: tuple[ScenarioRun, Recording], tmp_path: Path) -> None:
    """Written and read back, and replayed with the wrench that its force sensor measured: the currents come again."""
    run, recording = moving
    write_run(run, recording, tmp_path / "out", rerun=False, figures=False)
    back = read(tmp_path / "out" / "recording.parquet")
    assert_same_bits(recording, back)
    assert (back.source, back.format, back.notes) == (recording.source, recording.format, ())

    log = read(tmp_path / "out" / LOG)
    assert set(log.tables) == {"robot", "ft"}
    assert not [name for name in log.robot.columns if name.startswith("truth_")]
    for device in ("robot", "ft"):
        for name, values in log.tables[device].columns.items():
            # Six decimals.
            np.testing.assert_allclose(values, recording.tables[device][name], atol=0.51e-6, err_msg=name)
    assert log.offset("ft") == pytest.approx(-0.0038, abs=1e-6)

    settings = ReplaySettings(
        model=load_model("controller"),
        plant=load_model("plant", "ati_gamma"),
        gains=load_gains("servo"),
        drive=load_drive("thesis"),
        target_current=load_target_current_law(),
        joints=load_joint_drives(),
        wrench="measured",
        ft_delay=load_sensors("lab").ft.delay,
    )
    robot = replay(log, settings).robot
    moves = np.abs(robot["target_qd"]) > 0.05
    lab = load_sensors("lab")
    assert lab.current.noise is not None
    true = run.trace().current[::4]
    for joint in range(6):
        simulated = robot["sim_actual_current"][:, joint]
        together = np.corrcoef(true[:, joint], simulated)[0, 1]
        assert together > 0.95, joint
        # What the log's currents have beyond is the noise that the devices put on them, whose spread 500 correlated
        # rows tell to 7 %, and the replay's own error.
        beyond = (robot["actual_current"][:, joint] - simulated)[moves[:, joint]]
        assert beyond.std() < 1.25 * np.hypot(lab.current.noise, lab.current_moving)[joint], joint
    # Where the arm was: friction holds the wrist's joints apart by up to a quarter of a milliradian, where they started
    # from different ends of the encoders' steps and of the readings' noise; twice that.
    assert np.abs(robot["sim_actual_q"] - recording.robot["truth_q"]).max() < 5e-4


def test_a_run_in_which_nothing_touches_is_written_and_read_too(tmp_path: Path) -> None:
    run = ScenarioRun(scenario("free_motion", duration=2.0))
    recording = run.finish()
    assert "contact" not in recording.tables
    write_run(run, recording, tmp_path, rerun=False, figures=False)
    assert_same_bits(recording, read(tmp_path))


def test_late_packages_are_written_with_increasing_time(tmp_path: Path) -> None:
    run = ScenarioRun(scenario("push_moving", duration=5.0, sensors=Sensors("lab", late_packages=True)))
    recording = run.finish()
    robot = recording.robot
    assert (np.diff(robot.time) > 0).all()
    np.testing.assert_array_equal(robot["timestamp"][:, 0], np.arange(625) * PERIOD)
    assert (robot.time != robot["timestamp"][:, 0]).any()
    write_run(run, recording, tmp_path, rerun=False, figures=False)
    # Times of the log in microseconds.
    np.testing.assert_allclose(read(tmp_path / LOG).robot.time, robot.time, atol=0.51e-6)


def test_the_pose_that_is_published_is_that_of_the_measured_joints(moving: tuple[ScenarioRun, Recording]) -> None:
    run, recording = moving
    from ur5_twin.arm import kinematics

    robot = recording.robot
    published = spatial.pose_from_vector(robot["actual_TCP_pose"])
    expected = kinematics.forward(run.setup.controller, robot["actual_q"])
    # Rounding through a rotation vector, which loses digits near a half turn.
    np.testing.assert_allclose(published, expected, atol=1e-6)


def test_what_cannot_be_is_said_before_anything_runs() -> None:
    far = replace(load_scenario("press_plate"), q_start=np.array([-0.1, -1.0, -1.2, 0.4, -1.6, 1.5]))
    with pytest.raises(TwinError):
        ScenarioRun(far)
