"""Filters that go on from piece to piece: to the bit scipy's."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, lfilter, sosfilt, sosfilt_zi

from ur5_twin.filters import first_order, second_order


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.integers(0, 20))
def test_first_order_is_scipys(seed: int, gain: float, pole: float, cut: int) -> None:
    rng = np.random.default_rng(seed)
    rows, memory = rng.standard_normal((20, 3)), rng.standard_normal((1, 3))
    expected, left = lfilter([gain], [1.0, -pole], rows, axis=0, zi=memory)
    before = memory.copy()
    a, between = first_order(gain, pole, rows[:cut], memory)
    b, after = first_order(gain, pole, rows[cut:], between)
    np.testing.assert_array_equal(np.concatenate([a, b]), expected)
    np.testing.assert_array_equal(after, left)
    np.testing.assert_array_equal(memory, before)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.49), st.sampled_from([2, 3, 6]), st.integers(0, 20))
def test_second_order_is_scipys(seed: int, corner: float, order: int, cut: int) -> None:
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((20, 3))
    sections = butter(order, corner, fs=1.0, output="sos")
    memory = sosfilt_zi(sections)[:, :, None] * rows[0]
    expected, left = sosfilt(sections, rows, axis=0, zi=memory)
    before = memory.copy()
    a, between = second_order(sections, rows[:cut], memory)
    b, after = second_order(sections, rows[cut:], between)
    np.testing.assert_array_equal(np.concatenate([a, b]), expected)
    np.testing.assert_array_equal(after, left)
    np.testing.assert_array_equal(memory, before)
