"""``identify sensor``: devices that are mounted askew, biased and late are found so, and the file is one for the
twin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import tomli_w

from ur5_twin.arm.parameters import ArmModel, load_model
from ur5_twin.errors import IdentificationError
from ur5_twin.identification import force_torque, imu, results, sensor_result
from ur5_twin.identification.clocks import correlate
from ur5_twin.recording import read
from ur5_twin.recording.table import Recording
from ur5_twin.scenario import load_scenario
from ur5_twin.scenario.pushes import Push
from ur5_twin.sensing import load_sensors
from ur5_twin.sensing.specs import load_suite
from ur5_twin.twin.scenario_run import ScenarioRun

_TOOL = "ati_gamma+xsens_mti"
_FT = {"bias": [4.0, -3.0, 2.0, 0.1, 0.2, -0.3], "mount_rotation_rad": [0.0, 0.0, 0.5], "delay_ms": 40.0}
_IMU = {"mount_rotation_rad": [0.03, -0.05, 0.4], "mount_shift_mm": [8.0, -12.0, 5.0], "clock_drift_ppm": 3000.0}
_ACC = {"gain": [1.02, 0.99, 1.01], "bias": [0.1, -0.05, 0.2]}


def _arm(name: str) -> ArmModel:
    return load_model("plant", name)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    spec = msgspec.to_builtins(load_suite("lab"))
    spec.pop("provenance")
    spec["force_torque"] |= _FT
    spec["imu"] |= _IMU
    spec["imu"]["acceleration"] |= _ACC
    path = tmp_path_factory.mktemp("devices") / "sensors.toml"
    path.write_text(tomli_w.dumps({"drawn": spec}), encoding="utf-8")
    scenario = load_scenario("free_motion")
    push = Push(
        "tool", np.array([0, 0, 0.075]), False, "half_sine", 20.0, 2.0, 0.0, np.array([0, 30.0, -20.0, 0, 0, 0])
    )
    scenario = replace(
        scenario,
        arm=replace(scenario.arm, tool=_TOOL),
        sensors=replace(scenario.sensors, preset=str(path)),
        pushes=(push,),
    )
    return ScenarioRun(scenario, 2).finish()


@pytest.fixture(scope="module")
def found(recording: Recording) -> sensor_result.Found:
    return sensor_result.fit(recording, _arm, _TOOL, "lab")


def test_the_clock_is_found_between_rows() -> None:
    time = np.arange(0, 20, 0.008)
    other = np.arange(0, 20, 0.005)
    # A tenth of the rows' distance, by a parabola through three points 4 ms apart.
    assert correlate(time, np.sin(3 * (time + 0.0813)), other, np.sin(3 * other), 0.5).shift == pytest.approx(
        0.0813, abs=5e-4
    )


def test_the_imu_is_found_as_it_is_mounted(found: sensor_result.Found) -> None:
    assert found.imu is not None
    true = (
        (imu.ROTATION, _IMU["mount_rotation_rad"]),
        (imu.PLACE, found.p_FA + 1e-3 * np.array(_IMU["mount_shift_mm"])),
        (imu.ACC_GAIN, _ACC["gain"]),
        (imu.ACC_BIAS, _ACC["bias"]),
    )
    for at, values in true:
        # Four standard deviations: 12 numbers, each beyond in 1 of 16,000.
        assert (np.abs(found.imu.values[at] - values) < 4.0 * found.imu.std[at]).all(), imu.NAMES[at]
    assert abs(found.imu.values[imu.DRIFT] - 3e-3) < 4.0 * found.imu.std[imu.DRIFT]
    # Deviations that say something: below a millimetre, a milliradian and a millisecond.
    assert (found.imu.std[imu.PLACE] < 1e-3).all()
    assert (found.imu.std[imu.ROTATION] < 1e-3).all()
    assert found.imu.std[imu.SHIFT] < 1e-3
    assert (found.imu.after < 0.2 * found.imu.before).all()


def test_the_force_sensor_is_found_as_it_is_mounted(found: sensor_result.Found) -> None:
    assert found.ft is not None
    values, std = found.ft.values, found.ft.std
    assert (np.abs(values[force_torque.BIAS] - _FT["bias"]) < 4.0 * std[force_torque.BIAS]).all()
    assert (np.abs(values[force_torque.ROTATION] - _FT["mount_rotation_rad"]) < 4.0 * std[force_torque.ROTATION]).all()
    assert abs(values[force_torque.MASS] - 0.05) < 4.0 * std[force_torque.MASS]
    assert (std[force_torque.ROTATION] < 0.01).all()
    shift, shift_std, _, _ = sensor_result.ft_shift(found.ft)
    assert abs(shift + 0.040) < 4.0 * shift_std
    assert shift_std < 2e-3
    # The push is seen, and the motors' answer to it tells the clock as well, to some ticks.
    assert 0.8 < found.ft.free < 0.99
    assert found.ft.pushes is not None
    assert abs(found.ft.pushes.shift + 0.040) < 4.0 * found.ft.pushes.shift_std


def test_the_file_is_one_that_the_twin_takes(recording: Recording, found: sensor_result.Found, tmp_path: Path) -> None:
    results.write(sensor_result.result([found], [recording], "lab", "ur5-twin identify sensor LOG"), tmp_path)
    suite, lab = load_sensors(tmp_path / sensor_result.FILE), load_sensors("lab")
    assert found.imu is not None
    np.testing.assert_allclose(suite.imu_mount, found.imu.values[imu.ROTATION])
    np.testing.assert_allclose(suite.ft_mount[2], 0.5, atol=0.03)
    assert suite.ft.delay == pytest.approx(0.040, abs=0.005)
    assert suite.imu_clock.drift == pytest.approx(3e-3, rel=0.01)
    # What the logs do not tell is the preset's.
    assert suite.ft.noise is not None
    assert lab.ft.noise is not None
    np.testing.assert_array_equal(suite.ft.noise, lab.ft.noise)
    assert suite.current_pole == lab.current_pole


def test_bad_logs_are_named(recording: Recording) -> None:
    with pytest.raises(IdentificationError, match=r"free_motion: the tool 'ati_gamma' carries no xsens_mti"):
        sensor_result.fit(recording, _arm, "ati_gamma", "lab")
    robot_only = Recording({"robot": recording.robot}, "bare", "twin")
    with pytest.raises(IdentificationError, match="bare: neither force sensor nor IMU"):
        sensor_result.fit(robot_only, _arm, None, "lab")


def test_the_labs_imu_sits_where_the_thesis_says(lab_logs: Path) -> None:
    log = read(lab_logs / "Movement_No6_Acc_slow_Verify_Model", repair=True)
    fit = sensor_result.fit(log, _arm, None, "lab").imu
    assert fit is not None
    place = 1e3 * fit.values[imu.PLACE]
    # Equation 5.9 across the flange to some mm; along its axis it does not hold (docs/payload-and-sensors.md).
    np.testing.assert_allclose(place[:2], [17.35, 6.05], atol=5.0)
    assert place[2] > 20.0
    assert np.abs(fit.values[imu.ROTATION]).max() < 0.02
    # The IMU's stamps run 3.3 per mille fast: 0.27 s over this log.
    assert fit.values[imu.DRIFT] == pytest.approx(-3.3e-3, abs=2e-4)


def test_the_labs_force_sensor_is_as_late_as_pushes_say(lab_logs: Path) -> None:
    log = read(lab_logs / "Movement_No9_Singularity_Free_ForceSensor", repair=True)
    fit = sensor_result.fit(log, _arm, None, "lab").ft
    assert fit is not None
    assert fit.pushes is not None
    # docs/servo.md reads 75 to 80 ms off the currents; a servo's tick and a half is what the two may differ by.
    assert fit.pushes.shift == pytest.approx(-0.077, abs=0.012)
    # What it reads without contact is no weight turned about, so that its axes are not told by weight.
    assert np.isnan(fit.std[force_torque.ROTATION]).all()
