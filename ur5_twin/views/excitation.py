"""Figures of an exciting motion: the joints' paths, the flange's way in its box, what it tells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ur5_twin.identification.excite import Excitation
from ur5_twin.twin.cell import PERIOD
from ur5_twin.views import paper
from ur5_twin.views.style import MEASURED, TARGET, TRUTH, TWIN

#: Edges of a box as pairs of corners, a corner as low (0) or high (1) in x, y, z.
_EDGES = [
    (a, b)
    for a in np.ndindex(2, 2, 2)
    for b in np.ndindex(2, 2, 2)
    if a < b and sum(abs(i - j) for i, j in zip(a, b, strict=True)) == 1
]


def draw_excitation(found: Excitation, folder: Path) -> list[Path]:
    """Draw all figures into a folder; returns their paths."""
    return [
        _joints(found, folder / "joints.png"),
        _way(found, folder / "way.png"),
        _errors(found, folder / "standard_errors.png"),
    ]


def _joints(found: Excitation, path: Path) -> Path:
    rows, bounds = found.trial.reference, found.workspace.bounds
    time = np.arange(len(rows)) * PERIOD
    figure = paper.new_figure(11.0, 9.0, "What the controller plans")
    axes = paper.panels(figure, 6, 2)
    for j in range(6):
        left, right = axes[j]
        paper.line(left, time, rows[:, 0, j], TARGET, 1.0)
        for limit in (bounds.low[j], bounds.high[j]):
            left.axhline(limit, color=TWIN, linewidth=0.8, linestyle=":")
        paper.line(right, time, rows[:, 1, j], MEASURED, 1.0)
        paper.name(left, f"joint {j + 1}, rad")
        paper.name(right, f"joint {j + 1}, rad/s")
    return paper.save(figure, path)


def _way(found: Excitation, path: Path) -> Path:
    bounds = found.workspace.bounds
    figure: Figure = paper.new_figure(7.5, 7.0, "Flange and tool's end, as the twin moved")
    panel = figure.add_subplot(projection="3d")
    every = found.trial.moved[::3, 0]
    ways = found.workspace.points(every)
    for points, colour, label in zip(ways, (MEASURED, TRUTH), ("flange", "tool's end"), strict=False):
        panel.plot(*points.T, color=colour, linewidth=0.7, label=label)
    everything = np.concatenate(ways)
    low, high = everything.min(axis=0), everything.max(axis=0)
    corner = np.stack(
        [
            np.where(np.isfinite(bounds.box[:, 0]), bounds.box[:, 0], low),
            np.where(np.isfinite(bounds.box[:, 1]), bounds.box[:, 1], high),
        ]
    )
    if np.isfinite(bounds.box).any():
        for a, b in _EDGES:
            ends = np.stack([[corner[i, axis] for axis, i in enumerate(at)] for at in (a, b)])
            panel.plot(*ends.T, color=TWIN, linewidth=0.9, linestyle=":")
    panel.plot(*np.array([[0, 0, 0], [0, 0, 0.15]]).T, color=TARGET, linewidth=4.0, label="base")
    panel.set(xlabel="x, m", ylabel="y, m", zlabel="z, m")
    panel.set_aspect("equal")
    panel.legend(loc="upper right", fontsize=8, frameon=False)
    return paper.save(figure, path)


def _errors(found: Excitation, path: Path) -> Path:
    parameters = found.question.parameters
    scale = np.array([parameter.scale for parameter in parameters])
    figure = paper.new_figure(9.0, 1.6 + 0.2 * len(parameters), "Predicted standard error over the parameter's size")
    panel = figure.subplots(
        gridspec_kw={"left": 0.3, "right": 0.97, "top": 1.0 - 0.8 / figure.get_figheight(), "bottom": 0.06}
    )
    paper.dress(panel)
    rows = np.arange(len(parameters))
    lines = [
        (found.before, TARGET, "random postures"),
        *((errors, TWIN, name) for name, errors in found.beside.items()),
        (found.planned, MEASURED, "this motion"),
        (found.achieved, TRUTH, "as the twin moved"),
    ]
    for errors, colour, label in lines:
        panel.plot(errors / scale, rows, "o", color=colour, label=label, alpha=0.8, markersize=4)
    panel.set_xscale("log")
    panel.set_yticks(rows, [parameter.label.replace("_", " ") for parameter in parameters])
    panel.set_ylim(len(parameters) - 0.4, -0.6)
    panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, frameon=False, fontsize=8)
    return paper.save(figure, path)
