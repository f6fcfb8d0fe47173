"""The time law of one way."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from ur5_twin.control.profile import Trapezoid, ticks


@given(
    length=st.floats(1e-3, 10.0),
    speed=st.floats(0.05, 3.2),
    acceleration=st.floats(0.1, 25.0),
    start=st.floats(0.0, 1.0),
    end=st.floats(0.0, 1.0),
)
def test_a_way_joins_its_rates_within_its_bounds(
    length: float, speed: float, acceleration: float, start: float, end: float
) -> None:
    start, end = start * speed, end * speed
    assume(abs(start**2 - end**2) < 2.0 * acceleration * length)
    law = Trapezoid(length, speed, acceleration, start, end)
    t = np.linspace(0.0, law.duration, 2001)
    x, xd, xdd = law.at(t)
    # Rounding of sums of a few terms of the way's size.
    assert np.allclose([x[0], xd[0], x[-1], xd[-1]], [0.0, start, length, end], rtol=0, atol=1e-9)
    assert xd.max() <= speed * (1 + 1e-9)
    assert xd.min() >= -1e-9
    assert np.abs(xdd).max() <= acceleration
    # The trapezoidal rule is exact within a piece, and off by a dt^2 / 4 at most where pieces meet.
    dt = law.duration / 2000
    assert np.abs(np.diff(x) - 0.5 * dt * (xd[1:] + xd[:-1])).max() <= acceleration * dt**2 / 4 * (1 + 1e-9) + 1e-12


def test_a_long_way_cruises_and_a_short_one_does_not() -> None:
    # 1 m at 0.25 m/s and 1 m/s^2: 0.25 s up, 0.25 s down, 0.9375 m in between.
    long = Trapezoid(1.0, 0.25, 1.0)
    assert np.isclose(long.duration, 0.5 + 0.9375 / 0.25)
    # 0.01 m: peak sqrt(a L) = 0.1 m/s after 0.1 s.
    short = Trapezoid(0.01, 0.25, 1.0)
    assert np.isclose(short.peak, 0.1)
    assert np.isclose(short.duration, 0.2)


def test_rounding_adds_no_tick() -> None:
    # 0.7 / 0.1 is 6.999..., 0.3 / 0.1 is 2.999... and (0.1 + 0.2) / 0.1 is 3.0000000000000004.
    assert [ticks(d, 0.1) for d in (0.7, 0.3, 0.1 + 0.2, 0.31, 0.0)] == [7, 3, 3, 4, 0]
