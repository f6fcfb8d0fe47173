"""Figures of an identification."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ur5_twin.atomic import replacing
from ur5_twin.identification.results import Result


def draw_errors(result: Result, path: Path) -> Path:
    """Mean absolute error per log and joint, one panel per table of the result, as a PNG; returns its path."""
    names = [name.removeprefix("Movement_") for name in result.logs]
    figure = Figure(figsize=(10.0, 0.9 + 0.55 * len(names) * len(result.errors)), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(result.errors), 1, sharex=True, squeeze=False)[:, 0]
    largest = max(np.nanmax(values) for values in result.errors.values())
    smallest = min(values[values > 0].min(initial=largest) for values in result.errors.values())
    for panel, (label, values) in zip(panels, result.errors.items(), strict=True):
        for joint in range(6):
            panel.plot(
                np.maximum(values[:, joint], smallest), range(len(names)), "o", label=f"joint {joint + 1}", alpha=0.8
            )
        panel.set_xscale("log")
        panel.set_yticks(range(len(names)), names)
        panel.invert_yaxis()
        panel.grid(axis="both", alpha=0.3)
        panel.set_title(label, loc="left", fontsize=10)
    panels[-1].set_xlabel(f"mean absolute error, {result.unit}")
    panels[0].legend(ncols=6, fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.08), frameon=False)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=130)
    return path
