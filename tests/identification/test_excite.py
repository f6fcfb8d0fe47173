"""Exciting motions: what they tell is what a fit would find, limits hold, files are read back and run."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ur5_twin import cli
from ur5_twin.arm.drive import JointDrives, load_joint_drives
from ur5_twin.arm.parameters import ArmModel, load_model, load_tool
from ur5_twin.control.gains import load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.control.waypoints import read_waypoints
from ur5_twin.errors import IdentificationError
from ur5_twin.identification import excite, excite_trial, results
from ur5_twin.identification.excitation import Question, _servo_error
from ur5_twin.identification.workspace import START, Workspace, with_weight
from ur5_twin.scenario import load_scenario
from ur5_twin.sensing import load_sensors
from ur5_twin.twin.scenario_run import ScenarioRun

OPEN = np.array([[-np.inf, np.inf]] * 3)
#: Before, to the right and to the left of the arm's start, 0.9 m over the table.
BOX = np.array([[-0.2, 0.9], [-0.6, 0.6], [0.05, 0.9]])


def request(**changes: Any) -> excite.Request:
    plain = excite.Request(
        purpose="drive",
        format="waypoints",
        duration=24.0,
        plant="plant",
        tool="none",
        payload="none",
        weight=None,
        q_start=START,
        reach=2.4,
        speed=1.5,
        acceleration=4.0,
        box=OPEN,
        height=0.05,
        clearance=0.01,
        seed=0,
    )
    return replace(plain, **changes)


def question(purpose: str, plant: ArmModel | None = None, drives: JointDrives | None = None) -> Question:
    return Question(
        purpose,
        plant or load_model("plant"),
        load_model("controller"),
        drives or load_joint_drives(),
        load_target_current_law(),
        load_gains("servo"),
        load_sensors("lab"),
    )


def swinging(seconds: float = 40.0) -> np.ndarray:
    """(n, 3, 6) rows in which every joint swings at its own pace."""
    t, rate = np.arange(round(seconds / 0.008)) * 0.008, np.array([0.9, 0.7, 1.1, 1.3, 0.8, 1.6])
    q = START + 0.6 * np.sin(np.outer(t, rate))
    return np.stack([q, 0.6 * rate * np.cos(np.outer(t, rate)), -0.6 * rate**2 * np.sin(np.outer(t, rate))], axis=1)


@pytest.fixture(scope="module")
def found() -> excite.Excitation:
    return excite.excite(request(), "ur5-twin identify excite", exchanges=150)


@pytest.mark.parametrize(("column", "name"), [(0, "torque_constant"), (6, "rotor_inertia")])
def test_columns_are_derivatives_of_the_current(column: int, name: str) -> None:
    drives, plant, step = load_joint_drives(), load_model("plant", "ati_gamma"), 1e-5
    asked = question("plant", plant)
    of = asked.ride(swinging(4.0), 0.008)
    scale = np.array([p.scale for p in asked.parameters if p.name == name])
    if name == "torque_constant":
        other = question("plant", plant, replace(drives, torque_constant=drives.torque_constant + step * scale))
    else:
        other = question("plant", replace(plant, rotor_inertia=plant.rotor_inertia + step * scale))
    slope = (other.current(other.ride(swinging(4.0), 0.008)) - asked.current(of)) / step
    # One-sided: 1/k has a second derivative, 1e-5 of the first.
    np.testing.assert_allclose(asked.columns(of)[0][:, :, column], slope, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("k", [0, 1, 3, 4, 5, 9])
def test_the_payloads_columns_are_a_bodys(k: int) -> None:
    """A body's torque by ``Dynamics`` of an arm that carries it, against the columns times its ten numbers."""
    asked = question("payload")
    rows = swinging(4.0)
    of = asked.ride(rows, 0.008)
    moved = np.zeros(3)
    if 1 <= k <= 3:
        moved[k - 1] = 0.07
    tensor = np.diag([0.011, 0.013, 0.009])
    if k in (4, 5, 9):
        tensor = tensor + {4: np.diag([0.002, 0, 0]), 5: 0.003 * np.ones((3, 3)), 9: np.diag([0, 0, 0.004])}[k]
    tool = load_tool("ati_gamma")
    assert tool is not None
    carrying = load_model("plant").with_tool(replace(tool, mass=1.3, center=moved, inertia=tensor))
    other = question("payload", carrying)
    numbers = np.array([p.value / p.scale for p in other.parameters])
    carried = np.einsum("njk,k->nj", asked.columns(of)[1], numbers)
    slides = np.abs(of.qd) > 0.01
    k_t, load = load_joint_drives().torque_constant, load_joint_drives().friction.load
    torque = (other.ride(rows, 0.008).link - of.link) * slides / k_t
    # What the load rubs is there as well, by the sign of what the bare arm bears.
    torque *= 1.0 + load * np.sign(of.qd) * np.sign(of.link)
    np.testing.assert_allclose(carried, torque, atol=1e-9)


def test_a_fit_finds_what_was_changed() -> None:
    """A log made with another torque constant and viscous friction, without noise."""
    drives = load_joint_drives()
    friction = replace(drives.friction, viscous=1.002 * drives.friction.viscous)
    changed = replace(drives, torque_constant=1.001 * drives.torque_constant, friction=friction)
    asked, other = question("drive"), question("drive", drives=changed)
    of = asked.ride(swinging(), 0.008)
    log = replace(of, current=other.current(of))
    error = {p.label: step for p, step in zip(asked.parameters, asked.fit(log), strict=True)}
    for j in range(5):
        # Second order in the change: a thousandth of a thousandth, and as much again from the other parameters.
        assert error[f"joint {j + 1} torque_constant"] == pytest.approx(1e-3 * drives.torque_constant[j], rel=0.02)
        assert error[f"joint {j + 1} viscous"] == pytest.approx(2e-3 * drives.friction.viscous[j], rel=0.02)


def test_information_adds_up_and_errors_fall_with_its_root() -> None:
    asked = question("drive")
    told = asked.information(asked.ride(swinging(), 0.008))
    once, four = asked.errors(told), asked.errors(told + told.times(3.0))
    known = np.isfinite(once) & np.isfinite(four)
    assert known.sum() > 30
    # Joint 6 bears nothing, so of its load "unknown to a thousand times its size" counts in the last percent.
    np.testing.assert_allclose(four[known], once[known] / 2.0, rtol=1e-2)


def test_the_servos_error_is_that_of_its_loop() -> None:
    gains, step, t = load_gains("servo"), 0.002, np.arange(500) * 0.002
    lacking = np.where(t < 0.3, 2.0, -1.0)

    def slope(time: float, x: np.ndarray) -> np.ndarray:
        u = lacking[min(int(time / step + 1e-9), len(t) - 1)]
        return np.array([x[1], -gains.kappa0[0] * x[0] - gains.kappa1[0] * x[1] - gains.kappai[0] * x[2] - u, x[0]])

    solved = solve_ivp(slope, (0.0, t[-1]), np.zeros(3), t_eval=t, max_step=step / 4, rtol=1e-8, atol=1e-12)
    e, _, integral = _servo_error(lacking, gains, 0, step)
    # The solver steps over the jump at 0.3 s by a quarter of a step.
    np.testing.assert_allclose(e, solved.y[0], atol=0.01 * np.abs(solved.y[0]).max())
    np.testing.assert_allclose(integral, solved.y[2], atol=0.01 * np.abs(solved.y[2]).max())


def test_joint_6_needs_a_weight_off_its_axis() -> None:
    """Its current tells torque constant, friction and rotor inertia only over each other."""
    rows = swinging()
    carrying = with_weight(load_model("plant"), 1.5, np.array([0.06, 0.0, 0.05]), seen=False)
    bare, loaded = question("plant"), question("plant", carrying)
    number = next(i for i, p in enumerate(bare.parameters) if p.label == "joint 6 torque_constant")
    unknown, known = (asked.errors(asked.information(asked.ride(rows, 0.008)))[number] for asked in (bare, loaded))
    assert np.isnan(unknown)
    assert known < 0.2 * bare.parameters[number].value


@pytest.mark.parametrize(("seed", "format"), [(1, "waypoints"), (2, "servoj"), (3, "servoj")])
def test_limits_hold_and_the_files_run(seed: int, format: str, tmp_path: Path) -> None:
    asked = request(seed=seed, format=format, box=BOX, speed=1.2, acceleration=3.0, tool="ati_gamma", duration=16.0)
    one = excite.excite(asked, "x", exchanges=20)
    results.write(excite.excite_result(one, "x"), tmp_path)
    (tmp_path / one.sent[0]).write_text(one.sent[1], encoding="utf-8")
    run = ScenarioRun(load_scenario(tmp_path / excite_trial.SCENARIO))
    planned = run.reference.rows
    np.testing.assert_array_equal(planned, one.trial.reference)
    plain = np.array([line.split(",") for line in excite_trial.plain_file(planned).splitlines()[1:]], dtype=float)
    # Six decimals.
    np.testing.assert_allclose(plain[:, 1:], planned.reshape(len(planned), 18), atol=0.51e-6)
    assert np.abs(planned[:, 1]).max() <= 1.2
    assert np.abs(planned[:, 2]).max() <= 3.0
    assert not run.reference.ignored
    workspace = Workspace(load_model("plant", "ati_gamma"), one.workspace.bounds)
    assert workspace.problem(planned[::5, 0]) is None
    # Not a motion that hardly moves: every joint turns by 0.2 rad at least.
    assert (np.ptp(planned[:, 0], axis=0) > 0.2).all()
    assert planned[-1, 1:].max() == 0.0


def test_optimised_tells_more(found: excite.Excitation) -> None:
    assert found.value > found.value_before
    both = np.isfinite(found.before) & np.isfinite(found.planned)
    assert np.median(found.before[both] / found.planned[both]) > 1.1
    assert not (np.isfinite(found.before) & ~np.isfinite(found.planned)).any()
    # The servo keeps the arm within some mrad of the plan, so that as much is told; but what fades below 0.05 rad/s
    # hangs on few rows, in which the ripple shakes the joint.
    ratio = found.achieved / found.planned
    assert np.nanmedian(ratio) == pytest.approx(1.0, abs=0.02)
    assert np.nanmin(ratio) > 0.5
    assert np.nanmax(ratio) < 2.0


def test_the_twins_log_gives_the_numbers_back(found: excite.Excitation) -> None:
    seen = np.isfinite(found.missed)
    share = np.abs(found.missed[seen] / found.planned[seen])
    # 0.67 for normal errors of that size; the noise's memory is counted at its slowest, the servo answers the ripple.
    assert 0.2 < np.median(share) < 2.0


def test_the_same_seed_gives_the_same_files(found: excite.Excitation) -> None:
    again = excite.excite(request(), "ur5-twin identify excite", exchanges=150)
    assert again.sent == found.sent
    assert again.scenario == found.scenario
    assert excite.excite(request(seed=5, duration=12.0), "x", exchanges=1).sent[1] != again.sent[1]


def test_the_report_says_what_no_motion_tells(tmp_path: Path) -> None:
    one = excite.excite(request(purpose="plant", duration=12.0), "x", exchanges=1)
    results.write(excite.excite_result(one, "x"), tmp_path)
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    text = " ".join(report["findings"])
    assert "joint 6 torque_constant" in text
    assert "--carry" in text
    names = {(p["joint"], p["name"]) for p in report["parameters"]}
    assert (6, "rotor_inertia") in names
    assert report["provenance"]["command"] == "x"


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"speed": 4.0}, "beyond the arm's own limit"),
        ({"speed": 0.0}, "must be positive"),
        ({"duration": 8.0}, "room for 2 moves"),
        ({"format": "servoj", "duration": 2.0}, "too short"),
        ({"box": np.array([[0.0, 0.1], [0.0, 0.1], [0.0, 0.1]])}, "the start is not allowed: the flange at"),
        ({"box": np.array([[0.5, 0.1], [0.0, 0.1], [0.0, 0.1]])}, "no room"),
        ({"height": 0.6}, "over the base's plane"),
        ({"q_start": np.array([0.0, -1.5, 2.8, 0.0, 0.0, 0.0])}, "elbow at 2.800"),
        ({"weight": (9.0, np.zeros(3))}, "--carry 9 kg"),
        ({"reach": 1e-3}, "nowhere to go"),
        ({"purpose": "drives"}, "did you mean 'drive'"),
        ({"speed": 0.004}, "nowhere to go"),
    ],
)
def test_impossible_limits_are_named(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(IdentificationError, match=says):
        excite.excite(request(**changes), "x", exchanges=1)


@pytest.mark.parametrize(("arguments", "written"), [(["--duration", "12"], True), (["--speed-limit", "9"], False)])
def test_the_command(
    arguments: list[str], written: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """It writes everything that its page lists, or nothing and one line."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["ur5-twin", "identify", "excite", *arguments, "--out", "mine"])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    said = capsys.readouterr()
    assert stopped.value.code == (0 if written else 2), said.err
    if not written:
        assert said.err.count("\n") == 1
        assert "beyond the arm's own limit" in said.err
        assert not list(tmp_path.iterdir())
        return
    names = {path.name for path in Path("mine").rglob("*") if path.is_file()}
    figures = {"joints.png", "way.png", "standard_errors.png"}
    assert names == {"waypoints.txt", "trajectory.csv", "scenario.toml", "report.md", "report.json"} | figures
    assert read_waypoints(Path("mine/waypoints.txt")).moves
    assert load_scenario(Path("mine/scenario.toml")).title == "Excitation for drive"
