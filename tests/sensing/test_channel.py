"""What a channel does to a signal, and that it does the same in pieces of any length."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ur5_twin.sensing.channel import Channel, Line

STEP = 0.002


def read(
    channel: Channel, values: np.ndarray, *, at: np.ndarray, seed: int = 0, cuts: tuple[int, ...] = ()
) -> np.ndarray:
    """What a line makes of values (n, width) at 500 Hz, sampled at times (m,), cut before the rows ``cuts``."""
    line = Line(channel, values.shape[1], np.random.default_rng(seed))
    time = np.arange(len(values)) * STEP
    edges = [0, *sorted(set(cuts)), len(values)]
    parts, taken = [], 0
    for start, end in pairwise(edges):
        line.see(time[start:end], values[start:end])
        due = int(line.covers(at[taken:]).sum())
        if due:
            parts.append(line.sample(at[taken : taken + due]))
            taken += due
    return np.concatenate(parts)


def corrupted(channel: Channel, values: np.ndarray, seed: int = 0, rate: float = 125.0) -> np.ndarray:
    line = Line(channel, values.shape[1], np.random.default_rng(seed))
    return line.corrupted(np.arange(len(values)) / rate, values)


def test_without_any_fault_it_reads_the_truth_between_rows_on_a_line() -> None:
    truth = np.random.default_rng(1).normal(size=(50, 2))
    at = np.array([0.0, 0.0205, 0.05])
    found = read(Channel(), truth, at=at)
    # Rounding of an interpolation; at 0.0205 s a quarter of the way from row 10 to row 11.
    np.testing.assert_allclose(found[1], 0.75 * truth[10] + 0.25 * truth[11], rtol=1e-12)
    np.testing.assert_allclose(found[[0, 2]], truth[[0, 25]], rtol=1e-12)


@pytest.mark.parametrize("delay", [0.004, 0.075])
def test_a_delay_shifts_the_signal_and_begins_with_the_first_value(delay: float) -> None:
    time = np.arange(400) * STEP
    truth = (3.0 + np.sin(5.0 * time))[:, None]
    at = np.arange(0.0, 0.79, 0.0048)
    found = read(Channel(delay=delay), truth, at=at)[:, 0]
    # A chord over 2 ms of a sine of 5 rad/s is off by less than (5 * 0.002)^2 / 8.
    np.testing.assert_allclose(found, 3.0 + np.sin(5.0 * np.maximum(at - delay, 0.0)), atol=1.3e-5)


def test_samples_are_to_be_had_until_the_delay_after_the_last_row() -> None:
    line = Line(Channel(delay=0.02), 1, np.random.default_rng(0))
    assert not line.covers(np.array([0.0])).any()
    line.see(np.arange(5) * STEP, np.zeros((5, 1)))
    np.testing.assert_array_equal(line.covers(np.array([0.0, 0.0279, 0.0281])), [True, True, False])


@pytest.mark.parametrize("bandwidth", [10.0, 30.0, 73.0])
def test_at_its_bandwidth_a_line_lets_3_db_less_through(bandwidth: float) -> None:
    time = np.arange(2000) * STEP
    truth = np.sin(2 * np.pi * bandwidth * time)[:, None]
    at = time[1000:]
    found = read(Channel(bandwidth=bandwidth), truth, at=at)[:, 0]
    wave = np.exp(-2j * np.pi * bandwidth * at)
    amplitude = 2.0 * abs(np.mean(found * wave))
    # Butterworth's own; the mean runs over whole periods, the filter's transient is over after 2 s, rounding is left.
    assert amplitude == pytest.approx(np.sqrt(0.5), rel=1e-6)


def test_a_constant_goes_through_a_low_pass_from_the_first_row_on() -> None:
    found = read(Channel(bandwidth=30.0), np.full((100, 2), 9.82), at=np.arange(100) * STEP)
    # The filter begins as if it had seen the first value for ever: rounding only.
    np.testing.assert_allclose(found, 9.82, rtol=1e-12)


def test_bias_is_added() -> None:
    bias = np.array([1.0, -2.0, 0.5])
    np.testing.assert_array_equal(corrupted(Channel(bias=bias), np.zeros((4, 3))), np.tile(bias, (4, 1)))


def test_noise_is_white_and_as_large_as_it_says() -> None:
    noise = np.array([0.1, 3.0])
    found = corrupted(Channel(noise=noise), np.zeros((40_000, 2)))
    # The standard deviation of n samples scatters by 1 / sqrt(2 n) = 0.35 %; four times that.
    np.testing.assert_allclose(found.std(axis=0), noise, rtol=0.014)
    next_to = (found[1:] * found[:-1]).mean(axis=0) / noise**2
    # Of white noise it scatters by 1 / sqrt(n) = 0.5 %.
    np.testing.assert_allclose(next_to, 0.0, atol=0.02)


@pytest.mark.parametrize("seconds", [1.0, 4.0, 16.0])
def test_drift_grows_with_the_root_of_time(seconds: float) -> None:
    """Over many lines with one number for each: after t seconds their spread is drift sqrt(t), at any rate."""
    drift = np.full(4000, 0.02)
    for rate in (5.0, 20.0):
        rows = round(seconds * rate) + 1
        found = corrupted(Channel(drift=drift), np.zeros((rows, 4000)), rate=rate)
        np.testing.assert_array_equal(found[0], 0.0)
        # 4000 of them know their spread to 1 / sqrt(8000) = 1.1 %; four times that.
        assert found[-1].std() == pytest.approx(0.02 * np.sqrt(seconds), rel=0.045)


def test_saturation_cuts_both_signs() -> None:
    truth = np.array([[-200.0], [-5.0], [5.0], [200.0]])
    found = corrupted(Channel(full_scale=np.array([130.0])), truth)
    np.testing.assert_array_equal(found, [[-130.0], [-5.0], [5.0], [130.0]])


def test_steps_round_to_the_nearest_and_zero_means_none() -> None:
    truth = np.random.default_rng(2).normal(size=(200, 2))
    found = corrupted(Channel(step=np.array([0.25, 0.0])), truth)
    np.testing.assert_array_equal(found[:, 0] % 0.25, 0.0)
    assert np.abs(found[:, 0] - truth[:, 0]).max() <= 0.125
    np.testing.assert_array_equal(found[:, 1], truth[:, 1])


def test_noise_comes_before_saturation_and_steps() -> None:
    channel = Channel(noise=np.array([10.0]), full_scale=np.array([1.0]), step=np.array([0.5]))
    found = corrupted(channel, np.zeros((500, 1)))
    assert set(found[:, 0]) == {-1.0, -0.5, 0.0, 0.5, 1.0}


FULL = Channel(
    delay=0.013,
    bandwidth=40.0,
    bias=np.array([1.0, 2.0, 3.0]),
    drift=np.array([0.01, 0.1, 1.0]),
    noise=np.array([0.1, 0.2, 0.3]),
    full_scale=np.array([2.0, 3.0, 4.0]),
    step=np.array([1e-3, 0.0, 1e-2]),
)


@given(cuts=st.lists(st.integers(1, 119), max_size=30), rate=st.sampled_from([100.0, 125.0, 207.76, 266.27, 500.0]))
def test_cut_anywhere_a_line_reads_the_same_bits(cuts: list[int], rate: float) -> None:
    """Pieces of one row included, the first too, at rates that divide the rows' and such that do not."""
    truth = np.cumsum(np.random.default_rng(3).normal(scale=0.2, size=(120, 3)), axis=0)
    at = np.arange(int(0.238 * rate)) / rate
    whole = read(FULL, truth, at=at, seed=4)
    np.testing.assert_array_equal(read(FULL, truth, at=at, seed=4, cuts=tuple(cuts)), whole)


def test_noise_is_its_seeds() -> None:
    truth = np.zeros((50, 3))
    at = np.arange(20) * 0.004
    first, same, other = (read(FULL, truth, at=at, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, same)
    assert (first != other).any()
