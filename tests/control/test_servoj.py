"""The servoj stream's filter."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from ur5_twin.arm.parameters import load_model
from ur5_twin.control.commands import ServoJ
from ur5_twin.control.servoj import servoj
from ur5_twin.errors import TwinError

MODEL = load_model("controller")
Q = np.array([1.266, -2.135, -1.947, -0.377, -2.542, -0.5])
PERIOD = 0.008


def sine(rate: float, seconds: float) -> ServoJ:
    t = np.arange(int(seconds * rate)) / rate
    return ServoJ(tuple(t), tuple(Q + 0.1 * np.sin(2.0 * t)[:, None] * np.array([1, 0.5, 0.2, 1, -1, 2])))


def test_it_is_the_filter_that_the_law_says() -> None:
    # Set points on every second tick, integrated by another method (its tolerance is 1e-10).
    stream = ServoJ((0.0, 0.016, 0.032), tuple(Q + k * 0.004 for k in (1, 2, 3)), lookahead_time=0.06, gain=500.0)
    rows = servoj(MODEL, Q, stream, period=PERIOD)

    def law(t: float, x: np.ndarray) -> np.ndarray:
        u = 0.004 * (1 + min(int((t + 1e-12) / 0.016), 2))
        return np.array([x[1], 500.0 * (u - x[0] - 0.06 * x[1])])

    x, reached = np.zeros(2), [np.zeros(2)]
    for k in range(20):
        # Tick by tick, so that no step crosses a jump; the jump at the end of a tick belongs to the next one.
        span = (k * PERIOD, (k + 1) * PERIOD - 1e-11)
        x = solve_ivp(law, span, x, rtol=1e-11, atol=1e-12).y[:, -1]
        reached.append(x)
    assert np.allclose(rows[:21, 0, 0] - Q[0], np.array(reached)[:, 0], rtol=0, atol=1e-9)
    assert np.allclose(rows[:21, 1, 3], np.array(reached)[:, 1], rtol=0, atol=1e-9)


@pytest.mark.parametrize("rate", [50.0, 125.0, 500.0])
def test_position_and_speed_are_continuous_and_it_ends_at_rest(rate: float) -> None:
    stream = sine(rate, 2.0)
    rows = servoj(MODEL, Q, stream, period=PERIOD)
    q, qd, qdd = rows.swapaxes(0, 1)
    assert np.allclose(q[0], Q)
    assert not qd[0].any()
    assert not rows[-1, 1:].any()
    # What the settled filter leaves, and the braking from at most 1e-5 rad/s.
    assert np.abs(q[-1] - stream.points[-1]).max() < 2e-6
    # qdd changes within a tick at the rate of the filter: the rectangle over qd is off by dt^2 / 2 times its slope,
    # gain (|qd| + lookahead |qdd|).
    slope = 300.0 * (np.abs(qd).max() + 0.1 * np.abs(qdd).max())
    assert np.abs(np.diff(qd, axis=0) - PERIOD * qdd[:-1]).max() < slope * PERIOD**2 / 2
    assert np.abs(np.diff(q, axis=0) - PERIOD * qd[:-1]).max() < np.abs(qdd).max() * PERIOD**2 / 2 * 1.5


def test_a_ramp_is_followed_lookahead_time_late() -> None:
    t = np.arange(500) * PERIOD
    ramp = ServoJ(tuple(t), tuple(Q + 0.2 * t[:, None] * np.eye(6)[0]), lookahead_time=0.15)
    rows = servoj(MODEL, Q, ramp, period=PERIOD)
    # After some time constants: 0.15 s behind, less half a tick by which a held set point is late; 17 rad/s settles
    # 1e-9 within two seconds.
    late = (Q[0] + 0.2 * t[499] - rows[499, 0, 0]) / 0.2
    assert np.isclose(late, 0.15, atol=PERIOD)
    assert np.allclose(np.diff(rows[400:499, 0, 0]), 0.2 * PERIOD, rtol=1e-6)


def test_before_the_first_set_point_the_arm_rests() -> None:
    rows = servoj(MODEL, Q, ServoJ((0.08,), (tuple(Q + 0.01),)), period=PERIOD)
    assert (rows[:10, 0] == Q).all()
    assert not rows[:10, 1:].any()
    assert rows[10, 2].any()


@settings(max_examples=30, deadline=None)
@given(
    points=st.lists(st.lists(st.floats(-0.3, 0.3), min_size=6, max_size=6), min_size=1, max_size=6),
    gain=st.floats(100.0, 2000.0),
    lookahead=st.floats(0.03, 0.2),
)
def test_what_it_returns_keeps_the_limits_and_what_it_refuses_names_the_point(
    points: list[list[float]], gain: float, lookahead: float
) -> None:
    times = tuple(0.1 * k for k in range(len(points)))
    stream = ServoJ(times, tuple(tuple(Q + point) for point in points), lookahead, gain)
    try:
        rows = servoj(MODEL, Q, stream, period=PERIOD)
    except TwinError as error:
        if "set point" not in str(error):
            raise
        return
    assert (np.abs(rows) <= np.stack([MODEL.limits.q, MODEL.limits.qd, MODEL.limits.qdd]) * (1 + 1e-9)).all()


def test_a_point_that_demands_too_much_is_named() -> None:
    points = [Q, Q + 0.01, Q + 0.5, Q + 0.5]
    with pytest.raises(TwinError, match=r"at 0\.016 s set point 2 \(of 0\.016 s\) asks too much: \w+ would accelerate"):
        servoj(MODEL, Q, ServoJ((0, 0.008, 0.016, 0.024), tuple(map(tuple, points))), period=PERIOD)
    # Set points that rise at 4 rad/s end up faster than the joint may turn, with little acceleration at any time.
    t = np.arange(250) * PERIOD
    way = 4.0 * (t - 0.5 * (1 - np.exp(-2 * t)))
    points = [Q + x * np.eye(6)[0] for x in -way]
    with pytest.raises(TwinError, match=r"set point \d+ .*: shoulder_pan would turn at -3\.2\d* rad/s, its limit"):
        servoj(MODEL, Q, ServoJ(tuple(t), tuple(map(tuple, points))), period=PERIOD)
    with pytest.raises(TwinError, match=r"set point 0 at 0\.000 s: shoulder_pan is 7 rad"):
        servoj(MODEL, Q, ServoJ((0.0,), ((7, 0, 0, 0, 0, 0),)), period=PERIOD)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gain": 50.0}, "gain is 50.0, URScript allows 100 to 2000"),
        ({"lookahead_time": 0.3}, "lookahead_time is 0.3, URScript allows 0.03 to 0.2"),
        ({"times": (0.0,)}, "1 times and 2 set points"),
        ({"times": (0.1, 0.1)}, "times must rise; set point 1"),
        ({"points": ((0,) * 6, (0,) * 5)}, "set point 1: 5 numbers, expected 6"),
        ({"points": ((0,) * 6, (float("nan"),) * 6)}, "not finite"),
    ],
)
def test_a_stream_is_checked_where_it_is_made(changes: dict, message: str) -> None:
    arguments = {"times": (0.0, 0.1), "points": ((0,) * 6, (0,) * 6), **changes}
    with pytest.raises(TwinError, match=message):
        ServoJ(**arguments)
