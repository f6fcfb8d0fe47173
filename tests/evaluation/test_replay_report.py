"""The report's numbers, on a recording whose errors are known."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from ur5_twin.arm.drive import load_drive, load_joint_drives
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.gains import load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.evaluation import metrics
from ur5_twin.evaluation.replay_report import render_markdown, summarise, table_rows
from ur5_twin.evaluation.reporting import render_json
from ur5_twin.recording.table import Note, Recording, Table
from ur5_twin.twin.replay import ReplaySettings

JOINT = np.arange(1.0, 7.0)


@pytest.fixture
def settings() -> ReplaySettings:
    model = load_model("c", "ati_gamma")
    return ReplaySettings(model, model, load_gains("thesis_b"), load_drive(), load_target_current_law(), "servo")


def recording(**columns: np.ndarray) -> Recording:
    table = Table("robot", np.arange(4) * 0.008 + 3.0, columns)
    notes = (Note("robot", "a gap"), Note("log_q_actual.csv, row 3", "cut", repaired=True))
    return Recording({"robot": table}, "run", "lab", notes)


def test_metrics_ignore_what_was_not_measured() -> None:
    measured = np.array([[1.0, np.nan], [2.0, 2.0], [4.0, 2.0]])
    predicted = np.array([[0.0, 9.0], [4.0, 2.5], [4.0, 2.0]])
    assert metrics.mean_absolute(measured, predicted).tolist() == [1.0, 0.25]
    assert metrics.largest(measured, predicted).tolist() == [2.0, 0.5]
    assert metrics.bias(measured, predicted).tolist() == pytest.approx([1 / 3, 0.25])


def test_numbers_stand_where_they_are_promised(settings: ReplaySettings) -> None:
    sign = np.array([1.0, -1.0, 1.0, -1.0])[:, None]
    zero = np.zeros((4, 6))
    names = ("actual_q", "actual_qd", "target_moment", "target_current", "actual_current")
    columns = {name: zero for name in names}
    columns |= {f"sim_{name}": sign * JOINT * scale for scale, name in enumerate(names, start=1)}
    columns["sim_moment"] = zero + 7.0
    columns["target_current"] = zero + 0.5
    report = summarise(recording(**columns), settings)
    assert report["tracking"]["q_mae_rad"] == JOINT.tolist()
    assert report["tracking"]["qd_mae_rad_s"] == (2 * JOINT).tolist()
    assert report["target_moment"]["mae_nm"] == (3 * JOINT).tolist()
    assert report["target_moment"]["closed_loop_mae_nm"] == [7.0] * 6
    assert report["target_current"]["bias_a"] == pytest.approx([-0.5] * 6)
    assert report["actual_current"]["mae_a"] == (5 * JOINT).tolist()
    assert report["actual_current"]["max_a"] == (5 * JOINT).tolist()
    assert report["actual_current"]["controller_mae_a"] == [0.5] * 6
    assert report["samples"] == 4
    assert report["duration_s"] == pytest.approx(0.024)
    assert (report["model"], report["mode"], report["gains"], report["tool"]) == ("c", "servo", "thesis_b", "ati_gamma")
    assert report["repairs"] == [{"where": "log_q_actual.csv, row 3", "what": "cut"}]
    assert report["notes"] == [{"where": "robot", "what": "a gap"}]
    assert {"ur5-twin", "python", "mujoco", "numpy"} <= set(report["versions"])
    assert json.loads(render_json(report)) == report


def test_what_the_log_lacks_is_left_out(settings: ReplaySettings) -> None:
    zero = np.zeros((4, 6))
    report = summarise(recording(actual_q=zero, sim_actual_q=zero, sim_moment=zero), settings)
    assert "target_moment" not in report
    assert "actual_current" not in report
    assert list(report["tracking"]) == ["q_mae_rad", "q_max_rad", "q_bias_rad"]
    assert [label for label, _, _ in table_rows(report)] == ["position"]


def test_markdown_has_the_numbers_in_readable_units(settings: ReplaySettings) -> None:
    zero = np.zeros((4, 6))
    columns = {"actual_q": zero, "sim_actual_q": zero + 1.5e-3, "sim_moment": zero}
    text = render_markdown(summarise(recording(**columns), settings), [])
    assert "| position | mrad | 1.50 |" in text
    assert "log_q_actual.csv, row 3: cut" in text


def test_the_answer_to_a_push_is_compared_where_currents_change(settings: ReplaySettings) -> None:
    n = 200
    rng = np.random.default_rng(3)
    change = rng.uniform(-2.0, 2.0, (n, 6))
    change[:, 5] = 0.1
    held = np.zeros((n, 6))
    columns = {name: held for name in ("target_q", "target_qd", "target_qdd", "target_moment", "target_current")}
    columns |= {"actual_q": held + 3e-4, "sim_actual_q": held - 2e-4, "sim_target_current": held, "sim_moment": held}
    columns |= {"actual_current": change, "sim_actual_current": 0.8 * change}
    # While the arm is idle a published target follows the arm; the error is from where the servo holds it.
    columns["target_q"] = np.where(np.arange(n)[:, None] > 0, 3e-4, 0.0) + held
    table = Table("robot", np.arange(n) * 0.008, columns)
    moving = replace(settings, joints=load_joint_drives(), gains=load_gains("servo"))
    report = summarise(Recording({"robot": table}, "run", "lab"), moving)
    assert report["tracking"]["error_max_measured_rad"] == pytest.approx([3e-4] * 6)
    assert report["tracking"]["error_max_twin_rad"] == pytest.approx([2e-4] * 6)
    assert report["current_change"]["slope"] == pytest.approx([0.8] * 5 + [None])
    assert report["current_change"]["correlation"] == pytest.approx([1.0] * 5 + [None])
    assert "current change, slope of the twin's" in render_markdown(report, [])
    assert json.loads(render_json(report))["wrench"] == "none"
