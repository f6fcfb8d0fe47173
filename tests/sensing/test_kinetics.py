"""What an accelerometer and a force sensor at the flange feel, checked by hand and against MuJoCo's own sensors."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from ur5_twin.arm import kinematics, mjcf
from ur5_twin.arm.mjcf import builder
from ur5_twin.arm.parameters import ArmModel, load_model
from ur5_twin.sensing import Load, Signals
from ur5_twin.sensing.kinetics import FlangeMotion, sensed_wrench

Q = np.array([-0.7, -1.6, -1.7, 0.3, 1.1, 0.4])
NOTHING = np.zeros(6)


def signals(q: np.ndarray, qd: np.ndarray = NOTHING, qdd: np.ndarray = NOTHING) -> Signals:
    """One or more instants, each (6,) or (n, 6)."""
    q, qd, qdd = np.broadcast_arrays(np.atleast_2d(q), np.atleast_2d(qd), np.atleast_2d(qdd))
    still = np.zeros(q.shape)
    return Signals(np.arange(len(q)) * 0.002, q, qd, qdd, still, still)


@pytest.fixture(scope="module")
def model() -> ArmModel:
    return load_model("plant", "ati_gamma+ball_probe")


def test_at_rest_an_accelerometer_reads_gravity_upwards(model: ArmModel) -> None:
    """9.82 m/s^2 along the base's z axis, turned into the flange's axes, wherever in the flange it sits."""
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (50, 6))
    motion = FlangeMotion.of(model, signals(q))
    up = kinematics.forward(model, q)[:, 2, :3]
    for point in (np.zeros(3), np.array([0.1, -0.2, 0.3])):
        # Rounding.
        np.testing.assert_allclose(motion.at(point), 9.82 * up, atol=1e-12)


def test_a_steady_turn_is_felt_as_centripetal_acceleration(model: ArmModel) -> None:
    """Joint 1 turns at w: a point at distance r from its axis is pulled towards it by w^2 r, and joint 6 alike."""
    w, point = 1.7, np.array([0.05, 0.02, 0.1])
    qd = np.array([w, 0.0, 0.0, 0.0, 0.0, 0.0])
    X = kinematics.forward(model, Q)
    p = X[:3, :3] @ point + X[:3, 3]
    felt = X[:3, :3] @ FlangeMotion.of(model, signals(Q, qd)).at(point)[0]
    np.testing.assert_allclose(felt, [-(w**2) * p[0], -(w**2) * p[1], 9.82], atol=1e-12)

    turn = np.array([0.0, 0.0, 0.0, 0.0, 0.0, w])
    change = FlangeMotion.of(model, signals(Q, turn)).at(point)[0] - FlangeMotion.of(model, signals(Q)).at(point)[0]
    # Joint 6 turns about the flange's own z axis.
    np.testing.assert_allclose(change, [-(w**2) * point[0], -(w**2) * point[1], 0.0], atol=1e-12)


def test_acceleration_is_the_second_difference_of_where_the_point_is(model: ArmModel) -> None:
    h, point = 1e-4, np.array([0.01735, 0.00605, 0.0095])
    rng = np.random.default_rng(1)
    qd, qdd = rng.normal(size=(2, 6))

    def at(t: float) -> np.ndarray:
        X = kinematics.forward(model, Q + qd * t + 0.5 * qdd * t**2)
        return X[:3, :3] @ point + X[:3, 3]

    expected = (at(h) - 2 * at(0.0) + at(-h)) / h**2 + [0.0, 0.0, 9.82]
    felt = kinematics.forward(model, Q)[:3, :3] @ FlangeMotion.of(model, signals(Q, qd, qdd)).at(point)[0]
    # Rounding of positions below 1 m over h^2 makes 4e-8, the difference's own error h^2 times the fourth derivative.
    np.testing.assert_allclose(felt, expected, atol=1e-5)


def test_at_rest_a_force_sensor_reads_the_loads_weight_at_its_lever(model: ArmModel) -> None:
    load = Load(1.5, np.array([0.02, -0.01, 0.12]), np.diag([0.01, 0.02, 0.005]))
    p_FS = np.array([0.0, 0.0, 0.0286])
    read = sensed_wrench(FlangeMotion.of(model, signals(Q)), np.zeros((1, 6)), load, p_FS)[0]
    weight = kinematics.forward(model, Q)[:3, :3].T @ [0.0, 0.0, -1.5 * 9.82]
    np.testing.assert_allclose(read[:3], weight, atol=1e-12)
    np.testing.assert_allclose(read[3:], np.cross(load.center - p_FS, weight), atol=1e-12)


@pytest.mark.parametrize("axis", range(3))
def test_a_push_on_the_arm_reads_positive_along_it(model: ArmModel, axis: int) -> None:
    """Along each of the sensor's axes: 20 N on the flange's origin, whose moment at the sensor is -p_FS x f."""
    R = kinematics.forward(model, Q)[:3, :3]
    p_FS = np.array([0.0, 0.0, 0.0286])
    wrench = np.concatenate([20.0 * R[:, axis], np.zeros(3)])[None]
    read = sensed_wrench(FlangeMotion.of(model, signals(Q)), wrench, Load(), p_FS)[0]
    np.testing.assert_allclose(read[:3], 20.0 * np.eye(3)[axis], atol=1e-12)
    np.testing.assert_allclose(read[3:], np.cross(-p_FS, read[:3]), atol=1e-12)


@pytest.fixture(scope="module")
def engine(model: ArmModel) -> mujoco.MjModel:
    """MuJoCo's arm with its own force, torque, acceleration and rate sensors where the tool's force sensor is.

    They measure between the tool's body and the flange, so what they feel is the whole tool.
    """
    root: Any = mjcf.build(model)
    root.option.flag.contact = "disable"
    for kind in ("force", "torque", "accelerometer", "gyro"):
        root.sensor.add(kind, name=kind, site=root.find("site", "ati_gamma"))
    return builder.to_mujoco(root)


def test_in_motion_and_pushed_it_agrees_with_mujocos_sensors(model: ArmModel, engine: mujoco.MjModel) -> None:
    """The engine finds the forces between bodies by its own recursion, from the same q, qd, qdd and push."""
    rng = np.random.default_rng(2)
    q, qd, qdd = rng.uniform(-2.0, 2.0, (3, 40, 6)) * np.array([1.0, 1.0, 4.0])[:, None, None]
    push = rng.uniform(-50.0, 50.0, (40, 6))
    tool = model.tool
    assert tool is not None
    data = mujoco.MjData(engine)
    body = engine.body("tool").id
    expected = {name: np.empty((40, 3)) for name in ("force", "torque", "accelerometer", "gyro")}
    wrench = np.empty((40, 6))
    for k in range(40):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], qd[k], qdd[k]
        data.xfrc_applied[body] = push[k]
        mujoco.mj_inverse(engine, data)
        for name, values in expected.items():
            values[k] = data.sensor(name).data
        # The engine's push acts at the tool's mass centre; ours is about the flange's origin.
        lever = data.xipos[body] - data.xpos[body]
        wrench[k] = [*push[k, :3], *(push[k, 3:] + np.cross(lever, push[k, :3]))]
    motion = FlangeMotion.of(model, signals(q, qd, qdd))
    p_FS = tool.sensors["ati_gamma"]
    read = sensed_wrench(motion, wrench, Load(tool.mass, tool.center, tool.inertia), p_FS)
    # Forces go to 60 N, moments to 50 Nm; the MJCF has 15 digits and the engine diagonalises tensors to 1e-11.
    assert np.abs(read - wrench).max() > 1.0
    # The engine's sensors say what holds the tool against all this: what the flange does to it.
    np.testing.assert_allclose(read[:, :3], -expected["force"], atol=1e-9)
    np.testing.assert_allclose(read[:, 3:], -expected["torque"], atol=1e-9)
    np.testing.assert_allclose(motion.at(p_FS), expected["accelerometer"], atol=1e-9)
    np.testing.assert_allclose(motion.into_flange(motion.omega), expected["gyro"], atol=1e-9)
