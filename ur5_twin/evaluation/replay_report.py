"""The report of a replay: numbers that can be cited, as JSON and as Markdown."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ur5_twin.arm.parameters import JOINT_NAMES
from ur5_twin.evaluation import metrics
from ur5_twin.evaluation.reporting import closing, found_in, held_targets, numbers, short_number, versions
from ur5_twin.evaluation.tables import markdown
from ur5_twin.recording.table import Recording
from ur5_twin.twin.replay import ReplaySettings

#: A change of a current worth comparing, A, and how many rows of it a correlation needs.
_CHANGE, _ENOUGH = 0.3, 50


@dataclass(frozen=True)
class Comparison:
    """One row of the report: a signal of the log against the twin's prediction of it.

    Attributes:
        section, key: where it stands in ``report.json``: ``<section>.<key>mae_<unit>`` and so on.
        signal: RTDE name in the log; the prediction is ``sim_<signal>``.
        unit: SI unit as it stands in the keys.
        label, shown_unit, scale: how a reader sees it: the number times ``scale`` is in ``shown_unit``.
    """

    section: str
    key: str
    signal: str
    unit: str
    label: str
    shown_unit: str
    scale: float


COMPARISONS = (
    Comparison("tracking", "q_", "actual_q", "rad", "position", "mrad", 1e3),
    Comparison("tracking", "qd_", "actual_qd", "rad_s", "velocity", "mrad/s", 1e3),
    Comparison("target_moment", "", "target_moment", "nm", "target torque", "Nm", 1.0),
    Comparison("target_current", "", "target_current", "a", "target current", "A", 1.0),
    Comparison("actual_current", "", "actual_current", "a", "motor current", "A", 1.0),
)


def summarise(recording: Recording, settings: ReplaySettings) -> dict[str, Any]:
    """The report of a replayed recording as plain data.

    Each of ``tracking.q_*_rad``, ``tracking.qd_*_rad_s``, ``target_moment.*_nm``, ``target_current.*_a`` and
    ``actual_current.*_a`` holds six numbers, joint 1 to 6, for ``mae``, ``max`` and ``bias`` (predicted minus
    measured); a section is missing where the log lacks the signal. ``target_moment.closed_loop_mae_nm`` compares the
    torque of the twin's own control law instead of the inverse dynamics of the target motion, and
    ``actual_current.controller_mae_a`` the controller's own target_current instead of the twin's prediction.
    """
    robot = recording.robot
    report: dict[str, Any] = {
        "source": recording.source,
        "format": recording.format,
        "mode": settings.mode,
        "model": settings.model.name,
        "plant": settings.plant.name,
        "tool": settings.plant.tool.name if settings.plant.tool else "none",
        "payload": settings.model.tool.name if settings.model.tool else "none",
        "gains": settings.gains.name,
        "drive": settings.drive.name,
        "samples": len(robot),
        "duration_s": float(robot.time[-1] - robot.time[0]),
    }
    for item in COMPARISONS:
        if item.signal not in robot or f"sim_{item.signal}" not in robot:
            continue
        pair = robot[item.signal], robot[f"sim_{item.signal}"]
        section = report.setdefault(item.section, {})
        section[f"{item.key}mae_{item.unit}"] = numbers(metrics.mean_absolute(*pair))
        section[f"{item.key}max_{item.unit}"] = numbers(metrics.largest(*pair))
        section[f"{item.key}bias_{item.unit}"] = numbers(metrics.bias(*pair))
    if "target_moment" in report:
        closed_loop = metrics.mean_absolute(robot["target_moment"], robot["sim_moment"])
        report["target_moment"]["closed_loop_mae_nm"] = numbers(closed_loop)
    if settings.joints is not None and settings.mode == "servo":
        report["joints"] = settings.joints.source
        report["wrench"] = settings.wrench
        _add_push(report, recording)
    if "actual_current" in robot and "target_current" in robot:
        own = metrics.mean_absolute(robot["actual_current"], robot["target_current"])
        report["actual_current"]["controller_mae_a"] = numbers(own)
    report |= found_in(recording)
    report["sources"] = {
        "model": settings.model.source,
        "plant": settings.plant.source,
        "gains": settings.gains.source,
        "drive": settings.drive.source,
        "target_current": settings.target_current.source,
    }
    report["versions"] = versions()
    return report


def _add_push(report: dict[str, Any], recording: Recording) -> None:
    """How the simulated servo and drives answer beside the real ones.

    ``tracking.error_max_*_rad``: largest distance of each joint from where the servo holds it, measured and twin.
    ``current_change``: what pushes and friction do to the currents, actual_current minus target_current, where it is
    above 0.3 A: rows, correlation and slope of the twin's against the measured one; null where there are too few rows.
    """
    robot = recording.robot
    targets = held_targets(robot)
    for who, column in (("measured", "actual_q"), ("twin", "sim_actual_q")):
        report["tracking"][f"error_max_{who}_rad"] = numbers(metrics.largest(robot[column], targets))
    if "actual_current" not in robot or "target_current" not in robot:
        return
    measured = robot["actual_current"] - robot["target_current"]
    twin = robot["sim_actual_current"] - robot["sim_target_current"]
    changed = (np.abs(measured) > _CHANGE) & np.isfinite(twin)
    likeness = [
        metrics.likeness(measured[rows, joint], twin[rows, joint]) if rows.sum() >= _ENOUGH else None
        for joint, rows in enumerate(changed.T)
    ]
    report["current_change"] = {
        "threshold_a": _CHANGE,
        "rows": [int(rows.sum()) for rows in changed.T],
        "correlation": [None if item is None else item[0] for item in likeness],
        "slope": [None if item is None else item[1] for item in likeness],
    }


def table_rows(report: dict[str, Any]) -> list[tuple[str, str, list[float]]]:
    """Label, unit and six numbers of each mean absolute error in the report, in the units a reader wants."""
    rows = []
    for item in COMPARISONS:
        values = report.get(item.section, {}).get(f"{item.key}mae_{item.unit}")
        if values is not None:
            rows.append((item.label, item.shown_unit, [value * item.scale for value in values]))
    own = report.get("actual_current", {}).get("controller_mae_a")
    if own is not None:
        rows.append(("controller's own", "A", own))
    return rows


def answer_rows(report: dict[str, Any]) -> list[tuple[str, str, list[float]]]:
    """The same for how servo and drives answer to pushes and friction; no rows if the twin did not simulate them."""
    rows = []
    for who in ("measured", "twin"):
        values = report["tracking"].get(f"error_max_{who}_rad")
        if values is not None:
            rows.append((f"largest position error, {who}", "mrad", [value * 1e3 for value in values]))
    change = report.get("current_change")
    if change is not None:
        for key in ("correlation", "slope"):
            values = [math.nan if value is None else value for value in change[key]]
            rows.append((f"current change, {key} of the twin's", "", values))
    return rows


def render_markdown(report: dict[str, Any], figures: list[Path]) -> str:
    """The report for people; ``figures`` are linked relative to the report's folder."""
    lines = [
        f"# Replay of {report['source']}",
        "",
        f"{report['samples']:,} samples, {report['duration_s']:.2f} s. Mode **{report['mode']}**, controller model "
        f"**{report['model']}**, plant **{report['plant']}**, tool **{report['tool']}**, gains **{report['gains']}**, "
        f"drive **{report['drive']}**.",
        "",
        "Mean absolute error of the twin's prediction against the log, per joint:",
        "",
        markdown(
            ("signal", "unit", *JOINT_NAMES),
            [(label, unit, *map(short_number, values)) for label, unit, values in table_rows(report)],
            words=2,
        ),
    ]
    answers = answer_rows(report)
    if answers:
        lines += [
            "",
            "## How the servo and the drives answer",
            "",
            "Position errors are distances from where the servo holds the joint. A current's change is actual_current "
            f"minus target_current, compared where it is above {_CHANGE} A:",
            "",
            markdown(
                ("quantity", "unit", *JOINT_NAMES),
                [(label, unit, *map(short_number, values)) for label, unit, values in answers],
                words=2,
            ),
        ]
    for title, key, none in (
        ("What the reader found in the log", "notes", "Nothing worth a word."),
        ("What was repaired", "repairs", "Nothing."),
    ):
        lines += ["", f"## {title}", ""]
        lines += [f"- {item['where']}: {item['what']}" for item in report[key]] or [none]
    return "\n".join(lines + closing(report, figures))
