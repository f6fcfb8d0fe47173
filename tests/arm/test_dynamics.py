"""Rigid-body dynamics: the structure of the equations of motion, two other engines, and the robot's own torques."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from numba import njit

from ur5_twin.arm import dynamics, kinematics
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import ArmModel, load_model, model_names
from ur5_twin.recording import read

CASES = [(name, tool) for name in model_names() for tool in ("none", "both")]
#: Against another algorithm, relative to the largest entry: a few hundred operations, each 2e-16.
ROUNDING = 1e-13
#: Between engines: rounding times M's condition number, up to 1e5 without rotors, where M is inverted.
ENGINES = 1e-10


@pytest.fixture(params=CASES, ids=lambda case: f"{case[0]}-{case[1]}")
def model(request: pytest.FixtureRequest) -> ArmModel:
    return load_model(*request.param)


@pytest.fixture
def plant() -> Dynamics:
    return Dynamics(load_model("plant", "ati_gamma"))


def states(*shape: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    size = (*shape, 6)
    return rng.uniform(-2 * np.pi, 2 * np.pi, size), rng.uniform(-3.2, 3.2, size), rng.uniform(-25, 25, size)


def assert_equal(actual: np.ndarray, expected: np.ndarray, relative: float) -> None:
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=relative * np.abs(expected).max())


def test_mass_matrix_is_symmetric_and_positive_definite(model: ArmModel) -> None:
    q, qd, _ = states(50)
    M = Dynamics(model).mass_matrix(q)
    np.testing.assert_array_equal(M, np.swapaxes(M, -1, -2))
    assert np.linalg.eigvalsh(M).min() > 0.0
    kinetic = 0.5 * np.einsum("ni,nij,nj->n", qd, M, qd)
    assert_equal(Dynamics(model).kinetic_energy(q, qd), kinetic, ROUNDING)


def test_mass_matrix_is_the_sum_over_the_links(model: ArmModel) -> None:
    # Thesis equation 2.61 with the Jacobians of the mass centres, plus the rotors.
    q, _, _ = states(10)
    frames = kinematics.link_frames(model, q)
    expected = np.broadcast_to(np.diag(model.rotor_inertia), (10, 6, 6)).copy()
    for i, (mass, center, tensor) in enumerate(zip(*model.bodies(), strict=True), start=1):
        J = kinematics.point_jacobian(model, q, i, center)
        R = frames[:, i, :3, :3]
        Jv, Jw = J[:, :3], np.swapaxes(R, -1, -2) @ J[:, 3:]
        expected += mass * np.swapaxes(Jv, -1, -2) @ Jv + np.swapaxes(Jw, -1, -2) @ tensor @ Jw
    assert_equal(Dynamics(model).mass_matrix(q), expected, ROUNDING)


def test_inverse_is_the_sum_of_its_terms(model: ArmModel) -> None:
    arm = Dynamics(model)
    q, qd, qdd = states(50)
    M, C, g = arm.mass_matrix(q), arm.coriolis_matrix(q, qd), arm.gravity(q)
    coriolis = (C @ qd[..., None])[..., 0]
    assert_equal(arm.bias(q, qd), coriolis + g, ROUNDING)
    assert_equal(arm.inverse(q, qd, qdd), (M @ qdd[..., None])[..., 0] + coriolis + g, ROUNDING)
    assert_equal(arm.inverse(q, 0 * q, 0 * q), g, ROUNDING)


def test_coriolis_matrix_is_that_of_the_christoffel_symbols(plant: Dynamics) -> None:
    # Thesis equations 2.65 and 2.66 from central differences of M: step^2 = 1e-10 and rounding 1e-16 / 1e-5.
    q, qd, _ = states(5)
    step = 1e-5
    dM = np.stack(
        [(plant.mass_matrix(q + step * e) - plant.mass_matrix(q - step * e)) / (2 * step) for e in np.eye(6)], axis=1
    )  # dM[n, i, k, j] = d M_kj / d q_i
    symbols = 0.5 * (dM + np.einsum("njki->nikj", dM) - np.einsum("nkij->nikj", dM))
    expected = np.einsum("nikj,ni->nkj", symbols, qd)
    np.testing.assert_allclose(plant.coriolis_matrix(q, qd), expected, atol=1e-8)


def test_coriolis_matrix_is_linear_down_to_standstill(plant: Dynamics) -> None:
    q, qd, _ = states()
    C = plant.coriolis_matrix(q, qd)
    # Scaling by powers of two changes no rounding.
    np.testing.assert_array_equal(plant.coriolis_matrix(q, qd * 2.0**-40), C * 2.0**-40)
    assert not plant.coriolis_matrix(q, 0 * qd).any()


def test_mass_rate_minus_twice_coriolis_is_skew(model: ArmModel) -> None:
    # Forces of inertia do no work; M' by central differences, as above.
    arm = Dynamics(model)
    q, qd, _ = states(10)
    step = 1e-5
    M_dot = (arm.mass_matrix(q + step * qd) - arm.mass_matrix(q - step * qd)) / (2 * step)
    N = M_dot - 2 * arm.coriolis_matrix(q, qd)
    np.testing.assert_allclose(N + np.swapaxes(N, -1, -2), 0.0, atol=1e-6)


def test_gravity_is_the_gradient_of_the_potential(model: ArmModel) -> None:
    arm = Dynamics(model)
    q, _, _ = states(10)
    step = 1e-5
    # Up to 100 J: rounding of 1e-14 over a step of 1e-5, and the step squared.
    for i, e in enumerate(np.eye(6)):
        expected = (arm.potential_energy(q + step * e) - arm.potential_energy(q - step * e)) / (2 * step)
        np.testing.assert_allclose(arm.gravity(q)[:, i], expected, atol=2e-8)


def test_potential_is_weight_times_height() -> None:
    # Upright, q2 = q4 = -90 degrees: heights add up by hand from table 4.2 and the DH parameters.
    model = load_model("c")
    q = np.array([0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0])
    masses, centers, _ = model.bodies()
    frames = kinematics.link_frames(model, q)
    heights = [(X @ [*p, 1.0])[2] for X, p in zip(frames[1:], centers, strict=True)]
    assert Dynamics(model).potential_energy(q) == pytest.approx(9.81 * masses @ heights, rel=ROUNDING)
    assert heights[1] == pytest.approx(model.dh.d[0] + 0.2125, abs=1e-12)


def test_free_swing_keeps_its_energy(plant: Dynamics) -> None:
    # Half a second without torque, thousandths of it by Runge-Kutta 4: its error is step^4 = 1e-12 of some 100 J,
    # magnified by the wrist's fast turning.
    q, qd = np.array([0.3, -0.4, 0.8, -1.2, 0.9, 0.5]), np.array([0.5, -0.5, 1.0, 2.0, -1.0, 3.0])
    energy = plant.kinetic_energy(q, qd) + plant.potential_energy(q)
    start = plant.potential_energy(q)
    state, step = np.concatenate([q, qd]), 1e-3

    def rate(x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[6:], plant.forward(x[:6], x[6:], np.zeros(6))])

    for _ in range(500):
        k1 = rate(state)
        k2 = rate(state + step / 2 * k1)
        k3 = rate(state + step / 2 * k2)
        k4 = rate(state + step * k3)
        state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    assert abs(plant.potential_energy(state[:6]) - start) > 5.0  # it did fall
    assert plant.kinetic_energy(state[:6], state[6:]) + plant.potential_energy(state[:6]) == pytest.approx(
        energy, abs=1e-7
    )


def test_forward_undoes_inverse(model: ArmModel) -> None:
    arm = Dynamics(model)
    q, qd, qdd = states(100)
    assert_equal(arm.forward(q, qd, arm.inverse(q, qd, qdd)), qdd, ENGINES)


def test_leading_axes_are_kept_and_broadcast(plant: Dynamics) -> None:
    q, qd, qdd = states(3, 4)
    tau = plant.inverse(q, qd, qdd)
    assert tau.shape == (3, 4, 6)
    assert plant.mass_matrix(q).shape == plant.coriolis_matrix(q, qd).shape == (3, 4, 6, 6)
    assert plant.potential_energy(q).shape == plant.kinetic_energy(q, qd).shape == (3, 4)
    # One sample, a log and many cells go through the same code: not a bit may differ.
    np.testing.assert_array_equal(plant.inverse(q[1, 2], qd[1, 2], qdd[1, 2]), tau[1, 2])
    np.testing.assert_array_equal(plant.bias(q[0, 0], qd), plant.bias(np.broadcast_to(q[0, 0], q.shape), qd))
    np.testing.assert_array_equal(plant.inverse(q[..., ::-1], qd, qdd), plant.inverse(q[..., ::-1].copy(), qd, qdd))
    with pytest.raises(ValueError, match="6 joints"):
        plant.gravity(np.zeros(7))


def test_the_kernels_can_be_called_from_compiled_code(plant: Dynamics) -> None:
    @njit
    def computed_torque(packed, q, qd, a, tau):
        dynamics.rnea_into(packed, q, qd, a, tau)

    # numba resolves globals of the module the function is written in.
    q, qd, qdd = states()
    tau = np.empty(6)
    computed_torque(plant.packed, q, qd, qdd, tau)
    np.testing.assert_array_equal(tau, plant.inverse(q, qd, qdd))


@pytest.mark.parametrize("alpha", [np.zeros(6), np.linspace(-1.0, 2.0, 6)], ids=["planar", "any"])
def test_any_denavit_hartenberg_parameters_work(alpha: np.ndarray) -> None:
    base = load_model("plant")
    rng = np.random.default_rng(5)
    dh = replace(base.dh, alpha=alpha, a=rng.normal(size=6), d=rng.normal(size=6))
    links = tuple(
        replace(link, center=rng.normal(size=3), inertia=link.inertia + 0.3 * np.full((3, 3), 0.1) + np.eye(3))
        for link in base.links
    )
    compare_with_pinocchio(replace(base, dh=dh, links=links))


def test_equals_pinocchio(model: ArmModel) -> None:
    compare_with_pinocchio(model)


def compare_with_pinocchio(model: ArmModel) -> None:
    arm, other = Dynamics(model), pinocchio_model(model)
    data = other.createData()
    for q, qd, x in zip(*states(20), strict=True):
        M = pin.crba(other, data, q)
        assert_equal(arm.mass_matrix(q), np.triu(M) + np.triu(M, 1).T, ENGINES)
        assert_equal(arm.inverse(q, qd, x), pin.rnea(other, data, q, qd, x), ENGINES)
        assert_equal(arm.bias(q, qd), pin.nonLinearEffects(other, data, q, qd), ENGINES)
        assert_equal(arm.gravity(q), pin.computeGeneralizedGravity(other, data, q), ENGINES)
        assert_equal(arm.forward(q, qd, x), pin.aba(other, data, q, qd, x), ENGINES)
        assert arm.potential_energy(q) == pytest.approx(pin.computePotentialEnergy(other, data, q), rel=ENGINES)


def pinocchio_model(model: ArmModel) -> pin.Model:
    other, joint, placement = pin.Model(), 0, pin.SE3.Identity()
    for i, (mass, center, tensor) in enumerate(zip(*model.bodies(), strict=True)):
        joint = other.addJoint(joint, pin.JointModelRZ(), placement, f"joint_{i}")
        c, s = np.cos(model.dh.alpha[i]), np.sin(model.dh.alpha[i])
        twist = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        placement = pin.SE3(twist, np.array([model.dh.a[i], 0.0, model.dh.d[i]]))
        other.appendBodyToJoint(joint, pin.Inertia(mass, center, tensor), placement)
    other.armature = model.rotor_inertia.copy()
    other.gravity.linear = np.array([0.0, 0.0, -model.gravity])
    return other


def test_equals_mujoco(model: ArmModel) -> None:
    arm, engine = Dynamics(model), mujoco.MjModel.from_xml_string(mjcf(model))
    data = mujoco.MjData(engine)
    # MuJoCo takes no zero tensor: the point masses get 1e-12 kg m^2, which adds 1e-11 Nm.
    M = np.empty((6, 6))
    for q, qd, qdd in zip(*states(20), strict=True):
        data.qpos, data.qvel = q, qd
        mujoco.mj_forward(engine, data)
        data.qacc = qdd
        mujoco.mj_inverse(engine, data)
        assert_equal(arm.inverse(q, qd, qdd), data.qfrc_inverse, ENGINES)
        assert_equal(arm.bias(q, qd), data.qfrc_bias, ENGINES)
        mujoco.mj_fullM(engine, data, M)
        assert_equal(arm.mass_matrix(q), M, ENGINES)
        assert_equal(kinematics.forward(model, q)[:3, 3], data.body("link_5").xpos + tip(model, data), ENGINES)


def tip(model: ArmModel, data: mujoco.MjData) -> np.ndarray:
    """From the last joint frame to the flange, along the joint's axis by d6, in base axes."""
    return data.body("link_5").xmat.reshape(3, 3)[:, 2] * model.dh.d[5]


def mjcf(model: ArmModel) -> str:
    """The model as MJCF text: one body a link at its joint, its z the joint's axis, no geometry."""
    opening, closing = "", ""
    pos, quat = "0 0 0", "1 0 0 0"
    for i, (mass, center, tensor) in enumerate(zip(*model.bodies(), strict=True)):
        alpha, a, d = model.dh.alpha[i], model.dh.a[i], model.dh.d[i]
        c, s = np.cos(alpha), np.sin(alpha)
        R = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        com = R @ center + [a, 0.0, d]
        inertia = R @ tensor @ R.T
        if not inertia.any():
            inertia = np.eye(3) * 1e-12
        full = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        opening += (
            f'<body name="link_{i}" pos="{pos}" quat="{quat}">'
            f'<inertial pos="{text(com)}" mass="{float(mass)!r}" fullinertia="{text(full)}"/>'
            f'<joint axis="0 0 1" armature="{float(model.rotor_inertia[i])!r}"/>'
        )
        closing += "</body>"
        pos, quat = text([a, 0.0, d]), text([np.cos(alpha / 2), np.sin(alpha / 2), 0.0, 0.0])
    return (
        f'<mujoco><compiler angle="radian" boundmass="0" boundinertia="0"/><option gravity="0 0 {-model.gravity!r}"/>'
        f"<worldbody>{opening}{closing}</worldbody></mujoco>"
    )


def text(numbers) -> str:
    return " ".join(repr(float(x)) for x in numbers)


def test_target_torque_is_known_to_its_printed_digits(lab_logs: Path) -> None:
    arm = Dynamics(load_model("controller"))
    for folder in sorted(lab_logs.glob("Movement_*")):
        robot = read(folder).robot
        moment = arm.inverse(robot["target_q"], robot["target_qd"], robot["target_qdd"])
        error = np.abs(moment - robot["target_moment"])
        # q is printed to 1e-6 rad, so up to 0.5e-6 off, and three joints with up to 60 Nm/rad of gravity make 1e-4.
        assert error.max() < 1e-4, folder.name
