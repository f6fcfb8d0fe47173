"""``identify plant``: known numbers recovered from the twin's recordings, and what is refused or said to be unknown."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.arm.drive import drives_of, load_joint_drives
from ur5_twin.arm.parameters import load_model, load_tool
from ur5_twin.control.excitation import DRIVES as QUICK
from ur5_twin.control.excitation import PAYLOAD, Waves, excitation
from ur5_twin.control.gains import load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.errors import IdentificationError
from ur5_twin.identification import plant_check, plant_result, results
from ur5_twin.identification.body import Body, pseudo_inertia
from ur5_twin.identification.plant import PlantFit, fit_plant
from ur5_twin.identification.plant_solve import FIELDS
from ur5_twin.identification.plant_windows import motion
from ur5_twin.recording import read
from ur5_twin.recording.table import Recording, Table
from ur5_twin.sensing import Measuring, Signals, load_sensors
from ur5_twin.twin.cell import PERIOD, Cell, Setup
from ur5_twin.twin.closed_loop import Limits
from ur5_twin.twin.setup import carrying
from ur5_twin.twin.telemetry import Telemetry

PLANT, DRIVES = load_model("plant"), load_joint_drives()
#: What is known to hang there while the drives are sought, and what is sought itself.
LOAD = (2.2, np.array([0.19, 0.0, 0.05]), 0.002 * np.eye(3))
UNKNOWN = (4.4, np.array([0.19, 0.0, 0.05]), 0.004 * np.eye(3))
TRUTH = {name: getattr(DRIVES.friction, name) for name in tuple(FIELDS)[2:]} | {
    "torque_constant": DRIVES.torque_constant,
    "rotor_inertia": PLANT.rotor_inertia,
}


def recorded(load: tuple[float, np.ndarray, np.ndarray], waves: Waves) -> Recording:
    """120 s of the cell in the excitation, sensors without fault."""
    rows = excitation(120.0, waves, seed=41)
    setup = Setup(
        controller=carrying(load_model("controller"), *load),
        plant=carrying(PLANT, *load),
        gains=load_gains("servo"),
        law=load_target_current_law(),
        drives=DRIVES,
        limits=Limits(math.inf, math.inf, math.inf),
        q_start=rows[0, 0],
    )
    cell = Cell(setup)
    telemetry = Telemetry(setup, cell.geoms, load_sensors("ideal"), np.random.default_rng(0))
    for piece in cell.advance(rows[1:]):
        telemetry.observe(piece)
    return telemetry.recording("excitation")


@pytest.fixture(scope="module")
def recording() -> Recording:
    """With a load off the axis."""
    return recorded(LOAD, QUICK)


@pytest.fixture(scope="module")
def loaded() -> Recording:
    """With a load that nobody has weighed."""
    return recorded(UNKNOWN, PAYLOAD)


@pytest.fixture(scope="module")
def bare() -> Recording:
    """With nothing at the flange."""
    return recorded((0.0, np.zeros(3), np.zeros((3, 3))), PAYLOAD)


def noisy(recording: Recording, seed: int) -> Recording:
    """The same motion, read by the lab's sensors."""
    robot = recording.robot
    q, qd, qdd, wrench = (robot[name] for name in ("truth_q", "truth_qd", "truth_qdd", "truth_wrench"))
    sensors = Measuring(load_sensors("lab"), PLANT, np.random.default_rng(seed), period=PERIOD)
    seen = sensors.robot(Signals(robot.time, q, qd, qdd, robot["actual_current"], wrench), 0, 1)
    return recording.with_table(
        robot.with_columns({name: seen[name] for name in ("actual_q", "actual_qd", "actual_current")})
    )


def fitted(recording: Recording, **known: np.ndarray) -> PlantFit:
    return fit_plant([motion(recording, carrying(PLANT, *LOAD))], DRIVES, PLANT.rotor_inertia, known)


def part(recording: Recording, rows: slice) -> Recording:
    robot = recording.robot
    columns = {name: values[rows] for name, values in robot.columns.items()}
    return recording.with_table(Table("robot", robot.time[rows], columns))


def test_without_noise_nothing_is_biased(recording: Recording) -> None:
    fit = fitted(recording)
    # Half of what is aimed at with noise, so that noise has the other half.
    for name, share in {
        "torque_constant": 0.005,
        "rotor_inertia": 0.01,
        "coulomb_positive": 0.025,
        "coulomb_negative": 0.025,
        "viscous": 0.025,
    }.items():
        assert np.allclose(fit.values[name], TRUTH[name], rtol=share), name
    assert np.allclose(fit.values["load"][:3], TRUTH["load"][:3], rtol=0.05)
    # The small joints have none, and a hundredth of a Nm per Nm is a fifth of what the big ones have.
    assert (fit.values["load"][3:] < 0.01).all()
    assert fit.delay == 0.0
    assert np.allclose(fit.amplitude[1, 3:], DRIVES.ripple.amplitude[1, 3:], rtol=0.05)


def test_with_noise_the_intervals_hold(recording: Recording) -> None:
    fit = fitted(noisy(recording, 3))
    # Joint 4 is the quietest, 30 mA: the aims with a single recording.
    for name, share in {
        "torque_constant": 0.01,
        "rotor_inertia": 0.02,
        "coulomb_positive": 0.05,
        "coulomb_negative": 0.05,
        "viscous": 0.05,
    }.items():
        assert fit.values[name][3] == pytest.approx(TRUTH[name][3], rel=share), name
    held, told = 0, 0
    for name, truth in TRUTH.items():
        known = np.isfinite(fit.low[name])
        told += int(known.sum())
        held += int(((fit.low[name] <= truth) & (truth <= fit.high[name]))[known].sum())
    # Of some 36 numbers at 95 % fewer than 30 hold once in a thousand, were they independent.
    assert told >= 36
    assert held >= 30
    # Wider than the sensors' noise makes them they would hold always: of joint 1's inertia not more than 8 %.
    assert fit.high["rotor_inertia"][0] - fit.low["rotor_inertia"][0] < 2 * 0.08 * TRUTH["rotor_inertia"][0]


def sought(*recordings: Recording, bare: Recording | None = None) -> PlantFit:
    motions = [motion(recording, PLANT, payload=True) for recording in recordings]
    if bare is not None:
        motions.append(motion(bare, PLANT, payload=True).bare())
    return fit_plant(motions, DRIVES, PLANT.rotor_inertia)


def test_without_noise_an_unknown_payload_is_found(loaded: Recording) -> None:
    fit = sought(loaded)
    known = fit_plant([motion(loaded, carrying(PLANT, *UNKNOWN))], DRIVES, PLANT.rotor_inertia)
    assert fit.payload is not None
    assert fit.carried is not None
    # What the windows bias, 0.5 % of an inertia, goes partly into the links' masses, and what these then lack at the
    # wrist into the payload's place: 1 % of the mass, 2 mm, and 2 % of the moments about the flange.
    assert fit.carried.mass == pytest.approx(UNKNOWN[0], rel=0.01)
    np.testing.assert_allclose(fit.carried.center, UNKNOWN[1], atol=2e-3)
    about_flange = Body(*UNKNOWN).phi[4:]
    np.testing.assert_allclose(fit.carried.phi[4:], about_flange, atol=0.02 * about_flange.max())
    for name in ("torque_constant", "rotor_inertia", "coulomb_positive", "coulomb_negative", "viscous"):
        np.testing.assert_allclose(fit.values[name], known.values[name], rtol=0.02, err_msg=name)
    # Numbers that are shared are less certain than numbers that are known.
    wider = fit.high["torque_constant"] - fit.low["torque_constant"]
    assert (wider > known.high["torque_constant"] - known.low["torque_constant"]).all()


def test_with_noise_an_unknown_payload_has_its_interval(loaded: Recording) -> None:
    # Three draws of the noise are three logs of the same motion.
    fit = sought(*(noisy(loaded, seed) for seed in (1, 2, 3)))
    assert fit.payload is not None
    assert fit.carried is not None
    (mass, std), (center, center_std) = fit.payload.mass, fit.payload.center
    # Three standard deviations: one in a hundred of four numbers would be beyond.
    assert abs(mass - UNKNOWN[0]) < 3.0 * std
    # The arm's own masses are known to 5 %.
    assert std < 0.05 * UNKNOWN[0]
    assert (np.abs(center - UNKNOWN[1]) < 3.0 * center_std).all()
    assert np.linalg.eigvalsh(pseudo_inertia(fit.carried.phi))[0] > 0.0
    off = np.abs(fit.values["torque_constant"] - TRUTH["torque_constant"])
    assert (off < 1.5 * 0.5 * (fit.high["torque_constant"] - fit.low["torque_constant"])).all()


def test_a_log_without_the_payload_tells_more(loaded: Recording, bare: Recording) -> None:
    alone, beside = sought(noisy(loaded, 1)), sought(noisy(loaded, 1), bare=noisy(bare, 2))
    assert alone.payload is not None
    assert beside.payload is not None
    assert beside.payload.mass[1] < 0.6 * alone.payload.mass[1]
    assert abs(beside.payload.mass[0] - UNKNOWN[0]) < 3.0 * beside.payload.mass[1]


def test_nothing_on_the_flange_counts_as_nothing(bare: Recording) -> None:
    with_it = sought(noisy(bare, 5))
    assert with_it.carried is None
    assert any("cannot be told from none" in note for note in with_it.notes)
    without = fit_plant([motion(noisy(bare, 5), PLANT)], DRIVES, PLANT.rotor_inertia)
    np.testing.assert_array_equal(with_it.values["torque_constant"], without.values["torque_constant"])


def test_what_is_known_stays(recording: Recording) -> None:
    only_last = np.array([np.nan] * 5 + [0.2])
    fit = fitted(recording, rotor_inertia=only_last)
    assert fit.values["rotor_inertia"][5] == 0.2
    assert fit.known["rotor_inertia"].tolist() == [False] * 5 + [True]
    assert np.isnan(fit.low["rotor_inertia"][5])
    with pytest.raises(IdentificationError, match="torque_constant"):
        fitted(recording, torque_konstant=only_last)


def test_a_wrist_without_load_needs_its_inertia(recording: Recording) -> None:
    # The last joint turns nothing but itself: its current says J_r / k and no more.
    of = motion(recording, carrying(PLANT, *LOAD))
    link = of.link.copy()
    link[:, 5] = 0.0
    current = of.current - (of.link - link) / DRIVES.torque_constant
    fit = fit_plant([replace(of, link=link, current=current)], DRIVES, PLANT.rotor_inertia)
    assert fit.known["rotor_inertia"][5]
    assert any("joint 6: rotor_inertia is not told" in note for note in fit.notes)
    assert not fit.known["rotor_inertia"][:5].any()
    # With the inertia known the acceleration tells the torque constant; 2 % as for the inertia itself.
    assert fit.values["torque_constant"][5] == pytest.approx(TRUTH["torque_constant"][5], rel=0.02)


def test_a_late_current_is_found(recording: Recording) -> None:
    of = motion(recording, carrying(PLANT, *LOAD))
    # One row late, as if the current were read 8 ms after the motion.
    late = replace(of, current=np.concatenate([of.current[:1], of.current[:-1]]))
    assert fit_plant([late], DRIVES, PLANT.rotor_inertia).delay == pytest.approx(0.008)


@pytest.mark.parametrize("what", ["no motion", "one joint", "10 s"])
def test_too_little_motion_is_refused(recording: Recording, what: str) -> None:
    robot = recording.robot
    moving = {"no motion": [], "one joint": [2], "10 s": list(range(6))}[what]
    columns = {name: robot[name].copy() for name in ("actual_q", "actual_qd", "actual_current")}
    for j in range(6):
        if j not in moving:
            columns["actual_qd"][:, j] = 0.0
    made = recording.with_table(Table("robot", robot.time, columns))
    made = part(made, slice(0, 1250)) if what == "10 s" else made
    with pytest.raises(
        IdentificationError, match=r"too little motion in excitation: .*joint 1 \(\d+\.\d s\)"
    ) as refused:
        fitted(made)
    assert ("joint 3" in str(refused.value)) == (what != "one joint")


def test_one_direction_is_refused(recording: Recording) -> None:
    of = motion(recording, PLANT)
    forward = of.qd.copy()
    forward[:, 2] = np.abs(forward[:, 2])
    with pytest.raises(IdentificationError, match="joint 3 has one direction only"):
        fit_plant([replace(of, qd=forward)], DRIVES, PLANT.rotor_inertia)


def test_a_missing_signal_is_named(recording: Recording) -> None:
    robot = recording.robot
    made = recording.with_table(Table("robot", robot.time, {"actual_q": robot["actual_q"]}))
    with pytest.raises(IdentificationError, match="excitation: no actual_qd, actual_current"):
        motion(made, PLANT)


def test_a_payload_is_a_tool_for_the_twin(loaded: Recording, tmp_path: Path) -> None:
    fit = sought(noisy(loaded, 1))
    result = plant_result.plant_result(fit, [], PLANT, plant_result.links_of("plant"), DRIVES, [loaded], "command")
    results.write(result, tmp_path)
    tool = load_tool(str(tmp_path / "payload.toml"))
    assert tool is not None
    assert fit.carried is not None
    assert tool.mass == pytest.approx(fit.carried.mass, rel=1e-9)
    np.testing.assert_allclose(tool.center, fit.carried.center, atol=1e-9)
    # Balls have a size: a tenth of a millimetre at least.
    np.testing.assert_allclose(tool.inertia, fit.carried.inertia, atol=1e-6)
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert report["payload"]["mass_kg"] == pytest.approx(UNKNOWN[0], rel=0.1)
    assert any("beyond the tool the flange carries: mass" in finding for finding in report["findings"])


def test_the_files_are_what_the_twin_takes(recording: Recording, tmp_path: Path) -> None:
    fit = fitted(noisy(recording, 1))
    result = plant_result.plant_result(fit, [], PLANT, plant_result.links_of("plant"), DRIVES, [recording], "command")
    results.write(result, tmp_path)
    model = load_model(tmp_path / "plant.toml")
    # Six digits in the file.
    assert np.allclose(model.rotor_inertia, fit.values["rotor_inertia"], rtol=1e-5)
    assert model.links[1].mass == PLANT.links[1].mass
    drives = drives_of(model)
    assert np.allclose(drives.torque_constant, fit.values["torque_constant"], rtol=1e-5)
    assert np.allclose(drives.friction.viscous, fit.values["viscous"], rtol=1e-5)
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    interval = report["interval_95"]["torque_constant"][1]
    assert interval["low"] < fit.values["torque_constant"][1] < interval["high"]


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("mass=1", "'mass' is none of"),
        ("load.7=1", "joints 1 to 6"),
        ("load=1,2", "one number"),
        ("load.1=x", "no number"),
        ("viscous.2=-1", "cannot be -1"),
        ("torque_constant.2=0", "cannot be 0"),
    ],
)
def test_known_values_are_checked(word: str, said: str) -> None:
    with pytest.raises(IdentificationError, match=said):
        plant_check.known_values([word], tuple(FIELDS))


def test_known_values_are_read() -> None:
    found = plant_check.known_values(["rotor_inertia.6=0.2", "load=0,0,0,0,0,0.1"], tuple(FIELDS))
    assert found["rotor_inertia"][5] == 0.2
    assert np.isnan(found["rotor_inertia"][:5]).all()
    assert found["load"].tolist() == [0, 0, 0, 0, 0, 0.1]


def test_a_tool_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "bar.toml"
    path.write_text(
        '[bar]\ntitle = "a bar"\nsource = "scales"\nparts = [{ name = "end", shape = "sphere", mass_kg = 2.0, '
        "center_mm = [150.0, 0.0, 40.0], radius_mm = 30.0 }]\n",
        encoding="utf-8",
    )
    tool = load_tool(f"ati_gamma+{path}")
    assert tool is not None
    assert tool.mass == pytest.approx(2.46)
    assert tool.parts[-1].center[2] == pytest.approx(0.093)


@pytest.mark.parametrize("waves", [QUICK, PAYLOAD])
def test_speed_keeps_below_the_ripple_that_looks_still(waves: Waves) -> None:
    rows = excitation(120.0, waves, seed=41, period=0.002)
    # Order 404 passes at 125 Hz at 1.944 rad/s; the servo adds some hundredths.
    assert np.abs(rows[:, 1]).max() < 1.85
    assert not rows[[0, -1], 1:].any()
    # The rates are the position's derivatives: central differences, whose error is T^2 / 6 of the third derivative.
    assert np.abs(np.gradient(rows[:, 0], 0.002, axis=0) - rows[:, 1])[1:-1].max() < 5e-4
    assert np.abs(np.gradient(rows[:, 1], 0.002, axis=0) - rows[:, 2])[1:-1].max() < 1e-2


def test_real_logs_tell_the_rotors(lab_logs: Path) -> None:
    names = ("No4_Acc", "No5_Acc_slow_no_disturbance", "No6_Acc_slow_Verify_Model", "No9_Singularity_Free_NoDist")
    arm = load_model("plant", "xsens_mti")
    logs = [motion(read(lab_logs / f"Movement_{name}", repair=True), arm) for name in names]
    fit = fit_plant(logs, DRIVES, PLANT.rotor_inertia)
    # The controller's own inertias come from target_moment, these from currents and motion: two sources. Big joints
    # agree within 10 %: the half widths are 18, 4 and 2 %, and no law is exact.
    assert np.allclose(fit.values["rotor_inertia"][:3], PLANT.rotor_inertia[:3], rtol=0.1)
    assert fit.known["rotor_inertia"][5]
