"""Kinematics: against finite differences and against the pose the robot itself logged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ur5_twin import spatial
from ur5_twin.arm import _kinematics_kernels, kinematics
from ur5_twin.arm.kinematics import Orientation
from ur5_twin.arm.parameters import load_model
from ur5_twin.recording import read

ARM = load_model("c")
#: Central differences with step 1e-6 of functions of size 1: 1e-11 from the step, 1e-9 from rounding.
STEP = 1e-6
DIFFERENCES = 2e-8
ROUNDING = 1e-13


def states(seed: int, *shape: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    size = (*shape, 6)
    return rng.uniform(-np.pi, np.pi, size), rng.uniform(-2, 2, size), rng.uniform(-5, 5, size)


def derivative(function, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    return (function(q + STEP * qd) - function(q - STEP * qd)) / (2 * STEP)


def omega(q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    S = derivative(lambda x: kinematics.forward(ARM, x)[..., :3, :3], q, qd)
    S = S @ np.swapaxes(kinematics.forward(ARM, q)[..., :3, :3], -1, -2)
    return np.stack([S[..., 2, 1], S[..., 0, 2], S[..., 1, 0]], axis=-1)


def test_frames_are_the_product_of_the_dh_transforms() -> None:
    # Thesis equation 2.19 written out once more, as numpy products.
    q, _, _ = states(0, 10)
    frames = kinematics.link_frames(ARM, q)
    X = np.broadcast_to(np.eye(4), (10, 4, 4))
    for i in range(6):
        turn = spatial.rotation_from_vector(q[:, i, None] * np.array([0.0, 0.0, 1.0]))
        twist = spatial.rotation_from_vector(ARM.dh.alpha[i] * np.array([1.0, 0.0, 0.0]))
        X = X @ spatial.pose(turn, np.zeros(3)) @ spatial.pose(twist, [ARM.dh.a[i], 0.0, ARM.dh.d[i]])
        np.testing.assert_allclose(frames[:, i + 1], X, atol=ROUNDING)


def test_stretched_arm_reaches_the_sum_of_its_lengths() -> None:
    # At q = 0 the arm lies along -x: the d of joints 4 and 6 point to -y, d5 to -z.
    dh = ARM.dh
    expected = [dh.a[1] + dh.a[2], -dh.d[3] - dh.d[5], dh.d[0] - dh.d[4]]
    np.testing.assert_allclose(kinematics.forward(ARM, np.zeros(6))[:3, 3], expected, atol=ROUNDING)


def test_leading_axes_are_kept() -> None:
    q, qd, qdd = states(1, 2, 3)
    for result, tail in [
        (kinematics.link_frames(ARM, q), (7, 4, 4)),
        (kinematics.jacobian(ARM, q), (6, 6)),
        (kinematics.jacobian_dot(ARM, q, qd), (6, 6)),
        (kinematics.acceleration(ARM, q, qd, qdd), (6,)),
        (kinematics.analytical_acceleration(ARM, q, qd, qdd), (6,)),
        (kinematics.tcp_pose(ARM, q), (6,)),
    ]:
        assert result.shape == (2, 3, *tail)
    np.testing.assert_array_equal(kinematics.jacobian(ARM, q)[1, 2], kinematics.jacobian(ARM.dh, q[1, 2]))
    with pytest.raises(ValueError, match="6 joints"):
        kinematics.forward(ARM, np.zeros(5))


@pytest.mark.parametrize("link", [1, 2, 3, 4, 5, 6])
def test_jacobian_of_a_point_is_its_velocity(link: int) -> None:
    q, qd, _ = states(link, 20)
    point = np.array([0.1, -0.2, 0.05])
    J = kinematics.point_jacobian(ARM, q, link, point)

    def position(x: np.ndarray) -> np.ndarray:
        return spatial.transform_point(kinematics.link_frames(ARM, x)[..., link, :, :], point)

    np.testing.assert_allclose((J @ qd[..., None])[..., :3, 0], derivative(position, q, qd), atol=DIFFERENCES)
    assert not J[..., link:].any()
    expected = derivative(lambda x: kinematics.point_jacobian(ARM, x, link, point), q, qd)
    np.testing.assert_allclose(kinematics.jacobian_dot(ARM, q, qd, link, point), expected, atol=DIFFERENCES)


def test_there_is_no_link_seven() -> None:
    with pytest.raises(ValueError, match="1 to 6"):
        kinematics.point_jacobian(ARM, np.zeros(6), 7)


def test_twist_is_the_velocity_of_the_flange() -> None:
    q, qd, _ = states(7, 20)
    twist = kinematics.twist(ARM, q, qd)
    linear = derivative(lambda x: kinematics.forward(ARM, x)[..., :3, 3], q, qd)
    np.testing.assert_allclose(twist, np.concatenate([linear, omega(q, qd)], axis=-1), atol=DIFFERENCES)


def test_acceleration_is_the_derivative_of_the_twist() -> None:
    q, qd, qdd = states(8, 20)

    def at(t: float) -> np.ndarray:
        return kinematics.twist(ARM, q + qd * t + 0.5 * qdd * t**2, qd + qdd * t)

    expected = (at(STEP) - at(-STEP)) / (2 * STEP)
    np.testing.assert_allclose(kinematics.acceleration(ARM, q, qd, qdd), expected, atol=DIFFERENCES)


@pytest.mark.parametrize("orientation", ["zyz", "rotation_vector"])
def test_analytical_derivatives_are_those_of_the_coordinates(orientation: Orientation) -> None:
    q, qd, qdd = states(9, 200)
    X = kinematics.pose_coordinates(ARM, q, orientation)
    # Away from sin theta = 0 (thesis equation 3.1) and from the jumps at +-pi, which a difference cannot cross.
    sin_theta = np.sin(X[:, 4]) if orientation == "zyz" else np.ones(len(X))
    angles = X[:, [3, 5]] if orientation == "zyz" else np.linalg.norm(X[:, 3:], axis=-1, keepdims=True)
    good = (np.abs(sin_theta) > 0.2) & (np.abs(angles).max(axis=-1) < 3.0)
    assert good.sum() > 50
    q, qd, qdd = q[good], qd[good], qdd[good]

    def coordinates(x: np.ndarray) -> np.ndarray:
        return kinematics.pose_coordinates(ARM, x, orientation)

    def rates(t: float) -> np.ndarray:
        J = kinematics.analytical_jacobian(ARM, q + qd * t + 0.5 * qdd * t**2, orientation)
        return (J @ (qd + qdd * t)[..., None])[..., 0]

    # 1 / sin theta is at most 5 and enters the second derivative cubed.
    np.testing.assert_allclose(rates(0.0), derivative(coordinates, q, qd), atol=5 * DIFFERENCES)
    expected = (rates(STEP) - rates(-STEP)) / (2 * STEP)
    actual = kinematics.analytical_acceleration(ARM, q, qd, qdd, orientation)
    np.testing.assert_allclose(actual, expected, atol=125 * DIFFERENCES)


def test_euler_angles_have_no_rates_with_the_flange_pointing_up() -> None:
    up = np.array([0.3, -1.0, 1.0, -np.pi / 2, -np.pi / 2, 0.4])
    assert abs(kinematics.forward(ARM, up)[2, 2]) == pytest.approx(1.0, abs=ROUNDING)
    J = kinematics.analytical_jacobian(ARM, up)
    assert np.isfinite(J[:3]).all()
    assert np.isnan(J[3:]).all()
    assert np.isnan(kinematics.analytical_acceleration(ARM, up, np.ones(6), np.ones(6))[3:]).all()
    assert np.isfinite(kinematics.acceleration(ARM, up, np.ones(6), np.ones(6))).all()
    assert np.isfinite(kinematics.analytical_jacobian(ARM, up, "rotation_vector")).all()


def test_a_sensor_frame_moves_by_equation_2_41() -> None:
    q, qd, _ = states(11, 10)
    X_FS = spatial.pose(spatial.rotation_from_vector([0.0, 0.0, 0.4]), [0.01735, 0.00605, 0.0095])
    R_BF = kinematics.forward(ARM, q)[:, :3, :3]
    twist_F = spatial.rotate_wrench(np.swapaxes(R_BF, -1, -2), kinematics.twist(ARM, q, qd))
    twist_S = (spatial.velocity_transform(X_FS) @ twist_F[..., None])[..., 0]
    in_base = (kinematics.point_jacobian(ARM, q, 6, X_FS[:3, 3]) @ qd[..., None])[..., 0]
    np.testing.assert_allclose(spatial.rotate_wrench(R_BF @ X_FS[:3, :3], twist_S), in_base, atol=ROUNDING)


def test_pose_is_the_one_the_robot_logged(lab_logs: Path) -> None:
    for folder in sorted(lab_logs.glob("Movement_*")):
        robot = read(folder).robot
        X_BF = kinematics.forward(ARM, robot["actual_q"])
        logged = spatial.pose_from_vector(robot["actual_TCP_pose"])
        # Joint angles are printed to 1e-6 rad (0.5e-6 off, six of them, on a reach of 0.9 m) and so is the pose.
        assert np.abs(X_BF[:, :3, 3] - logged[:, :3, 3]).max() < 5e-6, folder.name
        error = np.swapaxes(logged[:, :3, :3], -1, -2) @ X_BF[:, :3, :3]
        assert spatial.rotation_angle(error).max() < 20e-6, folder.name


@given(st.lists(st.floats(-6.2, 6.2), min_size=6, max_size=6))
def test_the_logged_pose_is_position_and_rotation_vector(q: list[float]) -> None:
    """Against scipy's logarithm, also where the rotation is nearly pi and either sign is right."""
    X = kinematics.forward(ARM, q)
    pose = kinematics.tcp_pose(ARM, q)
    np.testing.assert_allclose(pose[:3], X[:3, 3], atol=1e-12)
    np.testing.assert_allclose(spatial.rotation_from_vector(pose[3:]), X[:3, :3], atol=1e-9)
    assert np.linalg.norm(pose[3:]) <= np.pi + 1e-12


@pytest.mark.parametrize("axis", [(1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0), (0.6, 0.0, 0.8), (-0.48, 0.6, 0.64)])
@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-5, 1.0, 3.0, np.pi - 1e-9, np.pi])
def test_rotation_vectors_of_all_sizes(axis: tuple[float, ...], angle: float) -> None:
    X = np.eye(4)
    X[:3, :3] = spatial.rotation_from_vector(angle * np.array(axis))
    found = np.empty(3)
    _kinematics_kernels.rotation_vector_into(X, found)
    np.testing.assert_allclose(spatial.rotation_from_vector(found), X[:3, :3], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found), angle, atol=3e-8)
