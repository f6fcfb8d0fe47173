"""Closed-form inverse kinematics: every solution reaches the pose and the position it came from is among them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ur5_twin import spatial
from ur5_twin.arm import inverse_kinematics, kinematics, singularities
from ur5_twin.arm.inverse_kinematics import BRANCHES, solve
from ur5_twin.arm.parameters import load_model
from ur5_twin.errors import ModelError

ARM = load_model("c")
LIMIT = 2 * np.pi
#: The first call compiles or imports; how long that takes is no property of the code under test.
untimed = settings(deadline=None)
positions = arrays(float, 6, elements=st.floats(-LIMIT, LIMIT, allow_subnormal=False))


def turned(q: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Largest joint difference, whole turns aside."""
    return np.abs(np.angle(np.exp(1j * (q - other)))).max(axis=-1)


@untimed
@given(positions)
def test_every_solution_reaches_the_pose(q: np.ndarray) -> None:
    X_BF = kinematics.forward(ARM, q)
    solutions = solve(ARM, X_BF)
    assert solutions.valid.any()
    reached = kinematics.forward(ARM, solutions.q[solutions.valid])
    # A wrist taken as singular is up to 1e-9 rad off, an arm taken as stretched 1e-10 m.
    np.testing.assert_allclose(reached, np.broadcast_to(X_BF, reached.shape), atol=3e-9)


@untimed
@given(positions)
def test_the_position_itself_is_among_the_solutions(q: np.ndarray) -> None:
    away = singularities.distances(ARM, q)
    clear = min(abs(away.shoulder), abs(away.elbow), abs(away.wrist))
    solutions = solve(ARM, kinematics.forward(ARM, q))
    if clear < 1e-3:
        return  # a double root: the angle is only as good as the root of rounding
    # The closed form's square root amplifies rounding by 1 / distance, 1e3 here, for each of two steps.
    assert np.nanmin(turned(solutions.q, q)) < 1e-9
    best = BRANCHES[int(np.nanargmin(turned(solutions.q, q)))]
    assert best == (
        "left" if away.shoulder > 0 else "right",
        "positive" if away.wrist > 0 else "negative",
        "positive" if away.elbow > 0 else "negative",
    )


def test_eight_solutions_are_eight_different_positions() -> None:
    solutions = solve(ARM, kinematics.forward(ARM, [0.4, -1.2, 1.5, -0.6, 0.9, 0.2]))
    assert solutions.valid.all()
    for i in range(8):
        for j in range(i):
            assert turned(solutions.q[i], solutions.q[j]) > 0.1


@pytest.mark.parametrize("p_BF", [[1.5, 0.0, 0.3], [0.0, 0.0, 0.5], [0.05, 0.02, 0.4]])
def test_out_of_reach_is_no_solution_and_no_error(p_BF: list[float]) -> None:
    # Beyond the stretched arm, on joint 1's axis, and inside the cylinder of radius d4 around it.
    solutions = solve(ARM, spatial.pose(np.eye(3), p_BF) @ spatial.pose(np.eye(3), [0.0, 0.0, ARM.dh.d[5]]))
    assert not solutions.valid.any()
    assert np.isnan(solutions.q).all()
    assert np.isnan(inverse_kinematics.nearest(ARM, spatial.pose(np.eye(3), [2.0, 0.0, 0.0]), np.zeros(6))).all()


@pytest.mark.parametrize("q5", [0.0, np.pi])
def test_free_joint_takes_the_hint_at_a_wrist_singularity(q5: float) -> None:
    q = np.array([0.2, -1.0, 1.0, -1.0, q5, 0.7])
    X_BF = kinematics.forward(ARM, q)
    solutions = solve(ARM, X_BF, q6_hint=0.7)
    # The hint only matters in the branch that is singular; the other shoulder still has both its wrists.
    assert np.nanmin(turned(solutions.q, q)) < 1e-9
    assert solutions.valid.sum() == 6
    # Another hint is taken as it is where links 2 and 3 reach, else they are stretched or folded towards it.
    taken = 0
    for hint in (0.6, -1.0, 1.5, 3.0):
        other = solve(ARM, X_BF, q6_hint=hint)
        reached = kinematics.forward(ARM, other.q[other.valid])
        np.testing.assert_allclose(reached, np.broadcast_to(X_BF, reached.shape), atol=1e-9)
        singular = other.q[other.valid & (np.abs(np.sin(other.q[:, 4])) < 1e-9)]
        assert len(singular) == 2
        as_hinted = np.isclose(singular[:, 5], hint, rtol=0.0, atol=1e-12)
        assert (as_hinted | (np.abs(np.sin(singular[:, 2])) < 1e-6)).all()
        taken += as_hinted.all()
    assert 0 < taken < 4


def test_many_poses_at_once_equal_one_by_one() -> None:
    q = np.random.default_rng(2).uniform(-np.pi, np.pi, (2, 5, 6))
    X_BF = kinematics.forward(ARM, q)
    together = solve(ARM.dh, X_BF, q6_hint=q[..., 5])
    assert together.q.shape == (2, 5, 8, 6)
    assert together.valid.shape == (2, 5, 8)
    np.testing.assert_array_equal(together.q[1, 3], solve(ARM, X_BF[1, 3], q6_hint=q[1, 3, 5]).q)


@untimed
@given(positions)
def test_nearest_keeps_the_turn_it_is_on(q: np.ndarray) -> None:
    away = singularities.distances(ARM, q)
    if min(abs(away.shoulder), abs(away.elbow), abs(away.wrist)) < 1e-2:
        return  # two branches meet here and either is near
    near = inverse_kinematics.nearest(ARM, kinematics.forward(ARM, q), q)
    assert np.abs(near).max() <= LIMIT
    if (np.abs(q) < LIMIT - 1e-6).all():
        assert np.abs(near - q).max() < 1e-9
    else:
        # At the limit itself rounding may leave only the turn before, and then another branch may be nearer.
        reached = kinematics.forward(ARM, near)
        np.testing.assert_allclose(reached, kinematics.forward(ARM, q), atol=1e-9)


def test_nearest_does_not_pass_a_limit() -> None:
    q = np.array([6.2, -1.0, 1.0, -1.0, 1.0, 0.0])
    beyond = kinematics.forward(ARM, q + 0.2 * np.eye(6)[0])  # 6.4 rad, past 2 pi
    near = inverse_kinematics.nearest(ARM, beyond, q)
    assert np.abs(near).max() <= LIMIT
    np.testing.assert_allclose(kinematics.forward(ARM, near), beyond, atol=1e-9)


def test_another_kind_of_arm_is_refused() -> None:
    with pytest.raises(ModelError, match="UR's DH parameters"):
        solve(replace(ARM.dh, alpha=np.zeros(6)), np.eye(4))
