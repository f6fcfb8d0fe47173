"""What an identification leaves behind: a model file with its provenance, a report and figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from ur5_twin.arm import files
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.atomic import write_text
from ur5_twin.evaluation.reporting import render_json, short_number, versions
from ur5_twin.evaluation.tables import JOINT_COLUMNS, markdown
from ur5_twin.identification.controller import CurrentFit, RigidFit
from ur5_twin.recording.table import Recording

#: Share of the link tensors up to which a controller is said to know none, and from which on all of them.
_NO_TENSORS, _ALL_TENSORS = 0.1, 0.9


@dataclass(frozen=True)
class Numbers:
    """A table of a report.

    Attributes:
        title: what the numbers are.
        unit: of all of them, or a word like "ratio".
        rows, columns: their names; a log's folder name, a joint, an axis.
        values: (n_rows, n_columns); NaN where there is none.
    """

    title: str
    unit: str
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    values: np.ndarray

    def __post_init__(self) -> None:
        if self.values.shape != (len(self.rows), len(self.columns)):
            raise ValueError(f"{self.title}: {self.values.shape} numbers for {len(self.rows)} x {len(self.columns)}")


class ModelFile(NamedTuple):
    """A model file: its name, what a reader checks it against, and its content in the layout of ``models/*.toml``."""

    name: str
    layout: Any
    content: dict[str, Any]


@dataclass(frozen=True)
class Result:
    """What an identification found: a model file, and what a report says about it.

    Attributes:
        file: name of the model file.
        layout: what a reader of that file checks it against.
        model: its content, in the layout of ``models/*.toml``; None if there is nothing to put in a file.
        title: what was identified.
        findings: sentences for the report.
        tables: for the report, errors and uncertainties.
        provenance: command, logs and versions, as ``provenance`` gives them.
        data: what ``report.json`` has besides.
        others: further model files.
    """

    file: str
    layout: Any
    model: dict[str, Any] | None
    title: str
    findings: tuple[str, ...]
    tables: tuple[Numbers, ...]
    provenance: dict[str, Any]
    data: dict[str, Any] = field(default_factory=dict)
    others: tuple[ModelFile, ...] = ()

    @property
    def files(self) -> tuple[ModelFile, ...]:
        """All of its model files."""
        own = () if self.model is None else (ModelFile(self.file, self.layout, self.model),)
        return *own, *self.others


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
        "provenance": provenance(recordings, command)
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
    if held_out is not None and np.isnan(held_out).any():
        findings.append("where the report has '-' instead of an error, the other logs alone could not carry the fit")
    shipped = f"With the model that ships ({base.name}) gravity is {base.gravity:g} m/s^2 and the rotors are "
    findings.append(shipped + ", ".join(f"{value:.6g}" for value in base.rotor_inertia) + " kg m^2")
    title = "Mean absolute error of target_moment, each log by a fit on all the others"
    return Result(
        "controller.toml",
        files.ModelFile,
        model,
        "The controller's own model",
        tuple(findings),
        () if held_out is None else (Numbers(title, "uNm", sources(recordings), JOINT_COLUMNS, 1e6 * held_out),),
        provenance(recordings, command),
    )


def current_result(fit: CurrentFit, recordings: Sequence[Recording], command: str) -> Result:
    """The controller's current law in the layout of ``models/target_current.toml``."""
    source = f"identified from target_current of {_names(recordings)}"
    law = fit.law(source)
    logs = sources(recordings)
    model = {
        "source": source,
        "torque_constant_nm_a": law.torque_constant.tolist(),
        "load_a_nm": law.load.tolist(),
        "viscous_driving_a_s_rad": law.viscous_driving.tolist(),
        "viscous_backdriven_a_s_rad": law.viscous_backdriven.tolist(),
        "provenance": provenance(recordings, command)
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
    errors = (
        ("with each log's own viscous coefficients", fit.mae),
        ("with their mean, which the file has", fit.mae_common),
    )
    return Result(
        "target_current.toml",
        files.TargetCurrentSpec,
        model,
        "The controller's current law",
        tuple(findings),
        tuple(
            Numbers(f"Mean absolute error of target_current {which}", "mA", logs, JOINT_COLUMNS, 1e3 * values)
            for which, values in errors
        ),
        provenance(recordings, command),
    )


def write(result: Result, folder: Path, figures: Sequence[Path] = ()) -> str:
    """Write the model files, ``report.json`` and ``report.md`` into a folder; returns the report's tables.

    Args:
        result: what was found.
        folder: where to.
        figures: drawn before, in a folder beneath it, linked in the report.

    Raises:
        ModelError: the fit found what no such file may hold, a negative coefficient say; nothing is written.
    """
    for file in result.files:
        files.convert(file.content, file.layout, file.name)
    tables = "\n\n".join(_table(table) for table in result.tables)
    # The file that may name the others comes last.
    for file in reversed(result.files):
        write_text(folder / file.name, tomli_w.dumps(file.content))
    data = {
        "title": result.title,
        "findings": result.findings,
        "tables": [
            {
                "title": table.title,
                "unit": table.unit,
                "rows": table.rows,
                "columns": table.columns,
                "values": [[float(x) if np.isfinite(x) else None for x in row] for row in table.values],
            }
            for table in result.tables
        ],
        **result.data,
        "provenance": result.provenance,
    }
    write_text(folder / "report.json", render_json(data))
    lines = [f"# {result.title}", "", f"Command: `{result.provenance['command']}`", ""]
    lines += [f"- {finding}" for finding in result.findings]
    lines += ["", tables] if tables else []
    for figure in figures:
        lines += ["", f"![{figure.stem}]({figure.parent.name}/{figure.name})"]
    write_text(folder / "report.md", "\n".join([*lines, ""]))
    return tables


def sources(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Names of the logs."""
    return tuple(recording.source for recording in recordings)


def provenance(recordings: Sequence[Recording], command: str) -> dict[str, Any]:
    """Where a fit comes from: command line, logs and versions."""
    return {"command": command, "logs": list(sources(recordings)), "versions": versions()}


def _table(table: Numbers) -> str:
    rows = [
        (name.removeprefix("Movement_"), *map(short_number, values))
        for name, values in zip(table.rows, table.values, strict=True)
    ]
    return f"{table.title}, {table.unit}:\n\n{markdown(('', *table.columns), rows)}"


def _names(recordings: Sequence[Recording]) -> str:
    return ", ".join(sources(recordings))
