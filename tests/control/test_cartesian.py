"""movel: the flange straight, the joints exactly with it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ur5_twin import spatial
from ur5_twin.arm.kinematics import acceleration, forward, twist
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.cartesian import line, movel
from ur5_twin.errors import TwinError

MODEL = load_model("controller")
#: Well within reach, away from singularities.
Q = np.array([1.266, -2.135, -1.947, -0.377, -2.542, -0.5])
PERIOD = 0.008


def goal(*, shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
    X = forward(MODEL, Q)
    return spatial.pose(spatial.rotation_from_vector(turn) @ X[:3, :3], X[:3, 3] + shift)


def three(size: float) -> st.SearchStrategy[np.ndarray]:
    return st.lists(st.floats(-size, size), min_size=3, max_size=3).map(np.array)


@settings(max_examples=40, deadline=None)
@given(shift=three(0.08), turn=three(0.3))
def test_the_flange_goes_straight_and_turns_along_the_geodesic(shift: np.ndarray, turn: np.ndarray) -> None:
    X_goal = goal(shift=shift, turn=turn)
    rows = movel(MODEL, Q, X_goal, period=PERIOD)
    q, qd, qdd = rows.swapaxes(0, 1)
    X = forward(MODEL, q)
    length = max(np.linalg.norm(shift), np.linalg.norm(turn))
    if length < 1e-6:
        return
    p = X[:, :3, 3] - X[0, :3, 3]
    angle = spatial.vector_from_rotation(X[:, :3, :3] @ X[0, :3, :3].T)
    larger, way = (shift, p) if np.linalg.norm(shift) > np.linalg.norm(turn) else (turn, angle)
    s = way @ larger / (larger @ larger)
    # Closed-form inverse kinematics: rounding times the arm's metre and a few dozens of operations.
    assert np.abs(p - np.outer(s, shift)).max() < 1e-9
    assert np.abs(angle - np.outer(s, turn)).max() < 1e-9
    assert np.allclose(X[-1], X_goal, rtol=0, atol=1e-9)
    # The speed along the way is the trapezoid's, and V, V' are those of a straight way: parallel to it.
    slope = np.concatenate([shift, turn]) / length
    V = twist(MODEL, q, qd)
    rate = V @ slope / (slope @ slope)
    assert np.abs(V - np.outer(rate, slope)).max() < 1e-9
    assert rate.max() <= 0.25 * (1 + 1e-9)
    A = acceleration(MODEL, q, qd, qdd)
    change = A @ slope / (slope @ slope)
    assert np.abs(A - np.outer(change, slope)).max() < 1e-8
    # 1.2 m/s^2, exactly, while it speeds up or brakes; 0 in between and at rest.
    assert np.isclose(np.abs(change)[:, None], [0.0, 1.2], atol=1e-8).any(axis=1).all()
    assert not rows[-1, 1:].any()


def test_joint_rows_are_one_function_of_time() -> None:
    # A fine tick: central differences are off by dt^2 / 6 times the third derivative (of order 10 rad/s^3).
    dt = 1e-4
    q, qd, qdd = movel(
        MODEL, Q, goal(shift=np.array([0.1, -0.05, 0.08]), turn=np.array([0.1, 0.2, 0.0])), period=dt
    ).swapaxes(0, 1)
    smooth = (np.abs(np.diff(qdd[1:], axis=0)).max(axis=1) < 0.05) & (
        np.abs(np.diff(qdd[:-1], axis=0)).max(axis=1) < 0.05
    )
    assert smooth.mean() > 0.99
    assert np.abs((q[2:] - q[:-2]) / (2 * dt) - qd[1:-1])[smooth].max() < 1e-6
    assert np.abs((qd[2:] - qd[:-2]) / (2 * dt) - qdd[1:-1])[smooth].max() < 1e-5


def test_a_tool_goes_straight_while_its_flange_swings() -> None:
    X_FT = spatial.pose(spatial.rotation_from_vector([0.3, -0.2, 0.4]), [0.05, -0.02, 0.18])
    X_start = forward(MODEL, Q) @ X_FT
    shift, turn = np.array([0.04, 0.05, -0.06]), np.array([0.2, -0.3, 0.25])
    X_goal = spatial.pose(spatial.rotation_from_vector(turn) @ X_start[:3, :3], X_start[:3, 3] + shift)
    way = line(MODEL, Q, X_goal, 0.002, "movel", X_FT)
    assert way is not None
    # Time runs as the way does, with an acceleration: x = 0.1 t + 0.05 t^2.
    dt = 1e-4
    t = np.arange(0.0, 1.2, dt)
    x, rate = 0.1 * t + 0.05 * t**2, 0.1 + 0.1 * t
    q, qd, qdd = way.rows(x, rate, np.full_like(t, 0.1)).swapaxes(0, 1)
    X = forward(MODEL, q) @ X_FT
    assert np.abs(X[:, :3, 3] - X_start[:3, 3] - np.outer(x / way.length, shift)).max() < 1e-9
    angle = spatial.vector_from_rotation(X[:, :3, :3] @ X_start[:3, :3].T)
    assert np.abs(angle - np.outer(x / way.length, turn)).max() < 1e-9
    # The flange does not go straight, and rates are those of the positions: central differences, as below.
    flange = forward(MODEL, q)[:, :3, 3]
    along = (flange[-1] - flange[0]) / np.linalg.norm(flange[-1] - flange[0])
    assert np.linalg.norm(np.cross(flange - flange[0], along), axis=1).max() > 3e-4
    assert np.abs((q[2:] - q[:-2]) / (2 * dt) - qd[1:-1]).max() < 1e-6
    assert np.abs((qd[2:] - qd[:-2]) / (2 * dt) - qdd[1:-1]).max() < 1e-5
    np.testing.assert_allclose(forward(MODEL, way.goal) @ X_FT, X_goal, atol=1e-9)


def test_a_pure_rotation_takes_the_speed_in_rad() -> None:
    rows = movel(MODEL, Q, goal(shift=np.zeros(3), turn=np.array([0.0, 0.0, 0.5])), period=PERIOD)
    V = twist(MODEL, rows[:, 0], rows[:, 1])
    assert np.abs(V[:, :3]).max() < 1e-9
    assert np.isclose(V[:, 5].max(), 0.25, atol=1e-9)
    # 0.25^2 / 1.2 rad are lost to the ramps: 0.5 / 0.25 + 0.25 / 1.2 s, up to the next tick.
    assert len(rows) - 1 == np.ceil((0.5 / 0.25 + 0.25 / 1.2) / PERIOD)


def test_no_way_takes_no_time() -> None:
    rows = movel(MODEL, Q, forward(MODEL, Q), period=PERIOD)
    assert rows.shape == (1, 3, 6)
    assert not rows[:, 1:].any()


def test_whole_turns_of_a_joint_are_kept() -> None:
    turned = Q + np.array([0.0, 0.0, 0.0, 0.0, 2 * np.pi, 2 * np.pi])
    X = goal(shift=np.array([0.05, 0.0, 0.0]), turn=np.zeros(3))
    one, other = movel(MODEL, Q, X, period=PERIOD), movel(MODEL, turned, X, period=PERIOD)
    assert np.allclose(other - one, np.stack([turned - Q, np.zeros(6), np.zeros(6)]), rtol=0, atol=1e-9)


def test_out_of_reach_says_where() -> None:
    with pytest.raises(TwinError, match=r"movel at s = 0\.\d+ of the line: the flange pose is out of the arm's reach"):
        movel(MODEL, Q, goal(shift=np.array([0.0, 0.0, 2.0]), turn=np.zeros(3)), period=PERIOD)


def test_a_line_past_the_wrist_singularity_says_which_joint() -> None:
    # Joint 5 from -0.4 to 0.4 rad, and joint 1 beside it: the line between passes close to sin q5 = 0.
    start = np.array([0.3, -1.5, 1.5, -1.2, -0.4, 0.2])
    end = np.array([0.5, -1.45, 1.52, -1.3, 0.4, 0.2])
    place = r"movel at s = 0\.\d+ of the line, 0\.0\d+ rad from the wrist singularity"
    with pytest.raises(
        TwinError, match=place + r": wrist_1 would accelerate at -?\d+\.\d+ rad/s\^2, its limit is \+-25"
    ):
        movel(MODEL, start, forward(MODEL, end), period=PERIOD)
    with pytest.raises(TwinError, match=r"of the line: the line passes a singularity, .* from the wrist singularity"):
        movel(MODEL, start, forward(MODEL, end), speed=1.0, acceleration=1.0, period=PERIOD)
    # Slowly it can be done, and far from singularities a line can be too fast as well.
    movel(MODEL, start, forward(MODEL, end), speed=0.02, period=PERIOD)
    with pytest.raises(
        TwinError, match=r"movel at s = 0\.\d+ of the line, .*: \w+ would turn at .* its limit is \+-3\.2"
    ):
        movel(
            MODEL,
            Q,
            goal(shift=np.zeros(3), turn=np.array([0.0, 0.0, 1.0])),
            speed=4.0,
            acceleration=14.0,
            period=PERIOD,
        )


def test_a_line_from_a_singular_position_is_refused() -> None:
    # The arm upright: figure 4.1 (b).
    upright = np.array([0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0])
    X = forward(MODEL, upright)
    X[2, 3] -= 0.1
    with pytest.raises(TwinError, match=r"movel at s = 0\.\d+ of the line.*singular"):
        movel(MODEL, upright, X, period=PERIOD)


def test_a_line_beyond_a_joint_limit_names_the_joint() -> None:
    start = Q.copy()
    start[5] = 2 * np.pi - 0.1
    # The flange about its own axis is joint 6: 0.5 rad more than there is left.
    X = forward(MODEL, start) @ spatial.pose(spatial.rotation_from_vector([0.0, 0.0, 0.6]), np.zeros(3))
    with pytest.raises(TwinError, match=r"movel at s = 0\.1\d+ of the line: wrist_3 is 6\.\d+ rad, its limit"):
        movel(MODEL, start, X, period=PERIOD)


def test_numbers_must_be_positive() -> None:
    with pytest.raises(TwinError, match="movel: speed is -1"):
        movel(MODEL, Q, forward(MODEL, Q), speed=-1.0, period=PERIOD)
