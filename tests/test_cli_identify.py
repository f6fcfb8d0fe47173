"""``ur5-twin identify`` as a user runs it: files that the twin takes, and one line where a log cannot carry the fit."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.recording import read, write_parquet

Run = Callable[..., tuple[int, str, str]]
NO4, NO9 = "Movement_No4_Acc", "Movement_No9_Singularity_Free_NoDist"
STILL = "Movement_No10_Standstill_ForceSensor_Fx"
MOTION = ("target_q", "target_qd", "target_qdd", "actual_q", "actual_qd")
DEMO = Path(__file__).resolve().parent.parent / "replay" / "demo"


def current_error(run: Run, log: Path, *options: str) -> np.ndarray:
    """Mean absolute error of actual_current by joint, over the controller's own."""
    assert run("replay", log, *options, "--repair", "--no-rerun", "--no-figures", "--out", "replayed")[0] == 0
    found = json.loads(Path("replayed/report.json").read_text(encoding="utf-8"))["actual_current"]
    return np.array(found["mae_a"]) / found["controller_mae_a"]


def test_drive_files_replay_an_unseen_log(run: Run, lab_logs: Path) -> None:
    logs = [lab_logs / NO4, lab_logs / "Movement_No5_Acc_slow_no_disturbance"]
    code, out, _ = run("identify", "drive", *logs, "--tool", "xsens_mti", "--repair", "--out", "drive")
    assert code == 0
    assert "written to drive: joints.toml, drive.toml, drive_following.toml" in out
    for name in ("torque_without_friction", "torque_with_friction"):
        assert Path(f"drive/figures/{name}.png").stat().st_size > 20_000
    unseen = lab_logs / NO9
    ours = current_error(run, unseen, "--mode", "shadow", "--drive", "drive/drive.toml", "--tool", "xsens_mti")
    # Of two logs: the controller's error is 1. Joint 2's rest is what no free log tells.
    assert (ours[[0, 2, 3, 4, 5]] < 0.75).all()
    code, out, _ = run("identify", "drive", lab_logs / NO4, "--method", "thesis", "--repair", "--out", "thesis")
    assert code == 0
    assert "written to thesis: drive.toml, report.md" in out
    thesis = current_error(run, unseen, "--mode", "shadow", "--drive", "thesis/drive.toml")
    assert (ours < thesis).all()


def test_plant_and_servo_files_replay(run: Run, lab_logs: Path) -> None:
    logs = [lab_logs / NO4, lab_logs / "Movement_No6_Acc_slow_Verify_Model"]
    code, out, err = run("identify", "plant", *logs, "--tool", "xsens_mti", "--repair", "--out", "plant")
    assert code == 0, err
    assert "written to plant: plant.toml, joints.toml" in out
    code, out, _ = run("identify", "servo", lab_logs / STILL, lab_logs / NO4, "--repair", "--out", "servo")
    assert code == 0
    assert "written to servo: gains.toml" in out
    report = json.loads(Path("plant/report.json").read_text(encoding="utf-8"))
    assert report["provenance"]["logs"] == [log.name for log in logs]
    options = ("--plant", "plant/plant.toml", "--joints", "plant", "--gains", "servo/gains.toml")
    # A log it was fitted to: files that work, no proof.
    assert (current_error(run, lab_logs / NO4, *options) < 1.1).all()


def test_a_plant_that_may_carry_something(run: Run, lab_logs: Path) -> None:
    logs = [lab_logs / NO4, lab_logs / "Movement_No6_Acc_slow_Verify_Model"]
    # The same things hang there in both: beyond those of the second log nothing does in the first.
    code, out, err = run("identify", "plant", logs[0], "--payload", "--bare", logs[1], "--repair", "--out", "plant")
    assert code == 0, err
    assert "beyond the tool the flange carries: mass" in out
    assert "cannot be told from none at 95 %, and counts as none" in out
    assert "written to plant: plant.toml, joints.toml, report.md" in out
    report = json.loads(Path("plant/report.json").read_text(encoding="utf-8"))
    assert report["payload"]["mass_95_kg"] < 0.1
    # Without it the law's own error counts as a weight, where none can hang: said, with what would help.
    code, out, err = run("identify", "plant", *logs, "--payload", "--repair", "--out", "alone")
    assert code == 0, err
    assert "the payload's centre is behind the flange" in out
    code, _, err = run("identify", "plant", logs[0], "--bare", logs[1], "--repair", "--out", "other")
    assert code == 2
    assert "--payload" in err
    assert not Path("other").exists()


@pytest.mark.parametrize("command", ["drive", "servo", "plant", "payload", "controller"])
def test_a_log_that_is_too_short_is_refused_in_one_line(run: Run, command: str) -> None:
    shutil.copytree(DEMO, "short")
    for path in Path("short/csv_files").iterdir():
        path.write_text("".join(path.read_text(encoding="utf-8").splitlines(keepends=True)[:60]), encoding="utf-8")
    code, _, err = run("identify", command, "short", "--out", "found")
    assert code == 2
    assert err.startswith("ur5-twin: ")
    assert err.count("\n") == 1
    assert not Path("found").exists()


@pytest.mark.parametrize("command", ["drive", "plant", "controller"])
def test_a_log_without_motion_is_refused(run: Run, lab_logs: Path, command: str) -> None:
    code, _, err = run("identify", command, lab_logs / STILL, "--repair", "--out", "found")
    assert code == 2
    assert "joint" in err
    assert "move" in err or "slide" in err
    assert not Path("found").exists()


@pytest.mark.parametrize("command", ["drive", "plant", "controller", "controller-current"])
def test_a_log_of_one_joint_is_refused(run: Run, command: str) -> None:
    """The demo's 9.4 s with joints 2 to 6 held where they start."""
    demo = read(DEMO)
    held = {name: demo.robot[name].copy() for name in MOTION}
    for name, values in held.items():
        values[:, 1:] = values[0, 1:] if name.endswith("_q") else 0.0
    write_parquet(demo.with_table(demo.robot.with_columns(held)), Path("one.parquet"))
    code, _, err = run("identify", command, "one.parquet", "--out", "found")
    assert code == 2
    assert err.startswith("ur5-twin: ")
    assert err.count("\n") == 1
    assert "joint 2" in err
    assert "move" in err or "turn" in err
    assert not Path("found").exists()


def test_a_log_without_its_currents_is_refused(run: Run) -> None:
    shutil.copytree(DEMO, "poor")
    Path("poor/csv_files/log_i_actual.csv").unlink()
    for command in ("drive", "plant", "servo"):
        code, _, err = run("identify", command, "poor", "--repair", "--out", "found")
        assert code == 2
        assert err.count("\n") == 1
        assert "no actual_current" in err
        assert not Path("found").exists()
