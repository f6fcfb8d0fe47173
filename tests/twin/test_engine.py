"""MuJoCo's memory as compiled code sees it, against MuJoCo's own bindings."""

from __future__ import annotations

import mujoco
import numba
import numpy as np

from ur5_twin.arm import mjcf
from ur5_twin.arm.parameters import load_model
from ur5_twin.twin import engine


@numba.njit
def _step(e: engine.Engine, steps: int) -> None:
    for _ in range(steps):
        engine.mj_step(e.model, e.data)


@numba.njit
def _force(e: engine.Engine, contact: int, out: np.ndarray) -> None:
    engine.mj_contact_force(e.model, e.data, contact, out.ctypes)


def folded() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """An arm folded into itself: many contacts."""
    model = mjcf.compile(load_model("plant"))
    data = mujoco.MjData(model)
    data.qpos[:] = [0.0, 0.3, 2.9, 0.0, 0.0, 0.0]
    return model, data


def test_contacts_are_where_the_bindings_see_them() -> None:
    model, data = folded()
    e = engine.connect(model, data)
    assert e.ncon[0] == 0
    mujoco.mj_forward(model, data)
    n = data.ncon
    assert n > 10
    assert e.ncon[0] == n
    np.testing.assert_array_equal(e.contacts[:n, engine.CONTACT_DIST], data.contact.dist)
    at = engine.CONTACT_POS
    np.testing.assert_array_equal(e.contacts[:n, at : at + 3], data.contact.pos)
    at = engine.CONTACT_FRAME
    np.testing.assert_array_equal(e.contacts[:n, at : at + 9], data.contact.frame)
    at = engine.CONTACT_GEOMS
    np.testing.assert_array_equal(e.contact_geoms[:n, at : at + 2], data.contact.geom)
    force, expected = np.zeros(6), np.zeros(6)
    for i in range(n):
        _force(e, i, force)
        mujoco.mj_contactForce(model, data, i, expected)
        np.testing.assert_array_equal(force, expected)


def test_steps_are_the_engine_s_own() -> None:
    model, data = folded()
    _, other = folded()
    e = engine.connect(model, data)
    _step(e, 5)
    mujoco.mj_step(model, other, 5)
    np.testing.assert_array_equal(data.qpos, other.qpos)
    assert data.time == other.time


def test_the_step_s_length_can_be_set() -> None:
    model, data = folded()
    e = engine.connect(model, data)
    e.timestep[0] = 0.0005
    assert model.opt.timestep == 0.0005
    _step(e, 2)
    assert data.time == 0.001
