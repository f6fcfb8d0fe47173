"""The thesis' drive map."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ur5_twin.arm.drive import load_drive
from ur5_twin.errors import ModelError

six = st.lists(st.floats(-50.0, 50.0), min_size=6, max_size=6).map(np.array)


@given(torque=six, qd=six)
def test_current_and_torque_are_inverse(torque: np.ndarray, qd: np.ndarray) -> None:
    drive = load_drive("thesis")
    assert np.allclose(drive.torque(drive.current(torque, qd), qd), torque, atol=1e-9)


def test_friction_has_a_dead_zone_and_opposes_motion() -> None:
    drive = load_drive("thesis")
    slow, fast = np.full(6, 0.02), np.full(6, 0.5)
    assert np.allclose(drive.friction(slow), drive.viscous * slow)
    assert np.allclose(drive.friction(fast), drive.coulomb + 0.5 * drive.viscous)
    assert np.allclose(drive.friction(-fast), -drive.friction(fast))


def test_numbers_of_equations_6_2_and_6_6() -> None:
    """tau_2 = 6.8 i_2 + 16 at rest, and 5.5 Nm of Coulomb friction."""
    drive = load_drive("thesis")
    assert drive.torque(np.ones(6), np.zeros(6))[1] == pytest.approx(6.8 + 16.0)
    assert drive.coulomb[1] == 5.5


def test_many_rows_are_many_single_ones() -> None:
    drive = load_drive("thesis")
    rng = np.random.default_rng(3)
    torque, qd = rng.normal(size=(2, 5, 6))
    rows = np.array([drive.current(a, b) for a, b in zip(torque, qd, strict=True)])
    assert np.array_equal(drive.current(torque, qd), rows)


def test_unknown_drive() -> None:
    with pytest.raises(ModelError, match="known: thesis"):
        load_drive("magic")
