"""Wrenches of every source as one thing: on the arm, at the flange, in base axes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.recording import Recording, Table, force_sensor, read
from ur5_twin.views import wrenches


def test_the_sensor_s_reading_becomes_the_push(
    replayed: Recording, model: ArmModel, push: Callable[[np.ndarray], np.ndarray]
) -> None:
    X_BF = kinematics.forward(model, replayed.robot["actual_q"])
    found = {item.key: item for item in wrenches.find(replayed, X_BF, model.tool)}
    assert set(found) == {"controller", "sensor", "truth_wrench"}
    sensed = found["sensor"].values
    inside = np.isfinite(sensed).all(axis=1)
    assert inside.sum() > 490
    # Linear interpolation over 4.8 ms of a push of 1 Hz: amplitude * (2 pi h)^2 / 8, below 5 mN; the sensor's poses are
    # interpolated too.
    np.testing.assert_allclose(sensed[inside], push(replayed.robot.time)[inside], atol=0.02)


def test_without_a_tool_the_force_is_the_same_and_the_moment_is_about_the_sensor(
    replayed: Recording, model: ArmModel
) -> None:
    X_BF = kinematics.forward(model, replayed.robot["actual_q"])
    with_tool, without = (wrenches.find(replayed, X_BF, tool)[1].values for tool in (model.tool, None))
    np.testing.assert_allclose(without[:, :3], with_tool[:, :3], atol=1e-9)
    assert np.nanmax(np.abs(without[:, 3:] - with_tool[:, 3:])) > 0.1


def test_a_given_bias_is_taken(replayed: Recording, model: ArmModel) -> None:
    X_BF = kinematics.forward(model, replayed.robot["actual_q"])
    later = replayed.with_table(_from(replayed.tables["ft"], 400)).with_table(_from(replayed.robot, 250))
    bias = force_sensor.sensor_bias(replayed)
    whole = wrenches.find(replayed, X_BF, model.tool)[1].values[250:]
    piece = wrenches.find(later, X_BF[250:], model.tool, bias)[1].values
    known = np.isfinite(piece)
    np.testing.assert_allclose(piece[known], whole[known], atol=1e-9)


def test_what_is_compared_with_what(replayed: Recording, model: ArmModel) -> None:
    X_BF = kinematics.forward(model, replayed.robot["actual_q"])
    found = wrenches.find(replayed, X_BF, model.tool)
    truth, sensor = wrenches.reference(found), wrenches.reference(found[:2])
    assert truth is not None
    assert sensor is not None
    assert (truth.key, sensor.key) == ("truth_wrench", "sensor")
    assert wrenches.reference(found[:1]) is None


def test_estimates_are_found_by_name(replayed: Recording, model: ArmModel) -> None:
    robot = replayed.robot
    columns = {"est_observer_wrench": robot["truth_wrench"], "est_observer_torque": robot["target_moment"]}
    X_BF = kinematics.forward(model, robot["actual_q"])
    found = wrenches.find(replayed.with_table(robot.with_columns(columns)), X_BF, model.tool)
    assert [item.label for item in found if item.key.startswith("est")] == ["estimate by observer"]


def test_no_sensor_no_bias(replayed: Recording) -> None:
    alone = Recording({"robot": replayed.robot}, "made", "test")
    np.testing.assert_array_equal(force_sensor.sensor_bias(alone), np.zeros(6))


def test_a_real_push_has_the_controller_s_sign(lab_logs: Path, model: ArmModel) -> None:
    recording = read(lab_logs / "Movement_No9_Singularity_Free_ForceSensor")
    X_BF = kinematics.forward(model, recording.robot["actual_q"])
    controller, sensor = wrenches.find(recording, X_BF, model.tool)
    known = np.isfinite(sensor.values).all(axis=1)
    # Along z gravity's and friction's errors of the controller's estimate are smallest.
    assert np.corrcoef(controller.values[known, 2], sensor.values[known, 2])[0, 1] > 0.8


def _from(table: Table, row: int) -> Table:
    columns = {name: values[row:] for name, values in table.columns.items()}
    return Table(table.device, table.time[row:], columns, table.host_start)
