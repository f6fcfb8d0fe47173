"""The servo: known numbers recovered, and what the real logs agree on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ur5_twin.arm.parameters import load_model
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.errors import IdentificationError
from ur5_twin.identification.servo import external_torque, fit_servo, holds_last_position, spectral_radius
from ur5_twin.recording import read
from ur5_twin.recording.table import Recording, Table

CONSTANT = load_target_current_law().torque_constant
KP, KD, KI = 15e3, 500.0, 2e5


def pushed(held: float = 2e-5) -> Recording:
    """Every joint shoved about at standstill, its current from a PID on the way it moves."""
    t = np.arange(2500) * 0.008
    way = 3e-4 * np.sin(np.outer(t, np.linspace(1.5, 4.0, 6))) * (1.0 - np.exp(-t))[:, None]
    qd = np.gradient(way, 0.008, axis=0)
    error = way - held
    torque = -(KP * error + KD * qd + KI * np.cumsum(error, axis=0) * 0.008)
    zero = np.zeros((len(t), 6))
    q = way + np.array([0.2, -1.5, 1.4, -1.2, -1.0, 0.3])
    columns = {
        "actual_q": q,
        "actual_qd": qd,
        "actual_current": torque / CONSTANT,
        "target_current": zero,
        "target_qd": zero,
        "target_q": np.concatenate([q[:1], q[:-1]]),
    }
    return Recording({"robot": Table("robot", t, columns)}, "pushed", "made")


def test_recovers_the_servo_it_was_made_with() -> None:
    fit = fit_servo([pushed()], load_model("controller"), CONSTANT)
    # Without noise least squares is exact to rounding of differences of an integral.
    assert fit.good.all()
    for found, truth in zip(fit.means(), (KP, KD, KI), strict=True):
        assert np.allclose(found, truth, rtol=1e-6)
    assert np.allclose(fit.held, 2e-5, atol=1e-9)
    assert np.allclose(fit.kappas()[0], KP / fit.mass[0], rtol=1e-6)
    assert holds_last_position(pushed()) == 1.0


def test_refuses_a_moving_target() -> None:
    recording = pushed()
    moving = recording.with_table(recording.robot.with_columns({"target_qd": np.full((2500, 6), 0.1)}))
    with pytest.raises(IdentificationError, match="standstill"):
        fit_servo([moving], load_model("controller"), CONSTANT)


def test_real_servo(lab_logs: Path) -> None:
    logs = [read(lab_logs / f"Movement_No10_Standstill_ForceSensor_{name}") for name in ("Fx", "All")]
    assert [holds_last_position(log) for log in logs] == [1.0, 1.0]
    fit = fit_servo(logs, load_model("controller"), CONSTANT)
    assert fit.good[:, :2].all()
    assert not fit.good[:, 5].any()  # nobody pushed about joint 6's axis
    # Two logs, pushed differently, agree: integral gains to 5 %, the others to 15 %.
    assert np.allclose(fit.ki[0, :2], fit.ki[1, :2], rtol=0.05)
    assert np.allclose(fit.kp[0, :2], fit.kp[1, :2], rtol=0.15)
    assert np.allclose(fit.kd[0, :2], fit.kd[1, :2], rtol=0.15)


def test_the_sensor_reads_the_wrench_on_the_arm(lab_logs: Path) -> None:
    recording = read(lab_logs / "Movement_No10_Standstill_ForceSensor_Fx")
    arm = load_model("plant", "ati_gamma")
    assert arm.tool is not None
    contact = external_torque(recording, arm, arm.tool.sensors["ati_gamma"], 0.075)
    robot = recording.robot
    answer = robot["actual_current"] - robot["target_current"]
    # The servo pushes back: current against the push. Stuck joints and the integral keep it from -1.
    assert all(np.corrcoef(contact[:, j], answer[:, j])[0, 1] < -0.7 for j in (0, 1))
    # And a joint gives way in the direction of the push before the servo brings it back: the first 0.3 s of the first.
    first = np.flatnonzero(np.abs(contact[:, 0]) > 8.0)[0]
    assert (robot["actual_q"][first + 5, 0] - robot["actual_q"][0, 0]) * contact[first, 0] > 0.0


def test_stability_of_finite_steps() -> None:
    k0, k1, ki = np.array([5000.0, 5000.0, 5000.0]), np.array([150.0, 150.0, 1500.0]), np.array([7e4, 1.5e6, 7e4])
    radius = spectral_radius(k0, k1, ki, 0.002)
    # Routh: kappa1 kappa0 > kappa_i holds for the first alone; the third is too much for a step: 2 ms * 1500 > 2.
    assert radius[0] < 1.0 < radius[1]
    assert radius[2] > 1.0
    # A marginal double integrator keeps its energy under semi-implicit steps; one eigenvalue is the unused integral's.
    assert spectral_radius(k0[:1], np.zeros(1), np.zeros(1), 0.002)[0] == pytest.approx(1.0, abs=1e-12)
