"""What the servo holds: row by row as over a whole log."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ur5_twin.control.held import Held, commanded


def made(kinds: list[int], seed: int) -> np.ndarray:
    """Targets: 0 idle, 1 moving, 2 braking."""
    rng = np.random.default_rng(seed)
    target = rng.normal(size=(len(kinds), 3, 6))
    for row, kind in enumerate(kinds):
        if kind == 0:
            target[row, 1:] = 0.0
        elif kind == 2:
            target[row, 2] = -np.sign(target[row, 1]) * rng.uniform(0.1, 3.0, 6)
    return target


@given(st.lists(st.integers(0, 2), min_size=1, max_size=60), st.integers(0, 99), st.sets(st.integers(0, 59)))
def test_row_by_row_is_the_whole(kinds: list[int], seed: int, begins: set[int]) -> None:
    target = made(kinds, seed)
    anew = np.array([row in begins for row in range(len(kinds))])
    held = Held()
    rows = []
    for row in range(len(kinds)):
        if anew[row]:
            held.forget()
        rows.append(held.update(target[row]))
    np.testing.assert_array_equal(np.array(rows), commanded(target, anew))


def test_after_a_silence_the_old_end_is_not_held() -> None:
    """An arm that was moved by hand meanwhile is where it is."""
    target = np.zeros((4, 3, 6))
    target[:2, 0], target[2:, 0] = 1.0, 2.0
    assert commanded(target)[3, 0, 0] == 1.0
    assert commanded(target, np.array([False, False, True, False]))[3, 0, 0] == 2.0
