"""What an identification leaves behind: a model file with its provenance, a report and figures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from ur5_twin.arm import files
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.atomic import write_text
from ur5_twin.evaluation.replay_report import versions
from ur5_twin.evaluation.tables import JOINT_COLUMNS, markdown
from ur5_twin.identification.controller import CurrentFit, RigidFit
from ur5_twin.recording.table import Recording

#: Share of the link tensors up to which a controller is said to know none, and from which on all of them.
_NO_TENSORS, _ALL_TENSORS = 0.1, 0.9


@dataclass(frozen=True)
class Result:
    """An identified model.

    Attributes:
        file: name of the model file.
        layout: what a reader of that file checks it against.
        model: its content, in the layout of ``models/*.toml``.
        title: what was identified.
        findings: sentences for the report.
        unit: of the errors.
        errors: label -> (n_logs, 6) mean absolute errors.
        logs: names of the logs, in the order of the errors' rows.
    """

    file: str
    layout: type[files.Strict]
    model: dict[str, Any]
    title: str
    findings: tuple[str, ...]
    unit: str
    errors: dict[str, np.ndarray]
    logs: tuple[str, ...]


def controller_result(
    fit: RigidFit, held_out: np.ndarray | None, base: ArmModel, recordings: Sequence[Recording], command: str
) -> Result:
    """The controller's rigid-body model as a file that ``--model`` takes; ``held_out`` is ``held_out_moment``'s."""
    source = f"identified from target_moment of {_names(recordings)}"
    knows = "cylinders" if fit.knows_tensors else "point"
    model = {
        "name": "identified-controller",
        "title": "A controller's own model, identified",
        "source": source,
        "links_from": "ur5_model_c.toml",
        "gravity": {"value_m_s2": fit.gravity, "source": source},
        "rotors": {"inertia_kg_m2": fit.rotor_inertia.tolist(), "source": source},
        "inertia": {"kind": knows, "source": f"{source}: a share of {fit.tensor_share:.2g} of model C's tensors"},
        "changes": [{"link": 6, "center_mm": [0.0, 0.0, fit.link6_z * 1e3], "source": source}],
        "provenance": _provenance(recordings, command)
        | {
            "std": {
                "gravity_m_s2": fit.gravity_std,
                "rotor_inertia_kg_m2": fit.rotor_inertia_std.tolist(),
                "link6_z_mm": fit.link6_z_std * 1e3,
                "tensor_share": fit.tensor_share_std,
            }
        },
    }
    findings = [
        f"gravity {fit.gravity:.6f} m/s^2 (one standard deviation {fit.gravity_std:.1e})",
        f"share of model C's link tensors {fit.tensor_share:.2g} ({fit.tensor_share_std:.1e}): the file has "
        + ("all of them" if knows == "cylinders" else "none"),
        f"mass centre of link 6 {fit.link6_z * 1e3:.4f} mm along the flange's axis ({fit.link6_z_std * 1e3:.1e})",
        *(
            f"rotor inertia of joint {j} {value:.6f} kg m^2 ({std:.1e})"
            for j, (value, std) in enumerate(zip(fit.rotor_inertia, fit.rotor_inertia_std, strict=True), start=1)
        ),
    ]
    if _NO_TENSORS < fit.tensor_share < _ALL_TENSORS:
        findings.append(
            "that share is neither none nor all: masses or centres differ from table 4.2's, or a payload is set"
        )
    if held_out is not None and np.isnan(held_out).all():
        findings.append("no log can be checked: without it the others cannot carry the fit")
        held_out = None
    errors = {} if held_out is None else {"target_moment, each log by a fit on all the others": held_out}
    if held_out is not None and np.isnan(held_out).any():
        findings.append("where the report has '-' instead of an error, the other logs alone could not carry the fit")
    shipped = f"With the model that ships ({base.name}) gravity is {base.gravity:g} m/s^2 and the rotors are "
    findings.append(shipped + ", ".join(f"{value:.6g}" for value in base.rotor_inertia) + " kg m^2")
    logs = tuple(recording.source for recording in recordings)
    return Result(
        "controller.toml", files.ModelFile, model, "The controller's own model", tuple(findings), "Nm", errors, logs
    )


def current_result(fit: CurrentFit, recordings: Sequence[Recording], command: str) -> Result:
    """The controller's current law in the layout of ``models/target_current.toml``."""
    source = f"identified from target_current of {_names(recordings)}"
    law = fit.law(source)
    logs = tuple(recording.source for recording in recordings)
    model = {
        "source": source,
        "torque_constant_nm_a": law.torque_constant.tolist(),
        "load_a_nm": law.load.tolist(),
        "viscous_driving_a_s_rad": law.viscous_driving.tolist(),
        "viscous_backdriven_a_s_rad": law.viscous_backdriven.tolist(),
        "provenance": _provenance(recordings, command)
        | {
            "viscous_by_log": [
                {"log": name, "driving_a_s_rad": driving.tolist(), "backdriven_a_s_rad": backdriven.tolist()}
                for name, driving, backdriven in zip(logs, *fit.viscous, strict=True)
            ]
        },
    }
    findings = [
        f"joint {j}: {k:.4f} Nm/A at rest, load {load:.5f} A/Nm, viscous {driving:.4f} driving and {back:.4f} "
        f"back-driven A s/rad (ratio {back / driving:.3f})"
        for j, (k, load, driving, back) in enumerate(
            zip(fit.torque_constant, fit.load, *fit.viscous_mean, strict=True), start=1
        )
    ]
    errors = {
        "target_current with each log's own viscous coefficients": fit.mae,
        "target_current with their mean, which the file has": fit.mae_common,
    }
    return Result(
        "target_current.toml",
        files.TargetCurrentSpec,
        model,
        "The controller's current law",
        tuple(findings),
        "A",
        errors,
        logs,
    )


def write(result: Result, folder: Path, figure: Path | None) -> None:
    """Write the model file, ``report.json`` and ``report.md`` into a folder; ``figure`` is linked in the report.

    Raises:
        ModelError: the fit found what no such file may hold, a negative coefficient say; nothing is written.
    """
    files.convert(result.model, result.layout, result.file)
    write_text(folder / result.file, tomli_w.dumps(result.model))
    data = {
        "title": result.title,
        "logs": result.logs,
        "findings": result.findings,
        "unit": result.unit,
        "mae": {
            label: [row.tolist() if np.isfinite(row).all() else None for row in values]
            for label, values in result.errors.items()
        },
        "provenance": result.model["provenance"],
    }
    write_text(folder / "report.json", json.dumps(data, indent=2) + "\n")
    write_text(folder / "report.md", _markdown(result, figure))


def _markdown(result: Result, figure: Path | None) -> str:
    lines = [f"# {result.title}", "", f"Command: `{result.model['provenance']['command']}`", ""]
    lines += [f"- {finding}" for finding in result.findings]
    for label, values in result.errors.items():
        lines += ["", f"Mean absolute error of {label}, {result.unit}:", ""]
        rows = [
            (name, *(f"{value:.2g}" if np.isfinite(value) else "-" for value in row))
            for name, row in zip(result.logs, values, strict=True)
        ]
        lines.append(markdown(("log", *JOINT_COLUMNS), rows))
    if figure is not None:
        lines += ["", f"![errors]({figure.parent.name}/{figure.name})"]
    return "\n".join([*lines, ""])


def _names(recordings: Sequence[Recording]) -> str:
    return ", ".join(recording.source for recording in recordings)


def _provenance(recordings: Sequence[Recording], command: str) -> dict[str, Any]:
    return {"command": command, "logs": [recording.source for recording in recordings], "versions": versions()}
