"""What ``identify plant`` leaves behind: a plant for the twin, and how far each of its numbers can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ur5_twin.arm import files
from ur5_twin.arm.drive import JointDrives
from ur5_twin.arm.parameters import N_JOINTS, ArmModel, beside_or_shipped, model_file
from ur5_twin.evaluation.tables import JOINT_COLUMNS
from ur5_twin.identification.payload_result import FILE as PAYLOAD_FILE
from ur5_twin.identification.payload_result import TABLE as PAYLOAD
from ur5_twin.identification.payload_result import table, uncertainty, words
from ur5_twin.identification.plant import PlantFit
from ur5_twin.identification.plant_check import Unseen
from ur5_twin.identification.plant_solve import FIELDS
from ur5_twin.identification.results import ModelFile, Numbers, Result, provenance, sources
from ur5_twin.recording.table import Recording

#: Names of the files, and of the table in the second one.
FILE, JOINTS, TABLE = "plant.toml", "joints.toml", "mine"


def plant_result(
    fit: PlantFit,
    unseen: Sequence[Unseen],
    base: ArmModel,
    links_from: str,
    drives: JointDrives,
    recordings: Sequence[Recording],
    command: str,
) -> Result:
    """A model file in the layout of ``models/ur5_plant.toml``, its motors and gears beside it.

    Args:
        fit: to all logs.
        unseen: each log predicted by a fit on the others; empty for a single log.
        base: links and gravity.
        links_from: the file that those links are in, as ``links_from`` names it.
        drives: what is taken where the logs do not tell.
        recordings: the logs.
        command: the command line, for provenance.
    """
    source = f"{command}, on {', '.join(sources(recordings))}"
    where = provenance(recordings, command)
    intervals = {
        name: [
            {"joint": j + 1, "unit": unit, "known": True}
            if fit.known[name][j] or np.isnan(fit.low[name][j])
            else {"joint": j + 1, "unit": unit, "low": _short(fit.low[name][j]), "high": _short(fit.high[name][j])}
            for j in range(N_JOINTS)
        ]
        for name, unit in FIELDS.items()
    }
    model: dict[str, Any] = {
        "name": "identified-plant",
        "title": "A simulated arm, identified",
        "source": source,
        "links_from": links_from,
        "joints_from": JOINTS,
        "gravity": {"value_m_s2": base.gravity, "source": base.gravity_source},
        "rotors": {"inertia_kg_m2": _six(fit.values["rotor_inertia"]), "source": source},
        "provenance": where | {"interval_95": intervals},
    }
    findings = [_finding(fit, j) for j in range(N_JOINTS)]
    findings += [
        f"the currents are reported {fit.delay * 1e3:.0f} ms late, or less than a millisecond more",
        "condition number of each joint's columns, all numbers free: " + ", ".join(f"{x:.3g}" for x in fit.condition),
        *([] if fit.payload is None else ["beyond the tool the flange carries: " + ", ".join(words(fit.payload))]),
        *fit.notes,
        "known and not fitted: masses and centres of the links and of --tool, offset, presliding and warming; an "
        "offset counts as friction that differs with the direction; viscous friction is that of these logs' "
        "temperature",
    ]  # fmt: skip
    if not np.isnan(fit.entangled).all():
        each = ("-" if np.isnan(x) else f"{x:.2f}" for x in fit.entangled)
        findings.append(f"correlation of torque constant and rotor inertia: {', '.join(each)}")
    if not unseen:
        findings.append("one log cannot check itself: give more of them to see how a fit predicts what it has not seen")
    beside = [ModelFile(JOINTS, dict[str, files.JointDrivesSpec], {TABLE: _joints(fit, drives, source)})]
    if fit.payload is not None and fit.carried is not None:
        told = where | {"uncertainty": uncertainty(fit.payload)}
        load = {PAYLOAD: table(fit.payload, "Payload that the motors carry", source, told)}
        beside.append(ModelFile(PAYLOAD_FILE, dict[str, files.ToolSpec], load))
    return Result(
        FILE,
        files.ModelFile,
        model,
        "The plant",
        tuple(findings),
        _tables(unseen),
        where,
        {
            "values": {name: fit.values[name].tolist() for name in FIELDS},
            "interval_95": intervals,
            "ripple_amplitude_standard_error_nm": fit.amplitude_error.tolist(),
            "condition": fit.condition.tolist(),
            "correlation_of_torque_constant_and_rotor_inertia": [
                None if np.isnan(x) else float(x) for x in fit.entangled
            ],
            "sliding_s": fit.sliding.tolist(),
            "delay_s": fit.delay,
        }
        | ({} if fit.payload is None else {"payload": uncertainty(fit.payload)}),
        tuple(beside),
    )


def links_of(base: str) -> str:
    """The file that a model's links are in, as ``links_from`` of a file elsewhere names it."""
    path = model_file(base)
    named = files.read(path, files.ModelFile).links_from
    links = path if named is None else beside_or_shipped(path, named)
    return links.name if links == files.model_path(links.name) else str(links.resolve())


def _joints(fit: PlantFit, base: JointDrives, source: str) -> dict[str, Any]:
    """The motors and gears in the layout of a table of ``models/ur5_joints.toml``."""
    ripple = [
        {"order": float(order), "amplitude_nm": _six(amplitude), "phase_rad": _six(phase)}
        for order, amplitude, phase in zip(fit.order, fit.amplitude, fit.phase, strict=True)
    ]
    v = fit.values
    # Rounding must not let more fade than there is.
    most = -0.99999 * np.minimum(v["coulomb_positive"], v["coulomb_negative"])
    return {
        "source": source,
        "torque_constant_nm_a": _six(v["torque_constant"]),
        "offset_nm": base.offset.tolist(),
        "coulomb_positive_nm": _six(v["coulomb_positive"]),
        "coulomb_negative_nm": _six(v["coulomb_negative"]),
        "stribeck_nm": _six(np.maximum(v["stribeck"], most)),
        "stribeck_speed_rad_s": _six(v["stribeck_speed"]),
        "load_nm_nm": _six(v["load"]),
        "viscous_nm_s_rad": _six(v["viscous"]),
        "presliding_mrad": (base.friction.presliding * 1e3).tolist(),
        "cold_viscous_ratio": base.friction.cold,
        "warming_time_s": base.friction.warming_time,
        "ripple": ripple,
    }  # fmt: skip


def _finding(fit: PlantFit, j: int) -> str:
    parts = []
    for name, unit in FIELDS.items():
        low, high = fit.low[name][j], fit.high[name][j]
        trust = "known" if fit.known[name][j] or np.isnan(low) else f"{low:.4g} to {high:.4g}"
        parts.append(f"{name.replace('_', ' ')} {fit.values[name][j]:.4g} {unit} ({trust})")
    return f"joint {j + 1}, 95 % intervals in brackets: {', '.join(parts)}"


def _tables(unseen: Sequence[Unseen]) -> tuple[Numbers, ...]:
    if not unseen:
        return ()
    logs = tuple(item.source for item in unseen)
    moving = "Mean absolute error of actual_current in motion, each log by"
    whole = "Mean absolute error of actual_current over all rows, simulated closed loop, each log by"
    what = (
        ("law", f"{moving} a fit on all the others"),
        ("base", f"{moving} the base's numbers"),
        ("target", f"{moving} target_current"),
        ("loop", f"{whole} a fit on all the others"),
        ("base_loop", f"{whole} the base's numbers"),
    )
    tables = [
        Numbers(title, "A", logs, JOINT_COLUMNS, np.stack([getattr(item, key) for item in unseen]))
        for key, title in what
    ]
    return tuple(table for table in tables if np.isfinite(table.values).any())


def _six(values: np.ndarray) -> list[float]:
    return [_short(x) for x in values]


def _short(value: float) -> float:
    """Six significant digits: finer than any interval."""
    return float(f"{value:.6g}")
