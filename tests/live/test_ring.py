"""The ring keeps the newest rows, in order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ur5_twin.errors import RecordingError
from ur5_twin.live.ring import Ring
from ur5_twin.recording import Table


@given(st.integers(1, 20), st.lists(st.integers(0, 30), max_size=12))
def test_it_holds_the_last_rows(size: int, pieces: list[int]) -> None:
    ring, sent = Ring(size), 0
    for n in pieces:
        time = np.arange(sent, sent + n, dtype=float)
        ring.append(Table("robot", time, {"x": np.stack([time, -time], axis=1)}))
        sent += n
    kept = ring.last()
    expected = np.arange(max(0, sent - size), sent)
    np.testing.assert_array_equal(kept.time, expected)
    if sent:
        np.testing.assert_array_equal(kept["x"], np.stack([expected, -expected], axis=1))


def test_the_last_seconds_are_cut_from_it() -> None:
    ring = Ring(100)
    time = np.arange(80) * 0.1
    ring.append(Table("robot", time, {"x": time[:, None]}))
    np.testing.assert_allclose(ring.last(1.05).time, time[-11:])


def test_what_it_gives_is_a_copy() -> None:
    ring = Ring(3)
    ring.append(Table("robot", np.zeros(1), {"x": np.ones((1, 1))}))
    ring.last()["x"][:] = 7.0
    assert ring.last()["x"].item() == 1.0


def test_no_rows_are_no_ring() -> None:
    with pytest.raises(RecordingError, match="at least 1"):
        Ring(0)
