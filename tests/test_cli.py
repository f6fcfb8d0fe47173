"""The command line as a user meets it."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.recording import read

Run = Callable[..., tuple[int, str, str]]


def test_help_imports_nothing_heavy() -> None:
    code = "import sys, ur5_twin.cli; print([m for m in sys.modules if m.split('.')[0] in sys.argv[1:]])"
    heavy = ["numpy", "mujoco", "dm_control", "numba", "polars", "matplotlib", "rerun", "scipy"]
    done = subprocess.run([sys.executable, "-c", code, *heavy], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("command", [[], ["replay"], ["model"], ["fetch"]])
def test_every_command_has_help(run: Run, command: list[str]) -> None:
    code, out, _ = run(*command, "--help")
    assert code == 0
    assert "Usage" in out
    if command in (["replay"], ["model"]):
        assert "Examples" in out


def test_version(run: Run) -> None:
    code, out, _ = run("--version")
    assert code == 0
    assert out.startswith("ur5-twin ")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["replay"], "path"),
        (["replay", "nowhere"], "nowhere"),
        (["replay", "demo", "--mode", "ghost"], "servo"),
        (["replay", "demo", "--model", "d"], "known: a, b, c, controller, plant"),
        (["replay", "demo", "--model", "control"], "did you mean 'controller'"),
        (["replay", "demo", "--plant", "missing.toml"], "missing.toml"),
        (["replay", "demo", "--gains", "soft"], "thesis_c"),
        (["replay", "demo", "--drive", "none"], "thesis"),
        (["replay", "demo", "--tool", "hammer"], "ati_gamma"),
        (["replay", "demo", "--frobnicate"], "--frobnicate"),
        (["model", "z"], "known: a, b, c"),
        (["model", "c", "--export", "arm.stl"], "arm.stl"),
        (["fetch", "elsewhere"], "elsewhere"),
        (["fetch", "--from", "nowhere"], "nowhere"),
        (["dance"], "dance"),
    ],
)
def test_wrong_use_is_one_line_and_exit_code_2(run: Run, arguments: list[str], says: str) -> None:
    code, out, err = run(*arguments)
    assert code == 2
    assert out == ""
    assert err.startswith("ur5-twin: ")
    assert err.count("\n") == 1
    assert says in err
    assert not list(Path().iterdir())


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[mine", "mine.toml is not valid TOML"),
        ("[mine]\nsource = 'x'\nkappa0 = [1, 1, 1, 1, 1, 1]", "kappa1"),
        ("[mine]\nsource = 'x'\nkappa0 = [1, 1, 1]\nkappa1 = [1, 1, 1, 1, 1, 1]", "kappa0"),
        ("[mine]\nsource = 'x'\nkappa0 = [-1, 1, 1, 1, 1, 1]\nkappa1 = [1, 1, 1, 1, 1, 1]", "kappa0"),
        ("[mine]\nsource = 'x'\nkappa0 = [1, 1, 1, 1, 1, 1]\nkappa1 = [1, 1, 1, 1, 1, 1]\nkappa2 = 3", "known keys"),
    ],
)
def test_a_wrong_gains_file_is_named(run: Run, text: str, says: str) -> None:
    Path("mine.toml").write_text(text)
    code, _, err = run("replay", "demo", "--gains", "mine.toml")
    assert code == 2
    assert says in err
    assert "mine.toml" in err


def test_replay_of_the_demo_and_of_its_own_output(run: Run) -> None:
    code, out, _ = run("replay", "demo", "--out", "first", "--rerun")
    assert code == 0
    assert "written to first" in out
    report = json.loads(Path("first/report.json").read_text())
    assert report["source"] == "demo"
    assert report["model"] == "controller"
    assert report["samples"] == len(read(Path("first/recording.parquet")).robot)
    for section, key in (
        ("tracking", "q_mae_rad"),
        ("tracking", "qd_mae_rad_s"),
        ("target_moment", "mae_nm"),
        ("target_current", "mae_a"),
        ("actual_current", "mae_a"),
    ):
        assert len(report[section][key]) == 6, (section, key)
    # The demo's target torque was computed by this model: the log's six decimals are all that is between.
    assert max(report["target_moment"]["mae_nm"]) < 1e-4
    assert Path("first/twin.rrd").stat().st_size > 10_000
    assert "figures/" in Path("first/report.md").read_text()
    for figure in Path("first/figures").glob("*.png"):
        assert figure.stat().st_size < 500_000

    code, _, _ = run("replay", "first", "--out", "second", "--no-rerun", "--no-figures")
    assert code == 0
    again = json.loads(Path("second/report.json").read_text())
    assert again["tracking"] == report["tracking"]
    assert again["source"] == "demo"
    assert not Path("second/twin.rrd").exists()
    assert not Path("second/figures").exists()

    first, second = (read(Path(name) / "recording.parquet").robot for name in ("first", "second"))
    for name, values in first.columns.items():
        assert np.array_equal(values, second[name]), name


def test_an_output_folder_that_cannot_be_one_is_refused_first(run: Run, lab_logs: Path) -> None:
    Path("taken").write_text("mine")
    code, _, err = run("replay", "demo", "--out", "taken")
    assert code == 2
    assert "taken is a file" in err
    assert Path("taken").read_text() == "mine"
    # Before the logs are read, and also where it is on the way.
    for command in (("identify", "plant", "nowhere"), ("estimate", "nowhere"), ("run", "press_plate")):
        code, _, err = run(*command, "--out", "taken/within")
        assert code == 2
        assert "'--out' / '-o': taken is a file; give a folder" in err


def test_no_command_writes_into_a_log(run: Run, lab_logs: Path) -> None:
    log = lab_logs / "Movement_No3_Acc"
    there = sorted(log.rglob("*"))
    commands = [("replay", log), ("estimate", log), ("identify", "drive", log), ("run", "press_plate")]
    for command in [*commands, ("record", "127.0.0.1"), ("benchmark",)]:
        for folder in (log, log / "csv_files", log / "new"):
            code, _, err = run(*command, "--out", folder)
            assert code == 2
            assert f"{folder} lies in a log" in err.replace("\n", " ")
    assert sorted(log.rglob("*")) == there


def test_the_default_folder_does_not_swallow_another_logs_replay(run: Run) -> None:
    from ur5_twin.resources import data_dir

    quiet = ["--no-rerun", "--no-figures"]
    assert run("replay", "demo", *quiet)[0] == 0
    assert run("replay", "demo", *quiet)[0] == 0  # the same log again is no loss
    shutil.copytree(data_dir("replay") / "demo", "elsewhere/demo")
    code, _, err = run("replay", "elsewhere/demo", *quiet)
    assert code == 2
    assert "another log" in err
    assert "--out" in err
    code, _, err = run("replay", "out/demo", "--model", "c", *quiet)
    assert code == 2
    assert json.loads(Path("out/demo/report.json").read_text())["model"] == "controller"


def test_an_earlier_runs_files_do_not_stay(run: Run) -> None:
    Path("out/figures").mkdir(parents=True)
    Path("out/figures/old.png").write_bytes(b"old")
    Path("out/twin.rrd").write_bytes(b"old")
    Path("out/mine.txt").write_text("mine")
    code, _, _ = run("replay", "demo", "--out", "out", "--no-rerun", "--no-figures")
    assert code == 0
    assert not Path("out/twin.rrd").exists()
    assert not Path("out/figures/old.png").exists()
    assert Path("out/mine.txt").exists()


def test_a_tool_the_controller_does_not_know(run: Run, lab_logs: Path) -> None:
    """The lab's controller was not told of the force sensor: its target torque is that of the bare arm."""
    log = lab_logs / "Movement_No9_Singularity_Free_ForceSensor"
    quiet = ["--no-rerun", "--no-figures", "--out", "out"]
    mae = {}
    for payload in ("none", "ati_gamma"):
        code, _, _ = run("replay", log, "--tool", "ati_gamma", "--payload", payload, *quiet)
        assert code == 0
        mae[payload] = max(json.loads(Path("out/report.json").read_text())["target_moment"]["mae_nm"])
    assert mae["none"] < 1e-4
    assert mae["ati_gamma"] > 1.0


def test_a_time_in_milliseconds_is_refused(run: Run) -> None:
    from dataclasses import replace

    from ur5_twin.recording import write_parquet
    from ur5_twin.resources import data_dir

    demo = read(data_dir("replay") / "demo")
    write_parquet(demo.with_table(replace(demo.robot, time=demo.robot.time * 1e3)), Path("ms.parquet"))
    code, _, err = run("replay", "ms.parquet", "--out", "out")
    assert code == 2
    assert "in seconds" in err


def test_servo_names_the_targets_a_log_lacks_and_shadow_says_what_it_did(run: Run) -> None:
    header = ["timestamp", *(f"{name}_{j}" for name in ("actual_q", "actual_qd") for j in range(6))]
    rows = [",".join(["%.3f" % (100 + 0.008 * k), *["0.1"] * 6, *["0.0"] * 6]) for k in range(50)]
    Path("mine.csv").write_text("\n".join([",".join(header), *rows]) + "\n")
    code, _, err = run("replay", "mine.csv")
    assert code == 2
    assert "no target_q, target_qd, target_qdd" in err
    assert "shadow" in err
    code, _, _ = run("replay", "mine.csv", "--mode", "shadow", "--no-rerun", "--no-figures", "--out", "out")
    assert code == 0
    report = json.loads(Path("out/report.json").read_text())
    assert any("slope of actual_qd" in note["what"] for note in report["notes"])
    assert "target_moment" not in report


def test_numbers_that_are_none_are_refused(run: Run) -> None:
    Path("mine.toml").write_text("[mine]\nsource = 'x'\nkappa0 = [1, 1, 1, inf, 1, 1]\nkappa1 = [1, 1, 1, 1, 1, 1]")
    code, _, err = run("replay", "demo", "--gains", "mine.toml")
    assert code == 2
    assert "mine.kappa0[3] is no number that a robot has" in err


def test_a_simulation_that_diverges_is_one_line(tmp_path: Path) -> None:
    row = "[1e8, 1e8, 1e8, 1e8, 1e8, 1e8]"
    (tmp_path / "wild.toml").write_text(f"[wild]\nsource = 'x'\nkappa0 = {row}\nkappa1 = [1, 1, 1, 1, 1, 1]\n")
    # In a process of its own: the engine's warnings do not pass through Python's stderr.
    arguments = ["replay", "demo", "--model", "a", "--gains", "wild.toml", "--out", "out"]
    done = subprocess.run(
        [sys.executable, "-m", "ur5_twin.cli", *arguments], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "diverged" in done.stderr
    assert not (tmp_path / "out").exists()


def test_shadow_replay(run: Run) -> None:
    arguments = ["demo", "--mode", "shadow", "--model", "plant", "--no-figures", "--no-rerun", "--out", "out"]
    code, _, _ = run("replay", *arguments)
    assert code == 0
    report = json.loads(Path("out/report.json").read_text())
    assert report["mode"] == "shadow"
    # One tick ahead of a measured state, whose quantised velocity of 0.3 mrad/s alone makes 2 urad.
    assert max(report["tracking"]["q_mae_rad"]) < 2e-5


def test_an_interrupted_replay_writes_nothing(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    from ur5_twin.twin import replay

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(replay, "replay", interrupted)
    code, _, err = run("replay", "demo", "--out", "out")
    assert code == 130
    assert "stopped" in err
    assert not Path("out").exists()


def test_model_table_and_export(run: Run) -> None:
    import mujoco

    code, out, _ = run("model", "c")
    assert code == 0
    assert "8.393" in out
    assert "table 4.2" in out
    code, _, _ = run("model", "plant", "--tool", "both", "--scene", "--export", "cell.xml")
    assert code == 0
    model = mujoco.MjModel.from_xml_path("cell.xml")
    assert model.body("tool").mass == pytest.approx(0.51)
    assert model.geom("floor") is not None


def test_fetch_from_a_folder(run: Run, lab_logs: Path) -> None:
    code, out, _ = run("fetch", "kufieta2014", "--from", lab_logs, "--out", "logs")
    assert code == 0
    folder = Path("logs/kufieta2014/Movement_No3_Acc")
    assert (folder / "csv_files" / "log_q_actual.csv").is_file()
    assert "ur5-twin replay logs/kufieta2014/Movement_" in out


def test_identified_controller_files_replay(run: Run, lab_logs: Path) -> None:
    logs = [lab_logs / "Movement_No6_Acc_slow_Verify_Model", lab_logs / "Movement_No9_Singularity_Free_NoDist"]
    code, out, _ = run("identify", "controller", *logs, "--out", "rigid")
    assert code == 0
    assert "the file has none" in out
    code, _, _ = run("identify", "controller-current", *logs, "--out", "current")
    assert code == 0
    report = json.loads(Path("rigid/report.json").read_text())
    held_out = report["tables"][0]
    assert held_out["unit"] == "uNm"
    assert np.shape(held_out["values"]) == (2, 6)
    assert np.max(held_out["values"]) < 100.0
    assert report["provenance"]["logs"] == [log.name for log in logs]
    assert "| No6_Acc_slow_Verify_Model |" in Path("rigid/report.md").read_text()
    assert Path("rigid/figures/errors.png").stat().st_size > 5_000

    unseen = lab_logs / "Movement_No5_Acc_slow_w_disturbance"
    files = ["--model", "rigid/controller.toml", "--target-current", "current/target_current.toml"]
    code, _, _ = run("replay", unseen, *files, "--out", "out", "--no-rerun", "--no-figures")
    assert code == 0
    replayed = json.loads(Path("out/report.json").read_text())
    assert replayed["model"] == "identified-controller"
    assert max(replayed["target_moment"]["mae_nm"]) < 1e-4
    assert max(replayed["target_current"]["mae_a"]) < 0.02


def test_logs_that_cannot_carry_a_fit_are_refused(run: Run, lab_logs: Path) -> None:
    code, _, err = run("identify", "controller", lab_logs / "Movement_No10_Standstill_ForceSensor_Fx")
    assert code == 2
    assert "joint 1 (0.0 s)" in err
    assert not list(Path().iterdir())


_SHORT = """
title = "A short run"
description = "One joint moves a little while the arm is pushed."
{top}

[arm]
tool = "ati_gamma"
declared_payload = "ati_gamma"

[start]
q_deg = [-5.0, -113.0, -67.0, 90.0, -90.0, 85.0]

[[motion]]
type = "wait"
duration_s = 0.4

[[motion]]
type = "movej"
q_deg = [-5.0, -113.0, -67.0, 90.0, -90.0, {joint_6}]
speed_rad_s = 0.5

[[push]]
at_s = 0.5
profile = "half_sine"
duration_s = 0.5
force_n = {force}
{more}
"""


def _write_scenario(name: str = "short.toml", **parts: str) -> str:
    given = {"top": "", "joint_6": "95.0", "force": "[0.0, 0.0, 20.0]", "more": "", **parts}
    Path(name).write_text(_SHORT.format(**given))
    return name


_QUIET = ("--no-rerun", "--no-figures")


def test_run_lists_the_scenarios_that_ship(run: Run) -> None:
    from ur5_twin.scenario import load_scenario, scenario_names

    code, out, err = run("run", "--list")
    assert code == 0
    assert err == ""
    assert [line.split()[0] for line in out.splitlines()] == list(scenario_names())
    assert load_scenario("press_plate").title in out


def test_run_writes_recording_log_and_report(run: Run) -> None:
    code, out, _ = run("run", _write_scenario(), *_QUIET, "--out", "out")
    assert code == 0
    assert "written to out" in out
    assert sorted(p.name for p in Path("out").iterdir()) == ["log", "recording.parquet", "report.json", "report.md"]
    report = json.loads(Path("out/report.json").read_text())
    recording = read(Path("out"))
    assert report["scenario"] == "short"
    assert report["samples"] == len(recording.robot)
    assert report["ending"] == {"protective_stop_s": None, "stop_reason": None, "failure": None}
    # The half sine's top, seen at the ticks.
    assert report["wrench"]["truth"]["largest_force_n"] == pytest.approx(20.0, rel=1e-3)
    assert set(recording.tables) == {"robot", "ft", "contact"}
    assert len(read(Path("out/log")).robot) == len(recording.robot)
    assert "A short run" in Path("out/report.md").read_text()


def test_a_run_goes_to_a_folder_of_its_own_and_again_to_the_same(run: Run) -> None:
    name = _write_scenario()
    for _ in range(2):
        assert run("run", name, *_QUIET)[0] == 0
    assert Path("out/short/recording.parquet").is_file()
    Path("out/other").mkdir()
    Path("out/other/mine.txt").write_text("mine")
    code, _, err = run("run", _write_scenario("other.toml"), *_QUIET)
    assert code == 2
    assert "no run of a scenario" in err
    assert [p.name for p in Path("out/other").iterdir()] == ["mine.txt"]


def test_a_seed_changes_the_noise_and_not_the_motion(run: Run) -> None:
    name = _write_scenario()
    for seed in (1, 1, 2):
        assert run("run", name, *_QUIET, "--seed", seed, "--out", f"out{seed}")[0] == 0
    one, two = (read(Path(f"out{seed}/recording.parquet")).robot for seed in (1, 2))
    assert json.loads(Path("out1/report.json").read_text())["seed"] == 1
    assert (one["actual_current"] != two["actual_current"]).any()
    np.testing.assert_array_equal(one["truth_q"], two["truth_q"])


def test_a_run_that_is_touched_in_two_places_at_once_can_be_judged(run: Run) -> None:
    # A collision at 0.25 m/s, in which the tool touches in two places.
    code, _, _ = run("run", "collide_025", *_QUIET, "--out", "out")
    assert code == 0
    contact = read(Path("out")).tables["contact"]
    assert (np.diff(contact.time) == 0.0).any()
    code, _, err = run("estimate", "out", "--estimator", "controller", "--no-rerun", "--out", "judged")
    assert code == 0, err
    assert Path("judged/report.json").exists()


def test_a_run_that_nothing_touches_can_be_replayed(run: Run) -> None:
    motions = Path("free.toml")
    text = _SHORT.format(top="", joint_6="95.0", force="[0.0, 0.0, 1.0]", more="")
    motions.write_text(text[: text.index("[[push]]")])
    code, _, _ = run("run", "free.toml", "--no-rerun", "--out", "out")
    assert code == 0
    assert Path("out/figures").is_dir()
    for log in ("out", "out/log"):
        code, _, _ = run("replay", log, "--tool", "ati_gamma", "--payload", "ati_gamma", *_QUIET, "--out", "again")
        assert code == 0
        report = json.loads(Path("again/report.json").read_text())
        # The controller's own torque in its own log: rounding to six decimals of the targets.
        assert max(report["target_moment"]["mae_nm"]) < 1e-3


_BLOCK = """
[[obstacle]]
name = "block"
shape = "box"
position_mm = {position}
size_mm = [300.0, 300.0, 300.0]
stiffness_n_m = {stiffness}
"""
_FAR = """
[[motion]]
type = "movel"
position_mm = [2000.0, 0.0, 300.0]
"""


@pytest.mark.parametrize(
    ("parts", "says"),
    [
        ({"more": _BLOCK.format(position="[2000.0, 0.0, 0.0]", stiffness=0)}, "obstacle[0].stiffness_n_m"),
        ({"more": _FAR}, "motion[2].position_mm"),
        ({"more": _FAR}, "cannot reach"),
        ({"more": _BLOCK.format(position="[400.0, -150.0, 400.0]", stiffness=2e4)}, "starts inside something"),
        ({"more": _BLOCK.format(position="[400.0, -150.0, 400.0]", stiffness=2e4)}, "obstacle_block"),
        ({"more": "from = 'above'"}, "from"),
        ({"top": "duration_s = -1.0"}, "duration_s"),
        ({"top": "speed = 3"}, "speed"),
        ({"joint_6": "9500.0"}, "motion[1].q_deg[5]"),
        ({"force": "[0.0, 0.0, 0.0]"}, "push[0].force_n"),
        ({"force": "[0.0, 0.0]"}, "push[0].force_n"),
        ({"force": "20.0"}, "push[0].force_n"),
    ],
)
def test_a_scenario_that_cannot_be_is_one_line_that_names_the_cause(run: Run, parts: dict[str, str], says: str) -> None:
    code, out, err = run("run", _write_scenario(**parts), *_QUIET, "--out", "out")
    assert code == 2
    assert out == ""
    assert err.startswith("ur5-twin: ")
    assert err.count("\n") == 1
    assert says in err
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "--list"),
        (["pres_plate"], "press_plate"),
        (["dance"], "or give the path of a .toml file"),
        (["missing.toml"], "missing.toml"),
        (["press_plate", "--seed", "-1"], "--seed"),
    ],
)
def test_a_run_of_what_there_is_not(run: Run, arguments: list[str], says: str) -> None:
    code, out, err = run("run", *arguments)
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert says in err
    assert not list(Path().iterdir())


def test_a_push_that_overpowers_the_arm_ends_the_run_and_keeps_what_came_before(run: Run) -> None:
    name = _write_scenario(force="[0.0, -2000.0, 0.0]", more="[limits]\ndeviation_rad = 0.1")
    code, _, err = run("run", name, *_QUIET, "--out", "out")
    assert code == 2
    assert err.count("\n") == 1
    assert "overpowers the stopped arm" in err
    assert "out" in err.split("what came before it is in")[1]
    recording = read(Path("out/recording.parquet"))
    # The push begins at 0.5 s; the time in the message is where the recording ends.
    said = float(err.split("at ")[1].split(" s")[0])
    assert 0.5 < said < 1.0
    assert recording.robot.time[-1] == pytest.approx(said, abs=0.0081)
    report = json.loads(Path("out/report.json").read_text())
    assert report["ending"]["failure"] in err
    assert report["ending"]["stop_reason"] is not None
    assert "The run ended before its time" in Path("out/report.md").read_text()
