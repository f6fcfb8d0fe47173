"""Singularities: the closed form against the numerical determinant, and each family where it should be."""

from __future__ import annotations

import numpy as np
import pytest

from ur5_twin.arm import kinematics, singularities
from ur5_twin.arm.parameters import load_model

ARM = load_model("c")
RANDOM = np.random.default_rng(0).uniform(-np.pi, np.pi, (1000, 6))


def test_determinant_is_the_numerical_one() -> None:
    # Six products of numbers below 1 m: rounding of 1e-16 times a few.
    numerical = np.linalg.det(kinematics.jacobian(ARM, RANDOM))
    np.testing.assert_allclose(singularities.determinant(ARM, RANDOM), numerical, atol=1e-15)
    np.testing.assert_allclose(singularities.manipulability(ARM, RANDOM), np.abs(numerical), atol=1e-15)


def test_shoulder_distance_is_where_the_wrist_centre_is() -> None:
    p = kinematics.link_frames(ARM, RANDOM)[:, 5, :3, 3]
    ahead = np.cos(RANDOM[:, 0]) * p[:, 0] + np.sin(RANDOM[:, 0]) * p[:, 1]
    np.testing.assert_allclose(singularities.shoulder_distance(ARM, RANDOM), ahead, atol=1e-14)


def test_angles_lead_to_the_singularity() -> None:
    # Turning joint 3 (or 5) by minus its distance, up to the side it folds to, makes the determinant vanish.
    away = singularities.distances(ARM, RANDOM)
    for joint, distance in ((2, away.elbow), (4, away.wrist)):
        at = RANDOM.copy()
        at[:, joint] -= np.where(np.cos(at[:, joint]) > 0, distance, -distance)
        assert np.abs(singularities.determinant(ARM, at)).max() < 1e-16  # a sine of 2e-16 at pi
        assert np.abs(distance).max() <= np.pi / 2


@pytest.mark.parametrize(
    "q",
    [
        [0.3, -1.0, 0.0, 0.5, 1.0, 0.2],  # elbow stretched
        [0.3, -1.0, 1.2, 0.5, 0.0, 0.2],  # wrist aligned
        [0.3, -np.pi / 2, 0.0, 0.0, 1.0, 0.2],  # upright: shoulder and elbow at once
    ],
)
def test_the_smallest_singular_value_vanishes(q: list[float]) -> None:
    assert singularities.smallest_singular_value(ARM, q) < 1e-15
    assert abs(singularities.determinant(ARM, q)) < 1e-17


def test_singular_values_multiply_to_the_determinant() -> None:
    # The smallest is at most the geometric mean and bounds how much torque noise a wrench estimate shows.
    smallest = singularities.smallest_singular_value(ARM, RANDOM)
    assert (smallest**6 <= singularities.manipulability(ARM, RANDOM) * (1 + 1e-9)).all()
    # A characteristic length rescales three rows: det / length^3.
    scaled = kinematics.jacobian(ARM, RANDOM[0])
    scaled[:3] /= 0.5
    expected = np.linalg.svd(scaled, compute_uv=False)[-1]
    assert singularities.smallest_singular_value(ARM, RANDOM[0], length=0.5) == pytest.approx(expected, rel=1e-12)
