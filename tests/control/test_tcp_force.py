"""The controller's own wrench estimate: the real one to its digits, and what its law implies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ur5_twin.arm.kinematics import jacobian
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.control.tcp_force import TcpForce, external_torque, load_tcp_force_law, truncated_wrench, viscous_ratio
from ur5_twin.recording import read

INPUTS = ("actual_q", "actual_qd", "actual_current", "target_qd", "target_moment", "target_current")
HOME = np.array([0.2, -1.5, 1.4, -1.2, -1.0, 0.3])


def rows(recording) -> list[np.ndarray]:
    return [recording.robot[name] for name in INPUTS]


@pytest.mark.parametrize(
    "log",
    ["No4_Acc", "No5_Acc_slow_w_disturbance", "No9_Singularity_Free_ForceSensor", "No10_Standstill_ForceSensor_All"],
)
def test_real_estimate_to_its_digits(lab_logs: Path, log: str) -> None:
    recording = read(lab_logs / f"Movement_{log}")
    measured = recording.robot["actual_TCP_force"]
    # The controller's average before the first row is unknown: it starts at zero, and 300 rows leave 2e-9 of it.
    error = (TcpForce(load_model("controller"))(*rows(recording)) - measured)[300:]
    # Four decimals of the torque constants and six of the log, through 1 / 0.14 of the smallest singular value.
    assert np.abs(error).mean() < 1e-3
    assert np.abs(error).max() < 2e-2


def test_pieces_make_the_whole(lab_logs: Path) -> None:
    recording = read(lab_logs / "Movement_No9_Singularity_Free_WDist")
    inputs = [x[:900] for x in rows(recording)]
    whole = TcpForce(load_model("controller"))(*inputs)
    pieces = TcpForce(load_model("controller"))
    parts = [pieces(*(x[a:b] for x in inputs)) for a, b in ((0, 1), (1, 40), (40, 40), (40, 600), (600, 900))]
    assert np.array_equal(np.concatenate(parts), whole)


def test_a_held_push_is_what_the_arm_exerts() -> None:
    # The motors drive J' F beyond a target that needs none; current is what driving joints take for it.
    arm, law = load_model("controller"), load_target_current_law()
    push = np.array([20.0, -10.0, 5.0, 0.5, 0.2, -0.3])
    torque = jacobian(arm, HOME).T @ push
    current = torque * (1.0 / law.torque_constant + law.load)
    zero = np.zeros((400, 6))
    estimate = TcpForce(arm)(zero + HOME, zero, zero + current, zero, zero, zero)
    # 400 ticks leave (29/31)^400 = 3e-12 of the start.
    assert np.allclose(estimate[-1], push, atol=1e-9)


def test_it_forgets_in_the_same_time_at_any_tick() -> None:
    arm, law = load_model("controller"), load_target_current_law()
    torque = jacobian(arm, HOME).T @ np.array([20.0, -10.0, 5.0, 0.5, 0.2, -0.3])
    current = torque * (1.0 / law.torque_constant + law.load)

    def after(seconds: float, period: float) -> np.ndarray:
        zero = np.zeros((round(seconds / period), 6))
        return TcpForce(arm, period=period)(zero + HOME, zero, zero + current, zero, zero, zero)[-1]

    np.testing.assert_allclose(after(0.16, 0.002), after(0.16, 0.008), rtol=1e-9)


def test_friction_hides_what_it_may() -> None:
    law = load_target_current_law()
    moment = np.full((1, 6), 10.0)
    exact = moment / law.torque_constant
    hidden = external_torque(law, exact + 0.9 * law.load * moment, np.zeros((1, 6)), moment)
    # Within load |tau| of the current that the torque needs, joints 1 to 3 show nothing; the small joints have none.
    assert not hidden[0, :3].any()
    beyond = external_torque(law, exact + 2.0 * law.load * moment, np.zeros((1, 6)), moment)
    assert (beyond[0, :3] > 0.0).all()


def test_no_wrench_along_a_lost_direction() -> None:
    straight = HOME.copy()
    straight[4] = 0.0  # wrist singularity
    smallest = load_tcp_force_law().smallest
    J = jacobian(load_model("controller"), np.stack([HOME, straight]))
    torque = np.ones((2, 6))
    wrench = truncated_wrench(J, torque, smallest)
    assert np.linalg.svd(J[0])[1][-1] > smallest > np.linalg.svd(J[1])[1][-1]
    # A regular posture returns the torque to rounding; a singular one returns a finite wrench of the rest.
    assert np.allclose(J[0].T @ wrench[0], torque[0], atol=1e-12)
    U, s, _ = np.linalg.svd(J[1])
    assert np.allclose(U[:, s < smallest].T @ wrench[1], 0.0, atol=1e-12)


def test_viscous_ratio_is_found_where_the_target_moves() -> None:
    law = load_target_current_law()
    qd = np.array([[0.3, -0.3, 0.5, 0.4, -0.2, 0.0]])
    moment = np.array([[5.0, 40.0, -9.0, 1.0, 0.0, 1.0]])
    rigid = moment / law.torque_constant + law.load * np.abs(moment) * np.sign(qd)
    warm = law.current(moment, qd)
    ratio = viscous_ratio(law, qd, moment, rigid + 1.1 * (warm - rigid))
    assert np.allclose(ratio[0, :4], 1.1, atol=1e-9)
    # No load tells no branch, and no speed no friction.
    assert np.isnan(ratio[0, 4:]).all()
