"""What ``identify drive`` writes: motors and gears for the twin, and how well such a fit predicts new logs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from ur5_twin.arm import files
from ur5_twin.atomic import write_text
from ur5_twin.evaluation.reporting import short_number, versions
from ur5_twin.evaluation.tables import JOINT_COLUMNS, markdown
from ur5_twin.identification.drive import HeldOut
from ur5_twin.identification.drive_plant import PlantDrive

#: Name of the file, and of its table.
FILE, TABLE = "joints.toml", "mine"


def write(plant: PlantDrive, held_out: Sequence[HeldOut], folder: Path, logs: Sequence[str], command: str) -> str:
    """Write ``joints.toml``, ``report.md`` and ``report.json``; returns the report's table.

    Args:
        plant: the fit to all logs.
        held_out: each log predicted by a fit on the others; empty for a single log.
        folder: where to.
        logs: names of the logs.
        command: the command line, for provenance.

    Raises:
        ModelError: the fit found what no such file may hold; nothing is written.
    """
    table = {TABLE: plant.table(f"{command}, on {', '.join(logs)}")}
    files.convert(table, dict[str, files.JointDrivesSpec], FILE)
    shown = _markdown(held_out)
    data: dict[str, Any] = {
        "logs": list(logs),
        "held_out": [
            {
                "log": item.source,
                **{key: _known(getattr(item, key)) for key in HeldOut._fields if key != "source"},
                "ratio": _known(item.ratio),
            }
            for item in held_out
        ],
        "ripple_amplitude_standard_error_nm": plant.amplitude_errors.tolist(),
        "provenance": {"command": command, "versions": versions()},
    }
    write_text(folder / FILE, tomli_w.dumps(table))
    write_text(folder / "report.md", f"# Drives\n\nCommand: `{command}`\n\n{shown}\n")
    write_text(folder / "report.json", json.dumps(data, indent=2, allow_nan=False) + "\n")
    return shown


def _markdown(held_out: Sequence[HeldOut]) -> str:
    if not held_out:
        return "One log cannot check itself: give more of them to see how a fit predicts what it has not seen."
    rows = []
    for item in held_out:
        name = item.source.removeprefix("Movement_")
        for what, values in (
            ("moving, A", item.moving),
            ("moving, target_current's, A", item.own_moving),
            ("at rest, A", item.resting),
            ("at rest, target_current's, A", item.own_resting),
            ("all, over target_current's", item.ratio),
        ):
            rows.append((name, what, *map(short_number, values)))
    text = "Mean absolute error of actual_current for each log by a fit on all the others, without measured errors:"
    return f"{text}\n\n{markdown(('log', 'rows', *JOINT_COLUMNS), rows, words=2)}"


def _known(values: np.ndarray) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]
