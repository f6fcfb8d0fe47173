"""The closed loop with drives, friction and pushes: the truth it writes, against the equations of motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ur5_twin.arm import kinematics
from ur5_twin.arm.drive import NO_RIPPLE, load_joint_drives
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.friction import FRICTIONLESS
from ur5_twin.arm.parameters import ArmModel, load_model
from ur5_twin.control.gains import Gains, load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.control.trajectory import movej, rest
from ur5_twin.twin import _loop_kernel as kernel
from ur5_twin.twin.closed_loop import ClosedLoop, Limits

TICK = 0.008
START = np.array([2.18, -2.135, -1.745, 0.276, -6.02, 0.0])
GOAL = START + np.array([0.5, 0.3, -0.4, 0.5, 0.3, 0.6])


@pytest.fixture(scope="module")
def plant() -> ArmModel:
    return load_model("plant", "ati_gamma")


def closed_loop(plant: ArmModel, **options) -> ClosedLoop:
    options = {"drives": load_joint_drives(), "law": load_target_current_law(), "obstacles": (), **options}
    return ClosedLoop(load_model("controller"), plant, options.pop("gains", load_gains("servo")), **options)


def motion() -> np.ndarray:
    """(n, 3, 6): rest, a move, rest."""
    return np.concatenate(
        [
            rest(START, seconds=0.5, period=TICK),
            movej(START, GOAL, speed=1.0, acceleration=1.4, period=TICK),
            rest(GOAL, seconds=2.0, period=TICK),
        ]
    )


def push(loop: ClosedLoop, body: str, wrench: np.ndarray, point: np.ndarray | None = None, turning: int = 0):
    at = np.zeros(3) if point is None else point
    return kernel.Pushes(np.array([loop.body(body)]), at[None], np.array([turning]), wrench[:, None])


def half_sine(rows: int, begin: float, end: float, peak: np.ndarray) -> np.ndarray:
    t = np.arange(rows) * 0.002
    return np.sin(np.pi * np.clip((t - begin) / (end - begin), 0.0, 1.0))[:, None] * peak


def run(loop: ClosedLoop, targets: np.ndarray, **options) -> kernel.Trace:
    loop.reset(targets[0, 0], targets[0, 1])
    trace, ending = loop.run(np.concatenate([targets, targets[-1:]]), np.full(len(targets), TICK), **options)
    assert ending.complete
    return trace


def test_the_equations_of_motion_close_in_motion_under_a_push(plant: ArmModel) -> None:
    loop = closed_loop(plant)
    targets = motion()
    rows = 4 * len(targets)
    wrench = half_sine(rows, 1.0, 1.6, np.array([40.0, -30.0, 20.0, 2.0, 1.0, -1.0]))
    trace = run(loop, targets, pushes=push(loop, "tool", wrench, np.array([0.01, 0.02, 0.05])))
    needed = Dynamics(plant).inverse(trace.q, trace.qd, trace.qdd)
    given = trace.motor_torque - trace.friction_torque + trace.tau_ext
    # The engine takes Coriolis' part with a velocity half a step (1 ms) old: below a tenth of a percent here.
    assert (np.abs(needed - given).max(axis=0) < 1e-3 * np.abs(given).max(axis=0)).all()


def test_the_push_is_the_truth_s_wrench_and_joint_torque(plant: ArmModel) -> None:
    loop = closed_loop(plant)
    targets = motion()
    peak = np.array([40.0, -30.0, 20.0, 2.0, 1.0, -1.0])
    wrench = half_sine(4 * len(targets), 0.4, 2.2, peak)
    point = np.array([0.01, 0.02, 0.05])
    trace = run(loop, targets, pushes=push(loop, "tool", wrench, point))
    np.testing.assert_allclose(trace.wrench[:, :3], wrench[:, :3], atol=1e-12)
    lever = kinematics.forward(plant, trace.q)[:, :3, :3] @ point
    about_flange = wrench[:, 3:] + np.cross(lever, wrench[:, :3])
    # The point turns with the body and is taken where it was a step ago: 2 ms at up to 1.5 rad/s, 55 mm, 54 N.
    np.testing.assert_allclose(trace.wrench[:, 3:], about_flange, atol=0.012)
    J = kinematics.jacobian(plant, trace.q)
    np.testing.assert_allclose(np.einsum("nij,ni->nj", J, trace.wrench), trace.tau_ext, atol=1e-9)
    np.testing.assert_array_equal(trace.tool_wrench, trace.wrench)


def test_a_push_on_a_link_reaches_the_joints_before_it_only(plant: ArmModel) -> None:
    loop = closed_loop(plant)
    targets = rest(START, seconds=1.0, period=TICK)
    point = np.array([0.1, 0.0, 0.05])
    wrench = np.tile([0.0, 30.0, -20.0, 0.0, 0.0, 0.0], (4 * len(targets), 1))
    trace = run(loop, targets, pushes=push(loop, "forearm_link", wrench, point))
    np.testing.assert_array_equal(trace.wrench, 0.0)
    np.testing.assert_array_equal(trace.tau_ext[:, 3:], 0.0)
    J = kinematics.point_jacobian(plant, trace.q, 3, point)
    # As above, at rest: rounding, and the servo's milliradian.
    np.testing.assert_allclose(trace.tau_ext, np.einsum("nij,i->nj", J, wrench[0]), atol=0.01)


def test_a_turning_push_turns(plant: ArmModel) -> None:
    loop = closed_loop(plant)
    targets = motion()
    wrench = np.tile([10.0, 0.0, 0.0, 0.0, 0.5, 0.0], (4 * len(targets), 1))
    trace = run(loop, targets, pushes=push(loop, "tool", wrench, turning=1))
    R = kinematics.forward(plant, trace.q)[:, :3, :3]
    # The orientation is a step old: 2 ms at 1.5 rad/s of 10 N.
    np.testing.assert_allclose(trace.wrench[:, :3], R @ wrench[0, :3], atol=0.04)


def test_energy_is_what_motors_friction_and_push_put_in(plant: ArmModel) -> None:
    loop = closed_loop(plant)
    targets = motion()
    wrench = half_sine(4 * len(targets), 0.6, 1.6, np.array([20.0, -30.0, 10.0, 0.0, 0.0, 1.0]))
    trace = run(loop, targets, pushes=push(loop, "wrist_3_link", wrench))
    dynamics = Dynamics(plant)
    energy = dynamics.kinetic_energy(trace.q, trace.qd) + dynamics.potential_energy(trace.q)
    power = np.einsum("nj,nj->n", trace.qd, trace.motor_torque - trace.friction_torque + trace.tau_ext)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(trace.time))])
    exchanged = np.abs(np.diff(work)).sum()
    # The trapezoid rule over 2 ms, with torques that step where friction reverses.
    assert np.abs(energy - energy[0] - work).max() < 2e-3 * exchanged


def test_without_friction_and_push_energy_is_conserved() -> None:
    """An arm that nothing holds against gravity: motors of no torque, no friction, falling and swinging."""
    plant = load_model("plant")
    limp = replace(plant, limits=replace(plant.limits, torque=np.full(6, 1e-9)))
    # Away from the joints' ends, whose stops take energy: joint 2 falls to its own after 1.2 s.
    targets = rest(START + np.array([0.0, 0.0, 0.0, 0.0, 5.0, 0.0]), seconds=1.1, period=TICK)
    dynamics = Dynamics(plant)
    lost = []
    for substep in (0.002, 0.001):
        loop = ClosedLoop(load_model("controller"), limp, load_gains("thesis_c"), substep)
        trace = run(loop, targets)
        kinetic = dynamics.kinetic_energy(trace.q, trace.qd)
        lost.append(np.ptp(kinetic + dynamics.potential_energy(trace.q)))
        assert kinetic.max() > 60.0
    # Up to 5 rad/s; the engine takes Coriolis' part half a step late, an error of first order in the step.
    assert lost[0] < 2e-3 * kinetic.max()
    assert lost[0] == pytest.approx(2 * lost[1], rel=0.05)


def test_a_stuck_joint_does_not_creep(plant: ArmModel) -> None:
    """Without position gains only friction holds against a push below its level: it yields once and then stays."""
    controller = plant
    limp = Gains("limp", "test", np.zeros(6), np.zeros(6))
    drives = replace(load_joint_drives(), torque_constant=np.ones(6), offset=np.zeros(6), ripple=NO_RIPPLE)
    drives = replace(drives, friction=replace(drives.friction, stribeck=np.zeros(6)))
    loop = ClosedLoop(controller, plant, limp, drives=drives)
    targets = rest(START, seconds=10.0, period=TICK)
    wrench = np.tile([0.0, 0.0, -4.0, 0.0, 0.0, 0.0], (4 * len(targets), 1))
    loop.reset(START, np.zeros(6))
    trace, _ = loop.run(
        np.concatenate([targets, targets[-1:]]), np.full(len(targets), TICK), pushes=push(loop, "wrist_3_link", wrench)
    )
    moved = trace.q - START
    level = drives.friction.coulomb_positive
    pushed = np.abs(trace.tau_ext[0]) > 0.1
    assert pushed[1:4].all()
    assert (np.abs(trace.tau_ext[0]) < 0.9 * level).all()
    assert (np.abs(moved[-1]) <= drives.friction.presliding).all()
    late = trace.time > 5.0
    assert np.ptp(moved[late], axis=0).max() < 1e-9


def test_friction_is_what_the_law_says_at_speed(plant: ArmModel) -> None:
    drives = replace(load_joint_drives(), ripple=NO_RIPPLE)
    loop = closed_loop(plant, drives=drives)
    trace = run(loop, motion())
    friction = drives.friction
    cruising = (trace.time > 1.26) & (trace.time < 1.3)
    link = trace.motor_torque - trace.friction_torque - plant.rotor_inertia * trace.qdd
    expected = friction.sliding(trace.qd, link)
    # The link's torque is that of the step before.
    np.testing.assert_allclose(trace.friction_torque[cruising], expected[cruising], rtol=2e-3)


def test_currents_and_torques_belong_together(plant: ArmModel) -> None:
    loop = closed_loop(plant)
    drives = load_joint_drives()
    trace = run(loop, motion())
    np.testing.assert_allclose(
        trace.motor_torque,
        drives.torque_constant * trace.current + drives.offset - drives.ripple.torque(trace.q),
        rtol=1e-12,
        atol=1e-9,
    )


def test_motors_have_limits(plant: ArmModel) -> None:
    loop = closed_loop(plant)
    targets = rest(START, seconds=0.5, period=TICK)
    wrench = np.tile([0.0, 0.0, -900.0, 0.0, 0.0, 0.0], (4 * len(targets), 1))
    loop.reset(START, np.zeros(6))
    trace, _ = loop.run(
        np.concatenate([targets, targets[-1:]]), np.full(len(targets), TICK), pushes=push(loop, "tool", wrench)
    )
    drives = load_joint_drives()
    torque = drives.torque_constant * trace.current + drives.offset
    assert (np.abs(torque) <= plant.limits.torque * (1 + 1e-12)).all()
    np.testing.assert_allclose(np.abs(torque).max(axis=0)[:3].max(), 150.0, rtol=1e-12)
    needed = Dynamics(plant).inverse(trace.q, trace.qd, trace.qdd)
    given = trace.motor_torque - trace.friction_torque + trace.tau_ext
    # The truth is what acted, at the limit too: Coriolis part is half a step old, at up to 500 Nm and 8 rad/s.
    assert np.abs(needed - given).max() < 0.01 * np.abs(given).max()


def test_a_push_of_60_newtons_moves_no_joint_far_and_the_error_goes(plant: ArmModel) -> None:
    """As the lab's logs have it: less than a milliradian, and back under the lasting push (integral action)."""
    loop = closed_loop(plant)
    targets = rest(START, seconds=8.0, period=TICK)
    rows = 4 * len(targets)
    ramp = np.clip((np.arange(rows) * 0.002 - 0.5) / 0.5, 0.0, 1.0)[:, None]
    trace = run(loop, targets, pushes=push(loop, "tool", ramp * np.array([0.0, -60.0, 0.0, 0.0, 0.0, 0.0])))
    error = np.abs(trace.q - START)
    assert error.max() < 1e-3
    assert error[-1].max() < 5e-5


@pytest.mark.parametrize(
    ("limits", "why", "said"),
    [
        (Limits(deviation=1e-5), kernel.DEVIATION, "away from its target"),
        (Limits(speed=0.05), kernel.SPEED, "turns faster"),
        (Limits(force=20.0), kernel.FORCE, "exceeds 20 N"),
    ],
)
def test_limits_end_a_run_with_a_reason(plant: ArmModel, limits: Limits, why: int, said: str) -> None:
    loop = closed_loop(plant, limits=limits)
    targets = motion()
    wrench = half_sine(4 * len(targets), 0.2, 2.0, np.array([0.0, -120.0, 0.0, 0.0, 0.0, 0.0]))
    loop.reset(START, np.zeros(6))
    trace, ending = loop.run(
        np.concatenate([targets, targets[-1:]]), np.full(len(targets), TICK), pushes=push(loop, "tool", wrench)
    )
    assert ending.why == why
    assert said in loop.explain(ending)
    assert len(trace.time) == 4 * ending.ticks < 4 * len(targets)


def test_one_call_or_many_is_the_same_motion(plant: ArmModel) -> None:
    targets = motion()
    through = np.concatenate([targets, targets[-1:]])
    whole = run(closed_loop(plant), targets)
    loop = closed_loop(plant)
    loop.reset(START, np.zeros(6))
    pieces = []
    for k in range(0, len(targets), 7):
        n = min(7, len(targets) - k)
        pieces.append(loop.run(through[k : k + n + 1], np.full(n, TICK))[0].q)
    np.testing.assert_array_equal(np.concatenate(pieces), whole.q)


def test_ideal_drives_without_friction_are_the_thesis_loop() -> None:
    controller = load_model("controller")
    drives = replace(
        load_joint_drives(),
        friction=FRICTIONLESS,
        torque_constant=np.ones(6),
        offset=np.zeros(6),
        ripple=NO_RIPPLE,
    )
    law = replace(
        load_target_current_law(),
        torque_constant=np.ones(6),
        load=np.zeros(6),
        viscous_driving=np.zeros(6),
        viscous_backdriven=np.zeros(6),
    )
    gains = load_gains("thesis_c")
    plain = run(ClosedLoop(controller, controller, gains), motion())
    same = run(ClosedLoop(controller, controller, gains, drives=drives, law=law), motion())
    np.testing.assert_array_equal(plain.q, same.q)
