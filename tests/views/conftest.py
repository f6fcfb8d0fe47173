"""A replayed recording, made up, for the tests of figures and viewer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ur5_twin import spatial
from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import ArmModel, load_model
from ur5_twin.recording import Recording, Table

#: What the made sensor reads without load.
BIAS = np.array([-5.3, 1.8, -1.0, 0.07, 0.43, -0.11])


@pytest.fixture(scope="session")
def model() -> ArmModel:
    return load_model("plant", "ati_gamma")


@pytest.fixture(scope="session")
def push() -> Callable[[np.ndarray], np.ndarray]:
    """The wrench on the arm at the flange in base axes, (n, 6): two pushes, nothing in the first second."""

    def wrench(time: np.ndarray) -> np.ndarray:
        size = np.where(time > 1.0, np.sin(np.pi * (time - 1.0)) ** 2, 0.0)
        return size[:, None] * np.array([20.0, -8.0, 30.0, 1.0, 2.0, -0.5])

    return wrench


@pytest.fixture(scope="session")
def replayed(model: ArmModel, push: Callable[[np.ndarray], np.ndarray]) -> Recording:
    """Four seconds of slow motion: all signals of a replay, a force sensor, and the truth."""
    rng = np.random.default_rng(7)
    time = np.arange(500) * 0.008
    swing = np.sin(0.7 * time)[:, None] * np.array([0.9, 0.3, 0.4, 0.2, 0.3, 0.0])
    q = np.array([-0.2, -1.35, 0.95, -1.17, -1.57, 0.0]) + swing
    qd = np.gradient(q, 0.008, axis=0)

    def near(values: np.ndarray, scale: float) -> np.ndarray:
        return values + rng.normal(scale=scale, size=values.shape)

    moment, current = 10.0 * np.cos(q), np.sin(q)
    measured = near(q, 1e-4)
    columns = {
        "target_q": q,
        "target_qd": qd,
        "target_moment": moment,
        "target_current": current,
        "actual_q": measured,
        "actual_qd": near(qd, 1e-3),
        "actual_current": near(current, 0.1),
        "actual_TCP_pose": kinematics.tcp_pose(model, measured),
        "actual_TCP_force": near(-push(time), 2.0),
        "sim_actual_q": near(q, 2e-4),
        "sim_actual_qd": near(qd, 1e-3),
        "sim_actual_TCP_pose": kinematics.tcp_pose(model, q),
        "sim_moment": near(moment, 0.1),
        "sim_target_moment": near(moment, 1e-3),
        "sim_actual_current": near(current, 0.05),
        "sim_target_current": near(current, 1e-3),
        "truth_wrench": push(time),
    }
    return Recording(
        {"robot": Table("robot", time, columns, 100.0), "ft": _sensor(model, time, measured, push)}, "made", "test"
    )


def _sensor(model: ArmModel, time: np.ndarray, q: np.ndarray, push: Callable[[np.ndarray], np.ndarray]) -> Table:
    """What the sensor reads of the push: the wrench about its own origin in its own axes, on a clock of its own."""
    ft_time = np.arange(0.0, time[-1], 0.0048)
    q_then = np.stack([np.interp(ft_time, time, joint) for joint in q.T], axis=1)
    R_FB = np.swapaxes(kinematics.forward(model, q_then)[:, :3, :3], 1, 2)
    assert model.tool is not None
    on_arm = spatial.shift_wrench(spatial.rotate_wrench(R_FB, push(ft_time)), model.tool.sensors["ati_gamma"])
    return Table("ft", ft_time - 0.5, {"ft_wrench": BIAS + on_arm}, 100.5)
