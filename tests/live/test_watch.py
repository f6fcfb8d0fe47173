"""Rows on one clock: what is wrong with them is counted and survived."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ur5_twin.live.watch import ARRIVAL, STAMP, Watch
from ur5_twin.sources.device import Rows

PERIOD = 0.008
POSIX = 1.7e9


def rows(stamps, arrivals=None, **changes) -> Rows:
    stamps = np.asarray(stamps, dtype=float)
    arrivals = stamps - 50.0 if arrivals is None else np.asarray(arrivals, dtype=float)
    q = np.tile(np.arange(6.0), (len(stamps), 1))
    for row, value in changes.get("q", {}).items():
        q[row, 2] = value
    return Rows(stamps, arrivals, {"actual_q": q})


def test_an_even_stream_goes_through_as_it_came() -> None:
    watch = Watch(POSIX)
    stamps = 100.0 + PERIOD * np.arange(50)
    table = watch.admit(rows(stamps))
    np.testing.assert_array_equal(table.time, stamps)
    np.testing.assert_array_equal(table[STAMP][:, 0], stamps)
    np.testing.assert_array_equal(table[ARRIVAL][:, 0], stamps - 50.0 + POSIX)
    counts = watch.counts
    assert (counts.rows, counts.lost, counts.late, counts.repeated, counts.broken, counts.jumps) == (50, 0, 0, 0, 0, 0)
    assert watch.period == PERIOD


@settings(deadline=None)
@given(st.sets(st.integers(1, 98), max_size=40))
def test_missing_ticks_are_counted(missing: set[int]) -> None:
    ticks = np.array([k for k in range(100) if k not in missing])
    watch = Watch(POSIX, PERIOD)
    watch.admit(rows(100.0 + PERIOD * ticks))
    assert watch.counts.lost == len(missing)


def test_rows_that_are_late_are_counted_and_those_after_them_are_not() -> None:
    stamps = 100.0 + PERIOD * np.arange(30)
    arrivals = stamps - 50.0
    arrivals[2::3] += PERIOD  # each third comes with the next
    watch = Watch(POSIX, PERIOD)
    watch.admit(rows(stamps, arrivals))
    assert (watch.counts.late, watch.counts.lost, watch.counts.rows) == (10, 0, 30)


def test_repeated_and_broken_rows_are_left_out() -> None:
    watch = Watch(POSIX)
    table = watch.admit(rows([100.0, 100.008, 100.008, 100.016, np.nan, 100.032], q={3: np.nan, 5: np.inf}))
    assert table.time.tolist() == [100.0, 100.008]
    assert (watch.counts.repeated, watch.counts.broken) == (1, 3)


@pytest.mark.parametrize("restarted", [5.0, 100.05, 4000.0])
def test_after_a_jump_the_time_goes_on_by_the_host_s_clock(restarted: float) -> None:
    watch = Watch(POSIX)
    before = 100.0 + PERIOD * np.arange(20)
    watch.admit(rows(before, before - 50.0))
    after = restarted + PERIOD * np.arange(20)
    arrivals = before[-1] - 50.0 + 30.0 + PERIOD * np.arange(20)
    table = watch.admit(rows(after, arrivals))
    np.testing.assert_allclose(table.time, before[-1] + 30.0 + PERIOD * np.arange(20), atol=1e-9)
    np.testing.assert_array_equal(table[STAMP][:, 0], after)
    assert (watch.counts.jumps, watch.counts.lost, watch.counts.silences) == (1, 0, 0)


def test_a_small_step_back_counts_as_a_silence_too() -> None:
    """Twin and estimators begin again where the clock cannot be trusted."""
    watch = Watch(POSIX)
    table = watch.admit(rows([100.0, 100.008, 100.0, 100.008], [0.0, 0.008, 0.016, 0.024]))
    np.testing.assert_allclose(table.time, [100.0, 100.008, 101.008, 101.016])


def test_a_stream_that_comes_in_bursts_does_not_jump() -> None:
    stamps = 100.0 + PERIOD * np.arange(1000)
    arrivals = np.ceil((stamps - 100.0) / 3.0) * 3.0
    watch = Watch(POSIX)
    assert len(watch.admit(rows(stamps, arrivals))) == 1000
    assert watch.counts.jumps == 0


def test_a_silence_is_no_loss_of_packages() -> None:
    watch = Watch(POSIX)
    watch.admit(rows([100.0, 100.008, 160.0, 160.008]))
    assert (watch.counts.silences, watch.counts.lost, watch.counts.jumps) == (1, 0, 0)
    assert watch.counts.silent == pytest.approx(59.992)


@settings(deadline=None)
@given(st.lists(st.tuples(st.floats(-1e4, 1e4) | st.just(float("nan")), st.floats(0.0, 1.0)), min_size=1, max_size=60))
def test_whatever_comes_the_time_increases(steps) -> None:
    stamps = np.array([stamp for stamp, _ in steps])
    arrivals = np.cumsum([wait for _, wait in steps])
    watch = Watch(POSIX)
    table = watch.admit(rows(stamps, arrivals))
    assert (np.diff(table.time) > 0).all()
    counts = watch.counts
    assert counts.rows + counts.repeated + counts.broken == len(steps)
