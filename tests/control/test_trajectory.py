"""The planner's motions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ur5_twin.arm.parameters import load_model
from ur5_twin.control.trajectory import movej, rest, stop
from ur5_twin.errors import TwinError

joints = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(np.array)


@given(start=joints, goal=joints, speed=st.floats(0.05, 3.2), acceleration=st.floats(0.1, 25.0))
def test_a_movej_starts_and_ends_at_rest_within_its_limits(
    start: np.ndarray, goal: np.ndarray, speed: float, acceleration: float
) -> None:
    path = movej(start, goal, speed=speed, acceleration=acceleration, period=0.008)
    q, qd, qdd = path.swapaxes(0, 1)
    assert np.allclose(q[0], start)
    assert np.allclose(q[-1], goal, atol=1e-9)
    assert np.allclose(qd[-1], 0.0, atol=1e-9)
    assert np.abs(qd).max() <= speed * (1 + 1e-9)
    assert np.abs(qdd).max() <= acceleration * (1 + 1e-9)
    # The velocity is the position's slope: the midpoint rule is exact for each straight piece, off by a dt^2 / 8 where
    # two pieces meet within a tick.
    slope = np.diff(q, axis=0) - 0.5 * (qd[1:] + qd[:-1]) * 0.008
    assert np.abs(slope).max(initial=0.0) <= acceleration * 0.008**2 / 4 * (1 + 1e-9)


def test_a_movej_to_where_it_is_takes_no_time() -> None:
    assert movej(np.ones(6), np.ones(6), speed=1.0, acceleration=1.0, period=0.008).shape == (1, 3, 6)


@pytest.mark.parametrize("wrong", ["speed", "acceleration", "period"])
def test_limits_must_be_positive(wrong: str) -> None:
    arguments = {"speed": 1.0, "acceleration": 1.0, "period": 0.008, wrong: 0.0}
    with pytest.raises(TwinError, match=f"{wrong} is 0.0"):
        movej(np.zeros(6), np.ones(6), **arguments)


def test_rest() -> None:
    path = rest(np.arange(6.0), seconds=0.08, period=0.008)
    assert path.shape == (10, 3, 6)
    assert (path[:, 0] == np.arange(6.0)).all()
    assert not path[:, 1:].any()


def test_a_movej_refuses_what_the_arm_cannot_do() -> None:
    limits = load_model("controller").limits
    far = np.array([0.0, 0.0, 6.5, 0.0, 0.0, 0.0])
    with pytest.raises(TwinError, match=r"elbow is 6\.5 rad, its limit is \+-6\.28"):
        movej(np.zeros(6), far, period=0.008, limits=limits)
    there = np.array([0.0, 1.0, 0.2, 0.0, 0.0, 0.0])
    with pytest.raises(TwinError, match=r"speed of shoulder_lift is 3\.3 rad/s, its limit is 3\.2"):
        movej(np.zeros(6), there, speed=3.3, period=0.008, limits=limits)
    with pytest.raises(TwinError, match=r"acceleration of shoulder_lift is 26 rad/s\^2, its limit is 25"):
        movej(np.zeros(6), there, acceleration=26.0, period=0.008, limits=limits)
    movej(np.zeros(6), there, speed=3.2, acceleration=25.0, period=0.008, limits=limits)


@given(q=joints, qd=joints, deceleration=st.floats(0.5, 25.0))
def test_a_stop_brakes_all_joints_together_and_ends_at_rest(q: np.ndarray, qd: np.ndarray, deceleration: float) -> None:
    path = stop(q, qd, deceleration=deceleration, period=0.008)
    assert not path[-1, 1:].any()
    # v^2 / 2a of the fastest joint, in proportion for the others; whole ticks add at most one of T.
    fastest = np.abs(qd).max()
    shortest = np.abs(path[-1, 0] - q - 0.5 * qd * fastest / deceleration)
    assert (shortest <= 0.5 * np.abs(qd) * 0.008 + 1e-12).all()
    assert np.abs(path[:, 2]).max() <= deceleration * (1 + 1e-9)
    slope = np.diff(path[:, 0], axis=0) - 0.5 * (path[1:, 1] + path[:-1, 1]) * 0.008
    # Braking takes whole ticks and is constant: the trapezoidal rule is exact, and so is qdd; rounding of a few rad.
    assert np.abs(slope).max(initial=0.0) < 1e-12
    assert np.abs(np.diff(path[:, 1], axis=0) - 0.008 * path[:-1, 2]).max(initial=0.0) < 1e-12
    if len(path) > 1:
        assert np.allclose(path[0, :2], [q, qd], atol=1e-12)
