"""Friction: it sticks, slips at its level, and never gives energy back that it was not given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ur5_twin.arm.drive import load_joint_drives
from ur5_twin.arm.friction import FRICTIONLESS, Friction, friction_torque, pack
from ur5_twin.arm.parameters import load_model
from ur5_twin.errors import ModelError

ROTOR = load_model("plant").rotor_inertia
DT = 0.002


@pytest.fixture(scope="module")
def friction() -> Friction:
    return load_joint_drives().friction


def slide(friction: Friction, joint: int, speeds: np.ndarray, load: float = 0.0) -> np.ndarray:
    """Friction torque of a joint that moves at given speeds, step by step."""
    packed, z, torque = pack(friction, ROTOR), 0.0, []
    for v in speeds:
        tau, z = friction_torque(packed, joint, z, v * DT, v, load, 1.0)
        torque.append(tau)
    return np.array(torque)


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("speed", [-1.0, -0.05, 0.05, 1.0])
def test_sliding_is_coulomb_load_stribeck_and_viscous(friction: Friction, joint: int, speed: float) -> None:
    load = 20.0
    torque = slide(friction, joint, np.full(400, speed), load)[-1]
    expected = friction.sliding(np.full(6, speed), np.full(6, load))[joint]
    assert torque == pytest.approx(expected, rel=1e-12)
    assert torque * speed > 0


def test_directions_differ(friction: Friction) -> None:
    uneven = replace(friction, coulomb_positive=np.full(6, 5.0), coulomb_negative=np.full(6, 7.0))
    there, back = (slide(uneven, 0, np.full(400, v))[-1] for v in (0.3, -0.3))
    assert abs(back) - abs(there) == pytest.approx(2.0, rel=1e-12)


def test_below_its_level_a_joint_comes_back(friction: Friction) -> None:
    """A push that yields half the presliding way and goes again leaves nothing behind, however often."""
    packed = pack(replace(friction, stribeck=np.zeros(6)), ROTOR)
    z = 0.0
    half = 0.5 * friction.presliding[0]
    for _ in range(1000):
        _, z = friction_torque(packed, 0, z, half, 0.0, 0.0, 1.0)
        torque, z = friction_torque(packed, 0, z, -half, 0.0, 0.0, 1.0)
    assert abs(z) < 1e-15
    assert abs(torque) < 1e-9


def test_a_stuck_joint_remembers_where_it_came_from(friction: Friction) -> None:
    """Stopped after sliding forward it still holds against forward, at the level of breaking loose."""
    stopped = slide(friction, 1, np.concatenate([np.full(300, 0.2), np.zeros(300)]))[-1]
    assert 0 < stopped <= friction.coulomb_positive[1] + friction.stribeck[1]


@given(st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=60), st.floats(0.0, 80.0))
@settings(deadline=None, max_examples=60)
def test_a_closed_path_costs_energy(speeds: list[float], load: float) -> None:
    friction = load_joint_drives().friction
    way = np.array([*speeds, -sum(speeds)])
    packed, z, work = pack(friction, ROTOR), 0.0, 0.0
    for v in np.repeat(way, 5):
        before = z
        tau, z = friction_torque(packed, 2, z, v * DT, v, load, 1.0)
        # The spring's force grows along the step: the mean of both ends, as far as it did not slip.
        work += tau * v * DT
    stored = 0.5 * packed.stiffness[2] * before**2
    # What the spring holds at the end is the most it can give back.
    assert work >= -stored - 1e-9


def test_a_cold_drive_rubs_more_and_warms(friction: Friction) -> None:
    scale = friction.viscous_scale(np.array([0.0, friction.warming_time, 1e6]), 0.0)
    assert scale[0] == pytest.approx(friction.cold)
    assert scale[1] == pytest.approx(1 + (friction.cold - 1) / np.e)
    assert scale[2] == pytest.approx(1.0)
    np.testing.assert_array_equal(friction.viscous_scale(np.arange(3.0), np.inf), 1.0)


def test_no_friction_is_none() -> None:
    np.testing.assert_array_equal(slide(FRICTIONLESS, 3, np.linspace(-1, 1, 50)), 0.0)


def test_scaled_friction_is_scaled(friction: Friction) -> None:
    factor = np.full(6, 1.5)
    a, b = (
        friction.sliding(np.full(6, 0.4), np.full(6, 9.0)),
        friction.scaled(factor).sliding(np.full(6, 0.4), np.full(6, 9.0)),
    )
    np.testing.assert_allclose(b, 1.5 * a, rtol=1e-12)


def test_a_joint_that_does_not_yield_is_an_error(friction: Friction) -> None:
    with pytest.raises(ModelError, match="presliding"):
        pack(replace(friction, presliding=np.zeros(6)), ROTOR)
