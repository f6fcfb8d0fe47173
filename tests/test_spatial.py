"""Rotations, poses and wrenches: exact identities and derivatives against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from ur5_twin import spatial

#: Chains of a few products of numbers of size 1 lose a few units of 2e-16.
ROUNDING = 1e-14
#: Central differences with step 1e-6: 1e-12 from the step, 1e-10 from rounding.
DIFFERENCES = 1e-8
STEP = 1e-6
#: The first call imports scipy; how long that takes is no property of the code under test.
untimed = settings(deadline=None)

components = st.floats(-3.0, 3.0, allow_subnormal=False)
vectors = arrays(float, 3, elements=components)


def random_rotations(seed: int, *shape: int) -> np.ndarray:
    return spatial.rotation_from_vector(np.random.default_rng(seed).uniform(-2, 2, (*shape, 3)))


def random_poses(seed: int, *shape: int) -> np.ndarray:
    return spatial.pose(random_rotations(seed, *shape), np.random.default_rng(seed + 1).normal(size=(*shape, 3)))


@untimed
@given(vectors, vectors)
def test_skew_is_the_cross_product(v: np.ndarray, w: np.ndarray) -> None:
    np.testing.assert_allclose(spatial.skew(v) @ w, np.cross(v, w), atol=ROUNDING)


@untimed
@given(vectors)
def test_rotation_vector_survives_the_round_trip(r: np.ndarray) -> None:
    R = spatial.rotation_from_vector(r)
    np.testing.assert_allclose(spatial.rotation_from_vector(spatial.vector_from_rotation(R)), R, atol=ROUNDING)


@pytest.mark.parametrize("below_pi", [0.0, 1e-12, 1e-9, 1e-6, 1e-3])
def test_rotation_vector_is_exact_near_pi(below_pi: float) -> None:
    # arccos of the trace (thesis equations 2.9, 2.10) is off by 1e-8 here and divides by zero at pi.
    axis = np.array([0.48, -0.6, 0.64])
    r = spatial.vector_from_rotation(spatial.rotation_from_vector(axis * (np.pi - below_pi)))
    assert np.linalg.norm(r) == pytest.approx(np.pi - below_pi, abs=ROUNDING)
    np.testing.assert_allclose(r * np.sign(r @ axis), axis * (np.pi - below_pi), atol=ROUNDING)


@untimed
@given(vectors)
def test_zyz_angles_survive_the_round_trip(phi: np.ndarray) -> None:
    R = spatial.rotation_from_zyz(phi)
    back = spatial.zyz_from_rotation(R)
    assert 0.0 <= back[1] <= np.pi
    # Up to the singular threshold the two outer angles are merged: an error of at most ZYZ_SINGULAR_SIN.
    np.testing.assert_allclose(spatial.rotation_from_zyz(back), R, atol=2 * spatial.ZYZ_SINGULAR_SIN)


@pytest.mark.parametrize("middle", [0.0, np.pi])
def test_zyz_angles_where_only_their_sum_exists(middle: float) -> None:
    R = spatial.rotation_from_zyz([0.7, middle, -0.2])
    back = spatial.zyz_from_rotation(R)
    assert back[0] == 0.0  # the thesis' convention
    np.testing.assert_allclose(spatial.rotation_from_zyz(back), R, atol=ROUNDING)


def omega(R_minus: np.ndarray, R: np.ndarray, R_plus: np.ndarray) -> np.ndarray:
    """Angular velocity from S(omega) = R' R^T (thesis equation 2.21) by central differences."""
    S = (R_plus - R_minus) / (2 * STEP) @ np.swapaxes(R, -1, -2)
    return np.stack([S[..., 2, 1], S[..., 0, 2], S[..., 1, 0]], axis=-1)


@pytest.mark.parametrize(
    ("to_rotation", "rates"),
    [
        (spatial.rotation_from_zyz, spatial.zyz_rates),
        (spatial.rotation_from_vector, spatial.vector_rates),
    ],
)
def test_rates_give_the_angular_velocity(to_rotation, rates) -> None:
    rng = np.random.default_rng(3)
    x, x_dot = rng.uniform(0.3, 2.0, (50, 3)) * rng.choice([-1.0, 1.0], (50, 3)), rng.normal(size=(50, 3))
    expected = omega(to_rotation(x - STEP * x_dot), to_rotation(x), to_rotation(x + STEP * x_dot))
    np.testing.assert_allclose((rates(x) @ x_dot[..., None])[..., 0], expected, atol=DIFFERENCES)


def test_the_thesis_equation_2_33_has_its_angles_exchanged() -> None:
    # The printed B(phi) is that of Rz(psi) Ry(theta) Rz(phi), not of equation 2.2's Rz(phi) Ry(theta) Rz(psi).
    phi, rate = np.array([0.5, 0.8, -1.1]), np.array([0.3, -0.7, 1.2])
    measured = omega(
        spatial.rotation_from_zyz(phi - STEP * rate),
        spatial.rotation_from_zyz(phi),
        spatial.rotation_from_zyz(phi + STEP * rate),
    )
    (_, s_theta, s_psi), (_, c_theta, c_psi) = np.sin(phi), np.cos(phi)
    printed = np.array([[c_psi * s_theta, -s_psi, 0], [s_psi * s_theta, c_psi, 0], [c_theta, 0, 1]])
    assert np.abs(printed @ rate - measured).max() > 0.5
    np.testing.assert_allclose(spatial.zyz_rates(phi) @ rate, measured, atol=DIFFERENCES)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-3, 0.049, 0.051, 1.0, 3.0, 3.14])
def test_vector_rates_are_smooth_from_zero_to_pi(size: float) -> None:
    r, r_dot = size * np.array([0.48, -0.6, 0.64]), np.array([0.2, 0.9, -0.4])
    B = spatial.vector_rates(r)
    # From 0.05 rad up the closed forms cancel at most four digits in t - sin t and twice that in its derivative.
    np.testing.assert_allclose(spatial.vector_rates_inverse(r) @ B, np.eye(3), atol=1e-12)
    difference = spatial.vector_rates(r + STEP * r_dot) - spatial.vector_rates(r - STEP * r_dot)
    np.testing.assert_allclose(spatial.vector_rates_derivative(r, r_dot), difference / (2 * STEP), atol=DIFFERENCES)


def test_zyz_rates_invert_and_differentiate() -> None:
    rng = np.random.default_rng(4)
    phi, phi_dot = rng.uniform(0.3, 2.8, (50, 3)), rng.normal(size=(50, 3))
    # The inverse is at most 1 / sin 0.3 large.
    identity = spatial.zyz_rates_inverse(phi) @ spatial.zyz_rates(phi)
    np.testing.assert_allclose(identity, np.broadcast_to(np.eye(3), (50, 3, 3)), atol=10 * ROUNDING)
    difference = spatial.zyz_rates(phi + STEP * phi_dot) - spatial.zyz_rates(phi - STEP * phi_dot)
    np.testing.assert_allclose(spatial.zyz_rates_derivative(phi, phi_dot), difference / (2 * STEP), atol=DIFFERENCES)


def test_zyz_rates_have_no_inverse_at_the_representational_singularity() -> None:
    inverse = spatial.zyz_rates_inverse([[0.3, 0.0, 0.1], [0.3, np.pi, 0.1], [0.3, 1.0, 0.1]])
    assert np.isnan(inverse[:2]).all()
    assert np.isfinite(inverse[2]).all()


def test_poses_compose_and_invert() -> None:
    X_AB, X_BC, p_C = random_poses(1, 4), random_poses(5, 4), np.random.default_rng(0).normal(size=(4, 3))
    np.testing.assert_allclose(
        spatial.transform_point(spatial.compose(X_AB, X_BC), p_C),
        spatial.transform_point(X_AB, spatial.transform_point(X_BC, p_C)),
        atol=ROUNDING,
    )
    identity = np.broadcast_to(np.eye(4), (4, 4, 4))
    np.testing.assert_allclose(spatial.compose(X_AB, spatial.inverse(X_AB)), identity, atol=ROUNDING)
    np.testing.assert_allclose(spatial.pose_from_vector(spatial.vector_from_pose(X_AB)), X_AB, atol=ROUNDING)


def test_power_does_not_depend_on_the_point_or_the_frame() -> None:
    rng = np.random.default_rng(6)
    X_ij, twist_i, wrench_i = random_poses(7, 20), rng.normal(size=(20, 6)), rng.normal(size=(20, 6))
    R_ij, p_ij = X_ij[:, :3, :3], X_ij[:, :3, 3]
    power = np.sum(twist_i * wrench_i, axis=-1)
    moved = spatial.shift_twist(twist_i, p_ij), spatial.shift_wrench(wrench_i, p_ij)
    np.testing.assert_allclose(np.sum(moved[0] * moved[1], axis=-1), power, atol=10 * ROUNDING)
    # Equation 2.41 is the shift followed by the turn into frame j; wrenches go back with its transpose.
    V = spatial.velocity_transform(X_ij)
    twist_j = (V @ twist_i[..., None])[..., 0]
    R_ji = np.swapaxes(R_ij, -1, -2)
    np.testing.assert_allclose(twist_j, spatial.rotate_wrench(R_ji, moved[0]), atol=10 * ROUNDING)
    wrench_j = spatial.rotate_wrench(R_ji, moved[1])
    back = (np.swapaxes(V, -1, -2) @ wrench_j[..., None])[..., 0]
    np.testing.assert_allclose(back, wrench_i, atol=10 * ROUNDING)


@settings(deadline=None)  # kernels compile
@given(st.integers(0, 2**32 - 1), st.sampled_from([((5, 3), (5, 3)), ((1, 3), (4, 3)), ((3,), (4, 3)), ((4, 3), (3,))]))
def test_cross_is_numpys_to_the_bit(seed: int, shapes: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    rng = np.random.default_rng(seed)
    a, b = (rng.standard_normal(shape) for shape in shapes)
    np.testing.assert_array_equal(spatial.cross(a, b), np.cross(a, b))


@settings(deadline=None)  # kernels compile
@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, 1e-3, 1e-9, 0.0]))
def test_exact_rotations_give_scipys_vectors_to_the_bit(seed: int, size: float) -> None:
    """At rest, at tiny angles, anywhere, and at half turns, where the sign is a matter of taste."""
    rng = np.random.default_rng(seed)
    vectors = rng.uniform(-2.0, 2.0, (50, 3)) * size
    half_turns = [np.diag(signs) for signs in ((1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, 1.0))]
    R = np.concatenate([Rotation.from_rotvec(vectors).as_matrix(), half_turns])
    expected = Rotation.from_matrix(R, assume_valid=True).as_rotvec()
    np.testing.assert_array_equal(spatial.vector_from_rotation(R, exact=True), expected)
