"""The report of a scenario's run: what happened, and how well the devices tell the truth, as JSON and as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ur5_twin import spatial
from ur5_twin.arm.parameters import JOINT_NAMES, load_tool
from ur5_twin.errors import RecordingError
from ur5_twin.evaluation import contacts, metrics
from ur5_twin.evaluation.reporting import closing, found_in, held_targets, numbers, short_number, versions
from ur5_twin.evaluation.tables import markdown
from ur5_twin.recording.force_sensor import on_arm, sensor_bias
from ur5_twin.recording.table import Recording, Table
from ur5_twin.spatial import WRENCH_AXES, WRENCH_UNITS

#: What ``safety_mode`` says while a protective stop holds the arm.
PROTECTIVE_STOP = 3
#: A joint moves while its target does at more than this, rad/s.
_MOVING = 1e-3
#: Columns that a run has beside those of a log, and all that this report cannot do without.
_NEEDED = (
    "target_q",
    "target_qd",
    "target_qdd",
    "actual_q",
    "truth_q",
    "truth_wrench",
    "truth_tau_ext",
    "truth_friction",
)

#: A command in words, with when it began and ended on the robot's clock, s.
Command = tuple[str, float, float]


@dataclass(frozen=True)
class RunFacts:
    """What a run's recording does not tell: the scenario, the cell it was made with, and how it ended.

    Attributes:
        name, title, description: of the scenario.
        seed: of the noise.
        tool: name of the tool at the flange, as ``load_tool`` takes it.
        controller, plant, gains, sensors: names of the models, the gains and the devices' preset.
        stop_reason: why the controller made a protective stop; None if it made none.
        failure: why the run ended before its time; None if it did not.
        obstacles: names, in the order that ``contact_obstacle`` counts.
        links: names, in the order that ``contact_link`` counts from 1: six links and the tool.
        executed, ignored: the motion commands that the controller followed, and that it did not.

    Raises:
        RecordingError: ``links`` are not seven.
    """

    name: str
    title: str
    description: str
    seed: int
    tool: str
    controller: str
    plant: str
    gains: str
    sensors: str
    stop_reason: str | None
    failure: str | None
    obstacles: tuple[str, ...]
    links: tuple[str, ...]
    executed: tuple[Command, ...]
    ignored: tuple[Command, ...]

    def __post_init__(self) -> None:
        if len(self.links) != len(contacts.LINKS):
            raise RecordingError(f"scenario '{self.name}': links are six and the tool, not {len(self.links)} names")


def summarise_run(recording: Recording, *, scenario: RunFacts) -> dict[str, Any]:
    """The report of a run as plain data; every number in it is finite, null stands where there is none.

    - ``tracking``: six numbers, joint 1 to 6. ``measured_*`` is actual_q and ``true_*`` truth_q, less the target that
      the servo holds (``reporting.held_targets``):
      ``mae_still_rad`` and ``mae_moving_rad`` over the rows where the joint's |target_qd| is at most or above
      ``moving_above_rad_s`` (null where there are none), ``max_rad`` over all.
    - ``wrench.truth``: largest force and moment of truth_wrench and when.
    - ``wrench.controller`` and ``wrench.sensor``: how -actual_TCP_force and the force sensor (its first 0.3 s taken for
      its bias) follow truth_wrench, per base axis about the flange: ``mae``, ``rmse``, ``max`` and ``bias`` (device
      minus truth) as ``force_*_n`` and ``moment_*_nm``, ``overall`` and ``in_contact``, which is while anything touches
      or pushes the arm anywhere. null where the device or such rows are missing.
    - ``contact``: seconds in contact and pushed, and for each pair of obstacle and link the largest force, when, for
      how long and the impulse in base axes. Several points of one pair are one force.
    - ``torque``: largest |truth_tau_ext|, |truth_friction| and |truth_moment| of each joint;
      ``friction_share`` is the sum of |truth_friction| over that of |truth_moment|, null where no motor works.
    - ``current``: largest |actual_current| and |target_current|.

    Args:
        recording: of a run, with the truth.
        scenario: what the recording does not tell.

    Raises:
        RecordingError: the recording is empty or lacks a column that every run has; ModelError: there is no such tool.
    """
    robot = recording.robot
    for name in _NEEDED:
        robot[name]
    if not len(robot):
        raise RecordingError(f"{recording.source}: the run has no rows")
    touched = contacts.touches(recording)
    return {
        "scenario": scenario.name,
        "title": scenario.title,
        "description": scenario.description,
        "seed": scenario.seed,
        "tool": scenario.tool,
        "model": scenario.controller,
        "plant": scenario.plant,
        "gains": scenario.gains,
        "sensors": scenario.sensors,
        "samples": len(robot),
        "duration_s": float(robot.time[-1] - robot.time[0]),
        "ending": {
            "protective_stop_s": protective_stop(robot),
            "stop_reason": scenario.stop_reason,
            "failure": scenario.failure,
        },
        "commands": {
            key: [{"what": what, "start_s": _finite(start), "end_s": _finite(end)} for what, start, end in commands]
            for key, commands in (("executed", scenario.executed), ("ignored", scenario.ignored))
        },
        "tracking": _tracking(robot),
        "wrench": _wrench(recording, scenario.tool, contacts.acting(touched, len(robot))),
        "contact": _contact(touched, robot, scenario),
        "torque": _torque(robot),
        "current": {
            f"{who}_max_a": _largest(robot[f"{who}_current"])
            for who in ("actual", "target")
            if f"{who}_current" in robot
        },
        **found_in(recording),
        "versions": versions(),
    }


def protective_stop(robot: Table) -> float | None:
    """When a protective stop first held the arm, s on the robot's clock; None if none did or the log does not tell."""
    if "safety_mode" not in robot:
        return None
    rows = np.flatnonzero(robot["safety_mode"][:, 0] == PROTECTIVE_STOP)
    return float(robot.time[rows[0]]) if len(rows) else None


def _tracking(robot: Table) -> dict[str, Any]:
    moving = np.abs(robot["target_qd"]) > _MOVING
    targets = held_targets(robot)
    section: dict[str, Any] = {"moving_above_rad_s": _MOVING}
    for who, column in (("measured", "actual_q"), ("true", "truth_q")):
        error = np.abs(robot[column] - targets)
        for how, rows in (("still", ~moving), ("moving", moving)):
            section[f"{who}_mae_{how}_rad"] = [_mean(error[rows[:, j], j]) for j in range(error.shape[1])]
        section[f"{who}_max_rad"] = _largest(error)
    return section


def _wrench(recording: Recording, tool: str, touched: np.ndarray) -> dict[str, Any]:
    aligned = recording.aligned()
    truth = aligned["truth_wrench"]
    section: dict[str, Any] = {"truth": {}}
    for what, unit, part in (("force", "n", truth[:, :3]), ("moment", "nm", truth[:, 3:])):
        size = np.linalg.norm(part, axis=1)
        row = int(np.nanargmax(size))
        section["truth"] |= {f"largest_{what}_{unit}": float(size[row]), f"largest_{what}_s": float(aligned.time[row])}
    found: dict[str, np.ndarray] = {}
    if "actual_TCP_force" in aligned:
        found["controller"] = -aligned["actual_TCP_force"]
    if "ft_wrench" in aligned and "actual_TCP_pose" in aligned:
        X_BF = spatial.pose_from_vector(aligned["actual_TCP_pose"])
        found["sensor"] = on_arm(aligned["ft_wrench"], X_BF, load_tool(tool), sensor_bias(recording))
    for who in ("controller", "sensor"):
        told = found.get(who, np.full_like(truth, np.nan))
        known = np.isfinite(told).all(axis=1) & np.isfinite(truth).all(axis=1)
        section[who] = {
            "overall": _errors(truth[known], told[known]),
            "in_contact": _errors(truth[known & touched], told[known & touched]),
        }
    return section


def _errors(truth: np.ndarray, told: np.ndarray) -> dict[str, list[float]] | None:
    """Each metric, three numbers in N and three in Nm; None without rows."""
    if not len(truth):
        return None
    found = {}
    for key, metric in (
        ("mae", metrics.mean_absolute),
        ("rmse", metrics.root_mean_square),
        ("max", metrics.largest),
        ("bias", metrics.bias),
    ):
        values = numbers(metric(truth, told))
        found |= {f"force_{key}_n": values[:3], f"moment_{key}_nm": values[3:]}
    return found


def _contact(touched: Sequence[contacts.Touch], robot: Table, scenario: RunFacts) -> dict[str, Any]:
    def seconds(mine: Sequence[contacts.Touch]) -> float:
        return int(contacts.acting(mine, len(robot)).sum()) * contacts.TICK

    touches = []
    for touch in touched:
        peak = int(np.argmax(touch.size))
        touches.append(
            {
                "obstacle": contacts.obstacle_name(touch.obstacle, scenario.obstacles),
                "link": scenario.links[touch.link - 1],
                "largest_force_n": float(touch.size[peak]),
                "largest_force_s": float(robot.time[touch.rows[peak]]),
                "duration_s": touch.duration,
                "impulse_n_s": numbers(touch.impulse),
            }
        )
    return {
        "in_contact_s": seconds([touch for touch in touched if not touch.is_push]),
        "pushed_s": seconds([touch for touch in touched if touch.is_push]),
        "touches": touches,
    }


def _torque(robot: Table) -> dict[str, Any]:
    section: dict[str, Any] = {
        "external_max_nm": _largest(robot["truth_tau_ext"]),
        "friction_max_nm": _largest(robot["truth_friction"]),
    }
    if "truth_moment" in robot:
        friction, motors = (np.nansum(np.abs(robot[f"truth_{key}"]), axis=0) for key in ("friction", "moment"))
        section["motor_max_nm"] = _largest(robot["truth_moment"])
        section["friction_share"] = [float(f / m) if m > 0 else None for f, m in zip(friction, motors, strict=True)]
    return section


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _mean(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else None


def _largest(values: np.ndarray) -> list[float | None]:
    """max |value| of each column over the rows that are numbers; None where there are none."""
    size = np.where(np.isfinite(values), np.abs(values), -1.0).max(axis=0, initial=-1.0)
    return [float(value) if value >= 0 else None for value in size]


def render_run_markdown(report: dict[str, Any], figures: list[Path]) -> str:
    """The report for people; ``figures`` are linked relative to the report's folder."""
    lines = [f"# {report['title']}", ""]
    lines += [report["description"].strip(), ""] if report["description"].strip() else []
    lines.append(
        f"Scenario **{report['scenario']}**, seed {report['seed']}: {report['samples']:,} samples, "
        f"{report['duration_s']:.2f} s. Controller model **{report['model']}**, plant **{report['plant']}**, tool "
        f"**{report['tool']}**, gains **{report['gains']}**, sensors **{report['sensors']}**."
    )
    lines += _ending(report["ending"])
    lines += ["", "## What the arm touched", "", *_touch_lines(report)]
    lines += _wrench_lines(report["wrench"])
    for title, text, rows in (
        ("How the arm follows its targets", _TRACKING_TEXT.format(1e3 * _MOVING), _tracking_rows(report["tracking"])),
        ("Torques and currents", _TORQUE_TEXT, _torque_rows(report)),
    ):
        table = markdown(
            ("quantity", "unit", *JOINT_NAMES),
            [(label, unit, *map(_shown, values)) for label, unit, values in rows],
            words=2,
        )
        lines += ["", f"## {title}", "", text, "", table]
    lines += ["", "## What it was told to do", "", *_command_lines(report["commands"])]
    devices = [(name, f"{item['rows']:,}", ", ".join(item["columns"])) for name, item in report["devices"].items()]
    lines += ["", "## Devices", ""]
    lines += [f"- {name}: {rows} rows of {columns}" for name, rows, columns in devices]
    said = [*report["notes"], *report["repairs"]]
    if said:
        lines += ["", "## Notes", "", *(f"- {item['where']}: {item['what']}" for item in said)]
    return "\n".join(lines + closing(report, figures))


_TRACKING_TEXT = (
    "Measured is actual_q, true is truth_q, less where the servo holds the joint (an idle controller publishes as "
    "target_q what it measured); a joint moves while its target does at more than {:g} mrad/s."
)
_TORQUE_TEXT = (
    "Largest sizes. Friction's share is the sum of its size over that of the motor torque's: what an estimator of "
    "force has to know of it."
)


def _ending(ending: dict[str, Any]) -> list[str]:
    lines = []
    if ending["protective_stop_s"] is not None:
        reason = f": {ending['stop_reason']}" if ending["stop_reason"] else ""
        lines += ["", f"**Protective stop** at {ending['protective_stop_s']:.3f} s{reason}."]
    elif ending["stop_reason"]:
        lines += ["", f"**Protective stop**: {ending['stop_reason']}."]
    if ending["failure"]:
        lines += ["", f"**The run ended before its time**: {ending['failure']}."]
    return lines


def _touch_lines(report: dict[str, Any]) -> list[str]:
    contact, truth = report["contact"], report["wrench"]["truth"]
    if not contact["touches"]:
        return ["Nothing."]
    rows = [
        (
            touch["obstacle"],
            touch["link"],
            short_number(touch["largest_force_n"]),
            f"{touch['largest_force_s']:.3f}",
            f"{touch['duration_s']:.3f}",
            short_number(float(np.linalg.norm(touch["impulse_n_s"]))),
        )
        for touch in contact["touches"]
    ]
    return [
        f"In contact for {contact['in_contact_s']:.2f} s, pushed for {contact['pushed_s']:.2f} s. The largest wrench "
        f"on the last link and tool: {short_number(truth['largest_force_n'])} N at {truth['largest_force_s']:.3f} s, "
        f"{short_number(truth['largest_moment_nm'])} Nm about the flange at {truth['largest_moment_s']:.3f} s.",
        "",
        markdown(
            ("obstacle", "link", "largest force, N", "at, s", "for, s", "impulse, N s"),
            rows,
            words=2,
        ),
    ]


def _wrench_lines(wrench: dict[str, Any]) -> list[str]:
    rows = []
    for who, label in (("controller", "controller's estimate"), ("sensor", "force sensor")):
        for when, words in (("overall", "overall"), ("in_contact", "in contact")):
            errors = wrench[who][when]
            if errors is not None:
                for key, name in (("mae", "MAE"), ("rmse", "RMSE"), ("max", "largest"), ("bias", "bias")):
                    values = errors[f"force_{key}_n"] + errors[f"moment_{key}_nm"]
                    rows.append((f"{label}, {words}", name, *map(short_number, values)))
    if not rows:
        return []
    axes = [f"{axis}, {unit}" for axis, unit in zip(WRENCH_AXES, WRENCH_UNITS, strict=True)]
    text = (
        "Errors against the true wrench on the last link and tool, at the flange in base axes. In contact is while "
        "anything touches or pushes the arm; bias is device minus truth. A touch further up the arm is an error of the "
        "controller's estimate, and what hangs on the sensor shows in its readings."
    )
    return ["", "## How well the devices tell the force", "", text, "", markdown(("device", "", *axes), rows, words=2)]


def _tracking_rows(tracking: dict[str, Any]) -> list[tuple[str, str, list[float | None]]]:
    kinds = (("mae_still", "MAE still"), ("mae_moving", "MAE moving"), ("max", "largest"))
    return [
        (f"{who}, {label}", "mrad", _times(tracking[f"{who}_{key}_rad"], 1e3))
        for who in ("measured", "true")
        for key, label in kinds
    ]


def _torque_rows(report: dict[str, Any]) -> list[tuple[str, str, list[float | None]]]:
    torque, current = report["torque"], report["current"]
    rows = [("external torque", "Nm", torque["external_max_nm"]), ("friction", "Nm", torque["friction_max_nm"])]
    if "motor_max_nm" in torque:
        rows.append(("motor torque", "Nm", torque["motor_max_nm"]))
        rows.append(("friction's share", "%", _times(torque["friction_share"], 100.0)))
    for key, label in (("actual", "motor current"), ("target", "target current")):
        if f"{key}_max_a" in current:
            rows.append((label, "A", current[f"{key}_max_a"]))
    return rows


def _command_lines(commands: dict[str, Any]) -> list[str]:
    given = [(item, word) for key, word in (("executed", ""), ("ignored", " (ignored)")) for item in commands[key]]
    given.sort(key=lambda pair: -1.0 if pair[0]["start_s"] is None else pair[0]["start_s"])
    lines = []
    for item, word in given:
        start, end = ("?" if item[key] is None else f"{item[key]:.2f}" for key in ("start_s", "end_s"))
        lines.append(f"- {start} to {end} s: {item['what']}{word}")
    return lines or ["Nothing."]


def _times(values: Sequence[float | None], scale: float) -> list[float | None]:
    return [None if value is None else value * scale for value in values]


def _shown(value: float | None) -> str:
    return "-" if value is None else short_number(value)
