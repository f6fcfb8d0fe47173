"""A replayed recording and a scenario's run, made up, for the tests of figures and viewer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ur5_twin import spatial
from ur5_twin.arm import kinematics
from ur5_twin.arm.mjcf import Obstacle
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


#: When the made run touches its plate, and when it is pushed, s; and when its controller stops it.
PRESSED, PUSHED, STOPPED = (1.0, 1.8), (2.4, 2.9), 3.2


@pytest.fixture(scope="session")
def probe() -> ArmModel:
    return load_model("plant", "ati_gamma+ball_probe")


@pytest.fixture(scope="session")
def obstacles(probe: ArmModel) -> tuple[Obstacle, ...]:
    """A plate where the tip of the made run's probe is at 1.4 s, and a post and a ball beside it."""
    tip = _tips(probe, _joints(np.array([1.4])))[0]
    beside, before = tip + np.array([0.0, 0.35, -0.1]), tip + np.array([0.0, -0.3, -0.1])
    plate = Obstacle("plate", "plate", tip, np.zeros(3), np.array([0.3, 0.2, 0.03]), 2e4, 50.0, 0.3)
    post = Obstacle("post", "cylinder", beside, np.zeros(3), np.array([0.04, 0.5]), 2e4, 50.0, 0.3)
    ball = Obstacle("ball", "sphere", before, np.zeros(3), np.array([0.08]), 2e4, 50.0, 0.3)
    return plate, post, ball


@pytest.fixture(scope="session")
def run(probe: ArmModel) -> Recording:
    """Four seconds of a run: the probe presses on a plate (obstacle 0), the forearm is pushed, the controller stops."""
    rng = np.random.default_rng(11)
    time = np.arange(500) * 0.008
    q = _joints(time)
    qd = np.gradient(q, 0.008, axis=0)
    press, push = _bump(time, *PRESSED, np.array([4.0, -2.0, 45.0])), _bump(time, *PUSHED, np.array([0.0, 30.0, 0.0]))
    tip, flange = _tips(probe, q), kinematics.forward(probe, q)[:, :3, 3]
    wrench = np.concatenate([press, np.cross(tip - flange, press)], axis=1)
    J = kinematics.jacobian(probe, q)
    external = np.einsum("nij,ni->nj", J, wrench) + push[:, 1:2] * np.array([0.3, 0.1, 0.05, 0.0, 0.0, 0.0])
    friction, moment = 8.0 * np.tanh(5.0 * qd), 10.0 * np.cos(q)

    def near(values: np.ndarray, scale: float) -> np.ndarray:
        return values + rng.normal(scale=scale, size=values.shape)

    truth_q = near(q, 1e-6) - 2e-4 * np.tanh(5.0 * qd)
    columns = {
        "target_q": q,
        "target_qd": qd,
        "target_moment": moment,
        "target_current": moment / 10.0,
        "actual_q": near(truth_q, 2e-5),
        "actual_qd": near(qd, 1e-3),
        "actual_current": near((moment + friction) / 10.0, 0.1),
        "actual_TCP_pose": kinematics.tcp_pose(probe, q),
        "actual_TCP_force": near(-wrench, 3.0),
        "safety_mode": np.where(time < STOPPED, 1.0, 3.0)[:, None],
        "truth_q": truth_q,
        "truth_qd": qd,
        "truth_wrench": wrench,
        "truth_tau_ext": external,
        "truth_friction": friction,
        "truth_moment": moment + friction - external,
    }
    elbow = kinematics.link_frames(probe, q)[:, 2, :3, 3]
    contact = _contacts(time, ((press, tip, 7, 0), (push, elbow, 3, -1)))

    def sensed(then: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(then, time, axis) for axis in wrench.T], axis=1)

    ft = _sensor(probe, time, q, sensed)
    return Recording({"robot": Table("robot", time, columns, 100.0), "ft": ft, "contact": contact}, "made", "run")


def _joints(time: np.ndarray) -> np.ndarray:
    """Down onto the plate and up again about 1.4 s, and a slow turn of the base afterwards."""
    dip = 0.12 * np.exp(-(((time - 1.4) / 0.4) ** 2))
    turn = 0.6 * np.clip((time - 1.9) / 1.2, 0.0, 1.0) ** 2
    q = np.tile([0.3, -1.25, 1.55, -1.87, -1.57, 0.0], (len(time), 1))
    q[:, 0] += turn
    q[:, 1] += dip
    q[:, 3] -= dip
    return q


def _tips(model: ArmModel, q: np.ndarray) -> np.ndarray:
    """(n, 3) the lowest point of the ball, below its centre in base axes."""
    assert model.tool is not None
    X_BF = kinematics.forward(model, q)
    ball = model.tool.parts[-1]
    return X_BF[:, :3, 3] + X_BF[:, :3, :3] @ ball.center - np.array([0.0, 0.0, 0.01])


def _bump(time: np.ndarray, start: float, end: float, force: np.ndarray) -> np.ndarray:
    """(n, 3) half a sine of a force between two times, 0 outside."""
    phase = np.clip((time - start) / (end - start), 0.0, 1.0)
    return np.sin(np.pi * phase)[:, None] * force * ((phase > 0) & (phase < 1))[:, None]


def _contacts(time: np.ndarray, acts: tuple[tuple[np.ndarray, np.ndarray, int, int], ...]) -> Table:
    """Rows of what acts at each tick: force and point over time, link and obstacle."""
    rows = [np.flatnonzero(np.linalg.norm(force, axis=1) > 0) for force, *_ in acts]
    columns = {
        "contact_link": np.concatenate(
            [np.full((len(r), 1), float(act[2])) for r, act in zip(rows, acts, strict=True)]
        ),
        "contact_obstacle": np.concatenate(
            [np.full((len(r), 1), float(act[3])) for r, act in zip(rows, acts, strict=True)]
        ),
        "contact_point": np.concatenate([act[1][r] for r, act in zip(rows, acts, strict=True)]),
        "contact_force": np.concatenate([act[0][r] for r, act in zip(rows, acts, strict=True)]),
    }
    return Table("contact", time[np.concatenate(rows)], columns, 100.0)
