"""Figures of an identification."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ur5_twin.atomic import replacing
from ur5_twin.identification.results import Numbers


def draw_errors(tables: Sequence[Numbers], path: Path) -> Path:
    """Errors per log and joint, one panel per table, as a PNG; returns its path."""
    figure = Figure(figsize=(10.0, 0.9 + 0.55 * sum(len(table.rows) for table in tables)), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(tables), 1, sharex=True, squeeze=False)[:, 0]
    largest = max(np.nanmax(table.values) for table in tables)
    smallest = min(table.values[table.values > 0].min(initial=largest) for table in tables)
    for panel, table in zip(panels, tables, strict=True):
        names = [name.removeprefix("Movement_") for name in table.rows]
        for column, label in enumerate(table.columns):
            panel.plot(np.maximum(table.values[:, column], smallest), range(len(names)), "o", label=label, alpha=0.8)
        panel.set_xscale("log")
        panel.set_yticks(range(len(names)), names)
        panel.invert_yaxis()
        panel.grid(axis="both", alpha=0.3)
        panel.set_title(table.title, loc="left", fontsize=10)
        panel.set_xlabel(table.unit)
    panels[0].legend(ncols=6, fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.08), frameon=False)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=130)
    return path
