"""movec: the tool on a circle, the joints exactly with it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ur5_twin import spatial
from ur5_twin.arm.kinematics import acceleration, forward, twist
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.arc import Arc, arc
from ur5_twin.errors import TwinError

MODEL = load_model("controller")
#: Well within reach, away from singularities.
Q = np.array([1.266, -2.135, -1.947, -0.377, -2.542, -0.5])
X_FT = spatial.pose(spatial.rotation_from_vector([0.3, -0.2, 0.4]), [0.05, -0.02, 0.18])
X_START = forward(MODEL, Q) @ X_FT
TURN = np.array([0.2, -0.3, 0.25])


def circle(via: np.ndarray, end: np.ndarray, *, turns_with: bool = False) -> Arc:
    X_goal = spatial.pose(spatial.rotation_from_vector(TURN) @ X_START[:3, :3], X_START[:3, 3] + end)
    return arc(MODEL, Q, X_START[:3, 3] + via, X_goal, 0.002, X_FT, turns_with=turns_with)


def three(size: float) -> st.SearchStrategy[np.ndarray]:
    return st.lists(st.floats(-size, size), min_size=3, max_size=3).map(np.array)


@settings(max_examples=40, deadline=None)
@given(via=three(0.06), end=three(0.06))
def test_the_tool_keeps_to_the_circle_through_three_points(via: np.ndarray, end: np.ndarray) -> None:
    area = np.linalg.norm(np.cross(via, end))
    sides = [float(np.linalg.norm(side)) for side in (via, end, end - via)]
    assume(min(sides) > 5e-3 and area > 0.1 * max(sides) ** 2)
    way = circle(via, end)
    x = np.linspace(0.0, way.length, 400)
    X = way.poses(x)
    p = X[:, :3, 3] - X_START[:3, 3]
    # In the plane of the three points, at their circumradius, through the second and no farther than the third.
    radius = np.prod(sides) / (2.0 * area)
    assert np.abs(p @ np.cross(via, end) / area).max() < 1e-9
    assert np.linalg.norm(X[:, :3, 3] - way.center, axis=1) == pytest.approx(radius, abs=1e-9)
    gap = way.length / 399
    assert np.linalg.norm(p - via, axis=1).min() < gap
    np.testing.assert_allclose(p[-1], end, atol=1e-9)
    k, last = int(np.argmin(np.linalg.norm(p - via, axis=1))), len(p) - 1
    assert 0 < k < last
    assert np.linalg.norm(p[: k + 1] - end, axis=1).min() > 0.0
    angle = spatial.vector_from_rotation(X[:, :3, :3] @ X_START[:3, :3].T)
    np.testing.assert_allclose(angle, np.outer(x / way.length, TURN), atol=1e-9)


@pytest.mark.parametrize("turns_with", [False, True])
def test_joint_rows_are_one_function_of_time(turns_with: bool) -> None:
    # Half a circle of 50 mm, or a seventh of one of 100 mm, on which the tool turns as far: more is out of reach.
    via, end = ([0.08, 0.02, 0.0], [0.08, 0.0544, 0.0]) if turns_with else ([0.05, 0.05, 0.0], [0.0, 0.1, 0.0])
    way = circle(np.array(via), np.array(end), turns_with=turns_with)
    # Time runs with an acceleration: x = 0.1 t + 0.05 t^2.
    dt = 1e-4
    t = np.arange(0.0, 0.85, dt)
    x, rate, change = 0.1 * t + 0.05 * t**2, 0.1 + 0.1 * t, np.full_like(t, 0.1)
    assert x[-1] < way.length
    q, qd, qdd = way.rows(x, rate, change).swapaxes(0, 1)
    np.testing.assert_allclose(forward(MODEL, q) @ X_FT, way.poses(x), atol=1e-9)
    # Central differences are off by dt^2 / 6 times the third derivative (of order 10 rad/s^3).
    assert np.abs((q[2:] - q[:-2]) / (2 * dt) - qd[1:-1]).max() < 1e-6
    assert np.abs((qd[2:] - qd[:-2]) / (2 * dt) - qdd[1:-1]).max() < 1e-5
    # The tool's point, from the flange's motion by rigid-body kinematics: speed along, x'^2 / r towards the centre.
    V, A = twist(MODEL, q, qd), acceleration(MODEL, q, qd, qdd)
    lever = way.poses(x)[:, :3, 3] - forward(MODEL, q)[:, :3, 3]
    v = V[:, :3] + np.cross(V[:, 3:], lever)
    a = A[:, :3] + np.cross(A[:, 3:], lever) + np.cross(V[:, 3:], np.cross(V[:, 3:], lever))
    radius = np.linalg.norm(X_START[:3, 3] - way.center)
    speed = rate * radius * np.linalg.norm(way.sweep) / way.length
    np.testing.assert_allclose(np.linalg.norm(v, axis=1), speed, atol=1e-9)
    inward = (way.center - way.poses(x)[:, :3, 3]) / radius
    np.testing.assert_allclose(np.sum(a * inward, axis=1), speed**2 / radius, atol=1e-8)


def test_a_tool_that_turns_with_the_circle_keeps_to_its_tangent() -> None:
    way = circle(np.array([0.08, 0.02, 0.0]), np.array([0.08, 0.0544, 0.0]), turns_with=True)
    X = way.poses(np.linspace(0.0, way.length, 50))
    inward = np.einsum("nij,ni->nj", X[:, :3, :3], way.center - X[:, :3, 3])
    np.testing.assert_allclose(inward, np.tile(inward[0], (50, 1)), atol=1e-12)


@pytest.mark.parametrize(
    ("via", "end"),
    [
        ([0.05, 0.0, 0.0], [0.1, 0.0, 0.0]),
        ([0.1, 0.0, 0.0], [0.05, 1e-6, 0.0]),
        ([0.0, 0.0, 0.0], [0.1, 0.0, 0.0]),
        ([0.1, 0.0, 0.0], [0.0, 0.0, 0.0]),
        ([0.1, 0.0, 0.0], [0.1, 0.0, 0.0]),
    ],
)
def test_three_points_on_a_line_are_no_circle(via: list[float], end: list[float]) -> None:
    with pytest.raises(TwinError, match="on one line or one point; use movel"):
        circle(np.array(via), np.array(end))


def test_within_is_the_rest_of_the_way_inside_a_circle() -> None:
    way = circle(np.array([0.05, 0.05, 0.0]), np.array([0.0, 0.1, 0.0]))
    left = way.within(0.03)
    ends = way.poses(np.array([way.length - left, way.length]))[:, :3, 3]
    assert np.linalg.norm(ends[0] - ends[1]) == pytest.approx(0.03, abs=1e-12)
    # The circle is 100 mm wide: nothing of it is farther away.
    assert way.within(0.101) == np.inf
