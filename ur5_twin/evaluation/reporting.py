"""What every report has: versions, devices, figures, and numbers as people and JSON read them."""

from __future__ import annotations

import json
import math
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from ur5_twin import __version__
from ur5_twin.control.held import commanded
from ur5_twin.recording.table import Recording, Table

_LIBRARIES = ("mujoco", "dm-control", "numpy", "scipy", "numba", "polars")


def versions() -> dict[str, str]:
    """Versions of this package, Python and the libraries that shape the numbers."""
    found = {"ur5-twin": __version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def found_in(recording: Recording) -> dict[str, Any]:
    """``devices`` with their rows and columns (the twin's predictions left out), ``notes`` and ``repairs``."""
    return {
        "devices": {
            name: {"rows": len(table), "columns": sorted(c for c in table.columns if not c.startswith("sim_"))}
            for name, table in recording.tables.items()
        },
        "notes": [{"where": n.where, "what": n.what} for n in recording.notes if not n.repaired],
        "repairs": [{"where": n.where, "what": n.what} for n in recording.notes if n.repaired],
    }


def held_targets(robot: Table) -> np.ndarray:
    """(n, 6) where the servo holds the joints, rad: target_q, or while the controller is idle its last.

    An idle controller publishes as target_q what it measured (``sources.recorded.commanded``).
    """
    return commanded(np.stack([robot[f"target_{name}"] for name in ("q", "qd", "qdd")], axis=1))[:, 0]


def render_json(report: dict[str, Any]) -> str:
    """A report as ``report.json`` holds it; a number that is not finite is an error of the report's."""
    return json.dumps(report, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def short_number(value: float) -> str:
    """A number in at most six characters, for a table."""
    if value == 0:
        return "0"
    if not math.isfinite(value):
        return "-"
    if value < 0:
        return f"-{short_number(-value)}"
    if value < 1e-4:
        return "<1e-4"
    return f"{value:.{max(0, min(4, 2 - math.floor(math.log10(value))))}f}"


def closing(report: dict[str, Any], figures: list[Path]) -> list[str]:
    """The last lines of a report in Markdown: its figures, linked relative to its folder, and the versions."""
    lines = []
    if figures:
        lines += ["", "## Figures", ""]
        lines += [f"![{path.stem}]({path.parent.name}/{path.name})" for path in figures]
    return [*lines, "", "## Versions", "", ", ".join(f"{key} {value}" for key, value in report["versions"].items()), ""]


def numbers(values: np.ndarray) -> list[float]:
    """An array of joints or axes as JSON takes it."""
    return [float(value) for value in values]
