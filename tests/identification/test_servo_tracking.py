"""identify servo: known gains recovered from twin recordings, intervals that hold, and what logs cannot tell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.arm.drive import load_drive
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.gains import Gains, load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.errors import IdentificationError
from ur5_twin.identification import results, servo_result
from ur5_twin.identification.servo import fit_servo
from ur5_twin.identification.servo_nlse import fit_nlse
from ur5_twin.identification.servo_tracking import fit_tracking, is_standstill
from ur5_twin.recording.table import Recording, Table
from ur5_twin.twin import _loop_kernel as kernel
from ur5_twin.twin.closed_loop import ClosedLoop, Limits
from ur5_twin.twin.replay import ReplaySettings, replay

CONTROLLER = load_model("controller")
LAW = load_target_current_law()
BASE = load_gains("servo")
TICK = 0.008
POSE = np.array([0.2, -1.5, 1.4, -1.2, -1.0, 0.3])
TRUTH = replace(
    BASE, lag=np.array([0.3, 0.5, 0.4, 0.8, 0.6, 0.7]) * 1e-3, share=np.array([0.0, 0.2, -0.5, -1.0, 0.5, -2.0])
)


def targets(seconds: float, phase: float) -> Recording:
    """Every joint swings, three waves each, with the current that the controller expects."""
    t = np.arange(round(seconds / TICK)) * TICK
    q, qd, qdd = (np.zeros((len(t), 6)) for _ in range(3))
    for k, (amplitude, rate) in enumerate(((0.3, 0.7), (0.12, 2.1), (0.03, 5.3))):
        w = rate * np.linspace(0.9, 1.2, 6)
        angle = np.outer(t, w) + phase + k
        q += amplitude * np.sin(angle)
        qd += amplitude * w * np.cos(angle)
        qdd -= amplitude * w**2 * np.sin(angle)
    q += POSE
    current = LAW.current(Dynamics(CONTROLLER).inverse(q, qd, qdd), qd)
    columns = {"target_q": q, "target_qd": qd, "target_qdd": qdd, "actual_q": q, "actual_qd": qd}
    columns |= {"actual_current": current, "target_current": current}
    return Recording({"robot": Table("robot", t, columns)}, f"swings {phase:g}", "made")


def moved(gains: Gains, phase: float, noise: float, seconds: float = 30.0) -> Recording:
    """The same as an arm with those gains drives it, its encoders read with white noise."""
    recording = targets(seconds, phase)
    settings = ReplaySettings(CONTROLLER, CONTROLLER, gains, load_drive(), LAW)
    robot = replay(recording, settings).robot
    rng = np.random.default_rng(int(100 * phase))
    seen = {
        "actual_q": robot["sim_actual_q"] + rng.normal(scale=noise, size=robot["sim_actual_q"].shape),
        "actual_qd": robot["sim_actual_qd"],
    }
    return recording.with_table(recording.robot.with_columns(seen))


def pushed() -> Recording:
    """An arm with the base gains at standstill, joints 1 and 2 pushed for 20 s."""
    loop = ClosedLoop(CONTROLLER, CONTROLLER, BASE)
    loop.with_limits(Limits(force=np.inf))
    n = 2500
    target = np.stack([POSE, np.zeros(6), np.zeros(6)])
    loop.reset(POSE, np.zeros(6))
    dt = np.full(n, TICK)
    steps = loop.steps_of(dt)
    time = np.arange(steps.sum()) * TICK / steps[0]
    # Twists of the shoulder about joint 1 and of the upper arm about joint 2, slow ones and shakes.
    twist = 20.0 * np.sin(np.outer(time, [1.3, 2.1])) + 10.0 * np.sin(np.outer(time, [25.0, 21.0]))
    wrench = np.zeros((len(time), 2, 6))
    wrench[:, 0, 5] = twist[:, 0]
    wrench[:, 1, 3:5] = twist[:, 1:] * [np.sin(POSE[0]), -np.cos(POSE[0])]
    bodies = np.array([loop.body(f"{name}_link") for name in ("shoulder", "upper_arm")])
    pushes = kernel.Pushes(bodies, np.zeros((2, 3)), np.zeros(2, dtype=np.int64), wrench)
    trace, ending = loop.run(np.tile(target, (n + 1, 1, 1)), dt, pushes=pushes)
    assert ending.complete
    rows = slice(None, None, int(steps[0]))
    gravity = Dynamics(CONTROLLER).gravity(POSE) / LAW.torque_constant
    q = trace.q[rows]
    zero = np.zeros_like(q)
    columns = {
        "actual_q": q,
        "actual_qd": trace.qd[rows],
        # A loop without drives asks for torques.
        "actual_current": trace.current[rows] / LAW.torque_constant,
        "target_current": zero + gravity,
        "target_q": np.concatenate([q[:1], q[:-1]]),
        "target_qd": zero,
        "target_qdd": zero,
    }
    return Recording({"robot": Table("robot", np.arange(n) * TICK, columns)}, "pushed twin", "made")


def test_recovers_lag_and_share_and_its_intervals_hold() -> None:
    logs = [moved(TRUTH, phase, 1e-4) for phase in (0.3, 1.1)]
    found = fit_tracking(logs, BASE)
    assert found.told.all()
    # 0.1 mrad of noise on 7,000 rows at 0.3 rad/s leave 4 us of one standard deviation; five of that.
    assert np.allclose(found.gains.lag, TRUTH.lag, atol=2e-5)
    inside = [
        (low <= value <= high)
        for pairs, values in ((found.lag_interval, TRUTH.lag), (found.share_interval, TRUTH.share))
        for (low, high), value in zip(pairs, values, strict=True)
    ]
    # Twelve intervals of 95 %: fewer than ten hold once in fifty draws, and this is one draw.
    assert sum(inside) >= 10
    # And they are of use: none wider than the lag itself.
    assert (np.ptp(found.lag_interval, axis=1) < TRUTH.lag).all()


def test_recovers_the_gains_of_a_pushed_twin() -> None:
    fit = fit_servo([pushed()], CONTROLLER, LAW.torque_constant)
    assert fit.good[0, :2].all()
    # The fit takes the mass matrix' diagonal; of joints 1 and 2 the rest of a row is up to a quarter of it.
    for found, truth in zip(fit.kappas(), (BASE.kappa0, BASE.kappa1, BASE.kappai), strict=True):
        assert np.allclose(found[:2], truth[:2], rtol=0.25)
    assert (fit.kappa_half_widths()[0, :2] < 0.25 * BASE.kappa0[:2]).all()


def test_a_file_for_replay(tmp_path: Path) -> None:
    logs = [pushed(), *(moved(TRUTH, phase, 1e-5) for phase in (0.3, 1.1, 2.0))]
    servo = servo_result.fit(logs, BASE, CONTROLLER, LAW)
    checked = servo_result.held_out(logs, BASE, CONTROLLER, LAW, lambda done: None)
    assert [item.recording.source for item in checked] == [log.source for log in logs[1:]]
    # 0.01 mrad of noise is all that a servo of the right lag and share leaves, and gains near the truth some more.
    assert all((item.moving < 0.3 * item.lag).all() for item in checked)
    result = servo_result.servo_result(servo, checked, None, logs, "a test")
    results.write(result, tmp_path)
    gains = load_gains(tmp_path / "gains.toml")
    assert np.allclose(gains.lag, servo.gains.lag)
    assert np.allclose(gains.kappa0, servo.gains.kappa0)
    assert set(servo.origin["lag_ms"]) == {"tracking"}


def test_free_motion_cannot_tell_pd_gains() -> None:
    nlse = fit_nlse([moved(TRUTH, 0.3, 1e-5, seconds=16.0)])
    assert not nlse.told.any()
    # The cost is flat over five decades of gains, but for the 0.01 mrad of noise that the start is read with.
    assert (nlse.profile.max(axis=2) < 1.1).all()


def test_a_large_deviation_tells_pd_gains() -> None:
    recording = targets(16.0, 0.3)
    t, k0, k1 = recording.robot.time, 40.0, 9.0
    w = np.sqrt(k0 - 0.25 * k1**2)
    e = 0.01 * np.exp(-0.5 * k1 * t) * (np.cos(w * t) + 0.5 * k1 / w * np.sin(w * t))
    rng = np.random.default_rng(1)
    columns = {
        "actual_q": recording.robot["target_q"] + e[:, None] + rng.normal(scale=1e-5, size=(len(t), 6)),
        "actual_qd": recording.robot["target_qd"]
        + np.gradient(e, t)[:, None]
        + rng.normal(scale=1e-4, size=(len(t), 6)),
    }
    nlse = fit_nlse([recording.with_table(recording.robot.with_columns(columns))])
    assert nlse.told.all()
    # The start is read with 1 % of noise in the speed that the error makes within a tick.
    assert np.allclose(nlse.kappa[0], k0, rtol=0.05)
    assert np.allclose(nlse.kappa[1], k1, rtol=0.05)


def test_refuses_what_cannot_carry_it() -> None:
    log = targets(30.0, 0.3)
    short = targets(3.0, 0.3)
    with pytest.raises(IdentificationError, match="no joint's target moves for 5 s"):
        servo_result.fit([short], BASE, CONTROLLER, LAW)
    zero = np.zeros((len(log.robot), 6))
    still = {"target_qd": zero, "target_qdd": zero, "target_q": zero + POSE, "actual_q": zero + POSE, "actual_qd": zero}
    with pytest.raises(IdentificationError, match="no joint is pushed"):
        servo_result.fit([log.with_table(log.robot.with_columns(still))], BASE, CONTROLLER, LAW)
    table = log.robot
    without = {name: values for name, values in table.columns.items() if name != "target_current"}
    with pytest.raises(IdentificationError, match="no target_current"):
        is_standstill(log.with_table(replace(table, columns=without)))


def test_a_joint_that_rests_keeps_the_preset() -> None:
    log = moved(TRUTH, 0.3, 1e-5)
    resting = {name: log.robot[name].copy() for name in ("target_q", "target_qd", "target_qdd", "actual_q")}
    for name, values in resting.items():
        values[:, 5] = POSE[5] if name.endswith("_q") else 0.0
    servo = servo_result.fit([log.with_table(log.robot.with_columns(resting))], BASE, CONTROLLER, LAW)
    assert servo.origin["lag_ms"][5] == "preset servo"
    assert servo.gains.lag[5] == BASE.lag[5]
    assert servo.origin["lag_ms"][:5] == ("tracking",) * 5
