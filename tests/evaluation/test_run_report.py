"""The report of a run, on recordings whose numbers are made by hand."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from ur5_twin.errors import ModelError, RecordingError
from ur5_twin.evaluation.reporting import render_json
from ur5_twin.evaluation.run_report import RunFacts, render_run_markdown, summarise_run
from ur5_twin.recording import Recording, Table

N = 200
TIME = np.arange(N) * 0.008
JOINT = np.arange(1.0, 7.0)
LINKS = ("shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link", "tool")
FACTS = RunFacts(
    name="press",
    title="Pressing on a plate",
    description="Down, and up again.",
    seed=7,
    tool="ati_gamma",
    controller="controller",
    plant="plant",
    gains="servo",
    sensors="lab",
    stop_reason=None,
    failure=None,
    obstacles=("plate", "wall"),
    links=LINKS,
    executed=(("movej to q_start", 0.0, 0.5), ("movel down", 0.5, 1.2)),
    ignored=(("movel up", 1.3, np.inf),),
)


def made(**columns: np.ndarray) -> Recording:
    """A run in which nothing happens, but for the columns given."""
    zero = np.zeros((N, 6))
    names = (
        "target_q",
        "target_qd",
        "target_qdd",
        "actual_q",
        "truth_q",
        "truth_wrench",
        "truth_tau_ext",
        "truth_friction",
    )
    table = Table("robot", TIME, {**{name: zero for name in names}, **columns}, 50.0)
    return Recording({"robot": table}, "press", "run")


def with_contacts(recording: Recording, *rows: tuple[int, int, int, list[float]]) -> Recording:
    """A table of contacts: tick, link, obstacle and force of each row."""
    columns = {
        "contact_link": np.array([[float(link)] for _, link, _, _ in rows]).reshape(-1, 1),
        "contact_obstacle": np.array([[float(obstacle)] for _, _, obstacle, _ in rows]).reshape(-1, 1),
        "contact_point": np.zeros((len(rows), 3)),
        "contact_force": np.array([force for *_, force in rows], dtype=float).reshape(-1, 3),
    }
    return recording.with_table(Table("contact", np.array([row[0] * 0.008 for row in rows]), columns, 50.0))


def test_tracking_is_split_by_whether_the_joint_s_target_moves() -> None:
    moving = np.zeros((N, 6))
    moving[100:, :3] = 0.5
    error = np.where(moving > 0, 3e-3, -1e-3) * JOINT
    run = made(target_qd=moving, actual_q=error, truth_q=2 * error, target_q=np.zeros((N, 6)))
    tracking = summarise_run(run, scenario=FACTS)["tracking"]
    assert tracking["measured_mae_still_rad"] == pytest.approx(1e-3 * JOINT)
    assert tracking["measured_mae_moving_rad"] == [*(pytest.approx(3e-3 * j) for j in JOINT[:3]), None, None, None]
    assert tracking["measured_max_rad"] == pytest.approx([3e-3, 6e-3, 9e-3, 4e-3, 5e-3, 6e-3])
    assert tracking["true_max_rad"] == pytest.approx([6e-3, 12e-3, 18e-3, 8e-3, 10e-3, 12e-3])


def test_a_push_at_standstill_is_an_error_though_an_idle_controller_publishes_it_as_target() -> None:
    pushed = np.where((TIME > 0.4)[:, None], 2e-3, 0.0) * JOINT
    tracking = summarise_run(made(actual_q=pushed, truth_q=pushed, target_q=pushed), scenario=FACTS)["tracking"]
    assert tracking["true_max_rad"] == pytest.approx(2e-3 * JOINT)


def test_contacts_per_obstacle_and_link() -> None:
    run = with_contacts(
        made(),
        *((tick, 7, 0, [0.0, 0.0, 10.0]) for tick in range(20, 30)),
        # A second point of the same pair at the same tick: one force of 13 N.
        (25, 7, 0, [5.0, 0.0, 2.0]),
        (26, 3, 1, [0.0, -4.0, 0.0]),
        (100, 6, -1, [3.0, 4.0, 0.0]),
        (101, 6, -1, [-3.0, -4.0, 0.0]),
        (103, 2, -2, [1.0, 0.0, 0.0]),
    )
    contact = summarise_run(run, scenario=FACTS)["contact"]
    # Ticks 20 to 29 and 103; the wall is touched within the first.
    assert contact["in_contact_s"] == pytest.approx(11 * 0.008)
    assert contact["pushed_s"] == pytest.approx(2 * 0.008)
    plate, wall, itself, push = contact["touches"]
    assert (plate["obstacle"], plate["link"]) == ("plate", "tool")
    assert plate["largest_force_n"] == pytest.approx(13.0)
    assert plate["largest_force_s"] == pytest.approx(0.2)
    assert plate["duration_s"] == pytest.approx(0.08)
    assert plate["impulse_n_s"] == pytest.approx([5.0 * 0.008, 0.0, 102.0 * 0.008])
    assert (wall["obstacle"], wall["link"], wall["largest_force_n"]) == ("wall", "forearm_link", 4.0)
    assert (itself["obstacle"], itself["link"]) == ("arm itself", "upper_arm_link")
    assert (push["obstacle"], push["link"], push["largest_force_n"]) == ("push", "wrist_3_link", 5.0)
    assert push["impulse_n_s"] == pytest.approx([0.0, 0.0, 0.0])


def test_the_controller_s_estimate_is_turned_and_compared_with_the_truth() -> None:
    truth = np.zeros((N, 6))
    truth[50:60] = [0.0, 0.0, 40.0, 3.0, 0.0, 4.0]
    truth[55] *= 1.5
    off = np.array([1.0, -2.0, 3.0, 0.1, -0.2, 0.3])
    # What the arm does to its surroundings; while it is touched it is off by twice as much.
    told = -(truth + np.where(truth[:, 2:3] > 0, 2.0, 1.0) * off)
    run = with_contacts(
        made(truth_wrench=truth, actual_TCP_force=told), *((tick, 7, 0, [0.0, 0.0, 40.0]) for tick in range(50, 60))
    )
    wrench = summarise_run(run, scenario=FACTS)["wrench"]
    assert wrench["truth"] == pytest.approx(
        {"largest_force_n": 60.0, "largest_force_s": 0.44, "largest_moment_nm": 7.5, "largest_moment_s": 0.44}
    )
    errors = wrench["controller"]["in_contact"]
    assert errors["force_bias_n"] == pytest.approx(2 * off[:3])
    assert errors["moment_mae_nm"] == pytest.approx(2 * np.abs(off[3:]))
    overall = wrench["controller"]["overall"]
    assert overall["force_mae_n"] == pytest.approx(np.abs(off[:3]) * (190 + 2 * 10) / 200)
    assert overall["force_rmse_n"] == pytest.approx(np.abs(off[:3]) * np.sqrt((190 + 4 * 10) / 200))
    assert overall["moment_max_nm"] == pytest.approx(2 * np.abs(off[3:]))
    assert wrench["sensor"] == {"overall": None, "in_contact": None}


def test_the_force_sensor_is_tared_and_its_moment_is_about_the_flange() -> None:
    truth, reading = np.zeros((N, 6)), np.tile([5.0, -3.0, 1.0, 0.2, 0.1, 0.0], (N, 1))
    truth[100:, 0] = 10.0
    # Its origin is 28.6 mm out: without lever there, 10 N along x have a moment of 0.286 Nm about the flange's y.
    truth[100:, 4] = 0.286
    reading[100:, 0] += 10.0
    run = made(truth_wrench=truth, actual_TCP_pose=np.zeros((N, 6)))
    run = run.with_table(Table("ft", TIME, {"ft_wrench": reading}, 50.0))
    sensor = summarise_run(run, scenario=FACTS)["wrench"]["sensor"]
    # A sum of a few numbers of this size.
    assert sensor["overall"]["force_max_n"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert sensor["overall"]["moment_max_nm"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    bare = summarise_run(run, scenario=replace(FACTS, tool="none"))["wrench"]["sensor"]
    assert bare["overall"]["moment_max_nm"] == pytest.approx([0.0, 0.286, 0.0], abs=1e-9)


def test_torques_and_currents() -> None:
    swing = np.sin(TIME * 40.0)[:, None]
    run = made(
        truth_tau_ext=np.where(np.arange(N)[:, None] == 77, -9.0, 1.0) * JOINT,
        truth_friction=swing * JOINT,
        truth_moment=-4.0 * swing * JOINT * [1, 1, 1, 1, 1, 0],
        actual_current=np.where(np.arange(N)[:, None] == 3, -2.5, 0.5) * JOINT,
    )
    report = summarise_run(run, scenario=FACTS)
    assert report["torque"]["external_max_nm"] == pytest.approx(9.0 * JOINT)
    assert report["torque"]["friction_share"] == [*[pytest.approx(0.25)] * 5, None]
    assert report["current"] == {"actual_max_a": pytest.approx(2.5 * JOINT)}


def test_a_protective_stop_and_a_failure_are_told() -> None:
    mode = np.where(TIME < 0.4, 1.0, 3.0)[:, None]
    facts = replace(FACTS, stop_reason="force of 160 N above 150 N", failure="the simulation diverged")
    report = summarise_run(made(safety_mode=mode), scenario=facts)
    assert report["ending"]["protective_stop_s"] == pytest.approx(0.4)
    text = render_run_markdown(report, [])
    assert "**Protective stop** at 0.400 s: force of 160 N above 150 N." in text
    assert "**The run ended before its time**: the simulation diverged." in text
    calm = summarise_run(made(safety_mode=np.ones((N, 1))), scenario=FACTS)
    assert calm["ending"] == {"protective_stop_s": None, "stop_reason": None, "failure": None}
    assert "Protective stop" not in render_run_markdown(calm, [])


def test_json_holds_only_numbers_and_markdown_what_people_want() -> None:
    # A device that starts late, and a joint of which nothing is known.
    gappy = np.full((N, 6), np.nan)
    gappy[10:, :5] = 1.0
    run = with_contacts(made(actual_current=gappy), (20, 7, 0, [0.0, 0.0, 12.34]))
    report = summarise_run(run, scenario=FACTS)
    assert json.loads(render_json(report)) == report
    assert report["current"]["actual_max_a"] == [1.0] * 5 + [None]
    assert (report["samples"], report["devices"]["contact"]["rows"]) == (N, 1)
    text = render_run_markdown(report, [])
    assert text.startswith("# Pressing on a plate\n\nDown, and up again.\n")
    assert "| plate | tool | 12.3 | 0.160 | 0.008 | 0.0987 |" in text
    assert "- 0.50 to 1.20 s: movel down" in text
    assert "- 1.30 to ? s: movel up (ignored)" in text


def test_without_any_contact_it_says_so() -> None:
    report = summarise_run(with_contacts(made()), scenario=FACTS)
    assert report["contact"] == {"in_contact_s": 0.0, "pushed_s": 0.0, "touches": []}
    assert "## What the arm touched\n\nNothing." in render_run_markdown(report, [])


def test_what_it_cannot_do_without_is_named() -> None:
    robot = made().robot
    log = Recording({"robot": Table("robot", TIME, {"actual_q": robot["actual_q"]})}, "log", "lab")
    with pytest.raises(RecordingError, match="target_q"):
        summarise_run(log, scenario=FACTS)
    with pytest.raises(RecordingError, match="six and the tool"):
        replace(FACTS, links=LINKS[:6])
    with pytest.raises(ModelError, match="hammer"):
        summarise_run(
            made(actual_TCP_pose=robot["actual_q"]).with_table(Table("ft", TIME, {"ft_wrench": robot["actual_q"]})),
            scenario=replace(FACTS, tool="hammer"),
        )
