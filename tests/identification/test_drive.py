"""The drives: known friction and ripple recovered, a causal prediction, and what the real logs' ripple is worth."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.arm.drive import LinearDrive, load_drive
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.held import commanded
from ur5_twin.drives import terms
from ur5_twin.errors import IdentificationError
from ur5_twin.identification import drive, thesis_drive
from ur5_twin.identification.drive_plant import PlantDrive, fit_plant
from ur5_twin.recording import read
from ur5_twin.recording.table import Recording, Table

CONSTANT = np.array([9.5, 11.0, 10.5, 8.0, 8.5, 9.0])
RIPPLE, PHASE = 1.4, 0.7
LOGS = (
    "No3_Acc",
    "No4_Acc",
    "No5_Acc_slow_no_disturbance",
    "No6_Acc_slow_Verify_Model",
    "No9_Singularity_Free_NoDist",
)


def made(seed: int = 1) -> terms.Ride:
    """Every joint swings for 60 s against 2 and 1.5 Nm of Coulomb friction and a ripple of order 404."""
    rng = np.random.default_rng(seed)
    t = np.arange(7500) * 0.008
    rate = rng.uniform(0.3, 0.6, 6)
    size = rng.uniform(0.5, 1.2, 6)
    q = size * np.sin(np.outer(t, rate))
    qd, qdd = size * rate * np.cos(np.outer(t, rate)), -size * rate**2 * np.sin(np.outer(t, rate))
    link = 8.0 * np.cos(q + 0.3) + 0.5 * qdd
    friction = np.where(qd > 0, 2.0, -1.5) + 3.0 * qd
    # As the law of fit_plant sees a ripple torque: 5 ms late, behind a lag of 2 ms.
    wave = np.exp(1j * (404 * (q - 0.005 * qd) + PHASE)) / (1.0 + 0.002j * 404 * qd)
    current = (link + qdd + friction + RIPPLE * wave.real) / CONSTANT + rng.normal(0.0, 0.02, q.shape)
    zero = np.zeros_like(q)
    return terms.Ride("made", t, link + qdd, link, qd, qdd, zero + 1.0, link / CONSTANT, q, zero, zero, current)


def first(of: terms.Ride, n: int) -> terms.Ride:
    return replace(of, **{f.name: getattr(of, f.name)[:n] for f in fields(of) if f.name != "source"})


def test_recovers_friction_and_ripple() -> None:
    plant = fit_plant([made()])
    # 7500 rows with 0.02 A of noise: 0.2 mA on a mean, some 2 mNm; friction, load and torque share rows, so 5 %.
    assert np.allclose(plant.torque_constant, CONSTANT, rtol=0.01)
    assert np.allclose(plant.coulomb_positive, 2.0, atol=0.1)
    assert np.allclose(plant.coulomb_negative, 1.5, atol=0.1)
    assert np.allclose(plant.viscous, 3.0, atol=0.2)
    # The slow rows are a third of all; four standard errors.
    assert (np.abs(plant.amplitude[1] - RIPPLE) < 4.0 * plant.amplitude_errors[1]).all()
    assert np.allclose(plant.phase[1], PHASE, atol=0.05)
    assert (plant.amplitude[0] < 0.1 * RIPPLE).all()
    assert (plant.stribeck <= 0.0).all()
    assert (plant.coulomb_positive + plant.stribeck >= 0.0).all()


def test_recovers_friction_that_grows_with_load_and_fades() -> None:
    rng = np.random.default_rng(7)
    t = np.arange(6000) * 0.008
    slow, fast = np.outer(t, np.linspace(0.11, 0.3, 6)), np.outer(t, np.linspace(0.7, 1.3, 6))
    qd = 0.4 * np.sin(fast) + 0.3 * np.sin(slow)
    angle = np.cumsum(qd, axis=0) * 0.008
    link = 15.0 * np.sin(np.outer(t, np.linspace(0.2, 0.9, 6)) + 1.0)
    six, none = np.ones(6), np.full((6, 6), np.nan)
    order, amplitude = np.outer([202.0, 404.0], six), np.outer([0.4, 0.8], six)
    truth = PlantDrive(
        10.0 * six, 5.0 * six, 4.0 * six, -2.0 * six, 0.05 * six, 0.08 * six, 9.0 * six,
        order, amplitude, np.outer([0.3, -1.2], six), none, np.full((2, 6), np.nan),
    )  # fmt: skip
    zero = np.zeros_like(qd)
    ride = terms.Ride("made", t, link, link, qd, zero, zero + 1.0, zero, angle, zero, zero, zero)
    fit = fit_plant([replace(ride, current=truth.current(ride) + rng.normal(scale=0.05, size=qd.shape))])
    # 0.05 A over 6000 rows of 10 Nm/A leave some 0.02 Nm per coefficient; five of that.
    assert np.allclose(fit.torque_constant, 10.0, rtol=0.01)
    assert np.allclose(fit.coulomb_positive, 5.0, atol=0.1)
    assert np.allclose(fit.coulomb_negative, 4.0, atol=0.1)
    assert np.allclose(fit.load, 0.08, atol=0.01)
    assert np.allclose(fit.viscous, 9.0, atol=0.3)
    # Few rows are slow enough for friction to fade: five times as much, on the speeds that are tried.
    assert np.allclose(fit.stribeck, -2.0, atol=0.5)
    assert np.allclose(fit.amplitude, amplitude, atol=0.1)


def test_contacts_are_taken_off_the_torque(made_recording: Recording) -> None:
    model = load_model("plant")
    contact = np.random.default_rng(5).normal(size=(len(made_recording.robot), 6))
    free, pushed = terms.ride(made_recording, model), terms.ride(made_recording, model, tau_ext=contact)
    # A push that drives the joint spares the motor that much.
    assert np.allclose(free.torque - pushed.torque, contact, atol=1e-9)
    assert np.allclose(free.link - pushed.link, contact, atol=1e-9)


def test_what_passes_and_what_is_kept_add_up() -> None:
    rng = np.random.default_rng(3)
    x, a = rng.normal(size=(200, 2)), rng.uniform(0.0, 1.0, 200)
    # Rounding of 200 sums.
    assert np.allclose(terms.kept(x, a) + terms.passed(x, a), x, atol=1e-12)


def test_friction_of_a_joint_at_rest_turns_where_it_is_moved() -> None:
    of = first(made(), 60)
    still = np.zeros_like(of.qd)
    angle = np.zeros_like(of.angle)
    # A way of some STICKING_WAY forth, then back.
    angle[10:30, 1], angle[30:, 1] = 10.0 * terms.STICKING_WAY, 7.0 * terms.STICKING_WAY
    z = terms.sticking_column(replace(of, angle=angle, qd=still), 1)[:, 0]
    np.testing.assert_allclose(z[[9, 10, 29]], [0.0, 1.0 - np.exp(-10.0), 1.0 - np.exp(-10.0)], rtol=1e-12)
    np.testing.assert_allclose(z[30:], np.exp(-3.0) * z[29] - (1.0 - np.exp(-3.0)), rtol=1e-12)
    # None while the target moves, and none is left from before.
    moves = still.copy()
    moves[20:40, 1] = 0.5
    z = terms.sticking_column(replace(of, angle=angle, qd=moves), 1)[:, 0]
    assert not z[20:].any()


def test_the_servo_holds_where_the_move_ends() -> None:
    """The last row of a braking joint tells its end, and at rest the published target does not count."""
    q = np.zeros((4, 6))
    q[:, 0] = [0.9, 0.97, 0.9871, 0.9872]
    qd, qdd = np.zeros((4, 6)), np.zeros((4, 6))
    qd[:2, 0], qdd[:2, 0] = [1.0, 0.6], -6.0
    held = commanded(np.stack([q, qd, qdd], axis=1))[:, 0]
    assert np.allclose(held[:2], q[:2])
    # 0.97 + 0.6^2 / 12
    assert np.allclose(held[2:, 0], 1.0)
    assert np.all(held[:, 1:] == 0.0)


def test_a_prediction_does_not_look_ahead() -> None:
    of = made()
    for candidates in (drive.FREE, drive.FOLLOWING):
        fit = drive.fit_drive([made(2)], candidates, CONSTANT)
        whole, part = fit.current(of), fit.current(first(of, 3000))
        # The same sums; matrix products of other lengths may round differently.
        assert np.allclose(whole[:3000], part, atol=1e-9)


def test_a_fit_on_another_ride_predicts_to_the_noise() -> None:
    fit = drive.fit_drive([made(2), made(3)], torque_constant=CONSTANT)
    error = np.abs(fit.current(made()) - made().current)[50:]
    # 0.016 A is the mean of |noise|; penalties, other delays than the made ride's and reversals add as much
    # again. The big joints' shapes look for other orders.
    assert (error[:, 3:].mean(axis=0) < 0.05).all()


def test_names_a_joint_that_never_moves() -> None:
    of = made()
    still = replace(of, qd=np.where(np.arange(6) == 2, 0.0, of.qd))
    with pytest.raises(IdentificationError, match="joint 3"):
        drive.fit_drive([still])
    with pytest.raises(IdentificationError, match="joint 3"):
        fit_plant([still])


def test_real_logs_left_out(lab_logs: Path) -> None:
    recordings = [read(lab_logs / f"Movement_{name}", repair=True) for name in LOGS]
    rides = [terms.ride(recording, load_model("plant", "xsens_mti")) for recording in recordings]
    study = drive.study(recordings, rides, load_model("c", "xsens_mti"), load_drive("thesis"))
    small = [0, 3, 4, 5]
    for free, following, tared, two_step, printed in zip(
        study.free, study.following, study.tared, study.two_step, study.printed, strict=True
    ):
        # The aim: 0.6 of the controller's own error over the whole log, for each joint and each log left out. All reach
        # it in the chosen form once the current of the first 80 ms tells what the joints remember.
        assert (tared.ratio <= 0.6).all(), tared.source
        assert (free.ratio[small] <= 0.6).all(), free.source
        # Joint 1's and the small joints' friction is known to less than two thirds of the controller's error in motion.
        assert (free.moving[small] < 0.66 * free.own_moving[small]).all(), free.source
        # Before No3's first move nothing else tells what joint 2's servo holds.
        assert (following.ratio <= 0.6).all() or following.source.endswith("No3_Acc"), following.source
        # Both are below the thesis' map, as printed and by its method on the same logs, on every joint.
        for other in (two_step, printed):
            assert (free.ratio < other.ratio).all(), free.source
    assert [candidate.shape.servo for candidate in study.candidates][1:3] == [True, True]


def test_the_two_step_method_finds_its_own_law() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(5000) * 0.008
    rate = rng.uniform(0.4, 1.1, 6)
    q = np.array([0.0, -1.2, 0.8, -0.5, 0.4, 0.3]) + 0.9 * np.sin(np.outer(t, rate))
    qd, qdd = 0.9 * rate * np.cos(np.outer(t, rate)), -0.9 * rate**2 * np.sin(np.outer(t, rate))
    links = load_model("plant", "ati_gamma")
    truth = LinearDrive(
        "made", "", CONSTANT, np.array([0.5, -1.0, 0.3, 0.1, 0.0, 0.0]), np.full(6, 2.0), np.full(6, 1.5), 0.02
    )
    columns = {"target_q": q, "target_qd": qd, "target_qdd": qdd, "actual_current": np.zeros_like(q)}
    recording = Recording({"robot": Table("robot", t, columns)}, "made", "test")
    columns["actual_current"] = thesis_drive.current(truth, recording, links)
    fit = thesis_drive.fit_two_step([recording], links).drive
    # The first step has no offset, so what it calls friction is off by some of that where the offset is not small.
    assert np.allclose(fit.torque_constant[3:], truth.torque_constant[3:], rtol=0.05)
    assert np.allclose(fit.coulomb[4:], 2.0, rtol=1e-6)
    predicted = thesis_drive.current(fit, recording, links)
    assert (np.abs(predicted - columns["actual_current"]).mean(axis=0)[4:] < 1e-9).all()


def test_before_the_first_move_nothing_is_known_of_the_servo(lab_logs: Path) -> None:
    recording = read(lab_logs / "Movement_No3_Acc", repair=True)
    ride = terms.ride(recording, load_model("plant"))
    first_move = np.flatnonzero(recording.robot["target_qd"].any(axis=1))[0]
    # It rests for 2.5 s, while the arm creeps by 0.04 mrad.
    assert recording.robot.time[first_move] > 2.0
    assert not ride.error[:first_move].any()
    assert ride.error[first_move:].any()


def test_ripple_of_real_logs_is_the_gears(lab_logs: Path) -> None:
    """Joint 4's and 6's current unexplained by friction falls by half when the angle's ripple is known."""
    model = load_model("plant", "xsens_mti")
    rides = [terms.ride(read(lab_logs / f"Movement_{name}", repair=True), model) for name in LOGS[:3]]
    smooth = [candidate._replace(shape=candidate.shape._replace(orders=())) for candidate in drive.FREE]
    errors = []
    for candidates in (drive.FREE, smooth):
        fit = drive.fit_drive(rides[:2], candidates)
        errors.append(np.abs(fit.current(rides[2]) - rides[2].current).mean(axis=0))
    # Fits on two short logs; the benchmark's, on four, are three times better with ripple than without.
    assert (errors[0][[3, 5]] < 0.5 * errors[1][[3, 5]]).all()
