"""Figures of a replayed recording, as PNG files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ur5_twin import spatial
from ur5_twin.arm.parameters import JOINT_NAMES, Tool
from ur5_twin.recording.table import Recording, Table
from ur5_twin.views import paper, wrenches
from ur5_twin.views.style import MEASURED, QUANTITIES, TWIN, WRENCH_AXES, WRENCH_UNITS, Quantity, has

_WIDTH = 13.0


def write_figures(recording: Recording, folder: Path, *, title: str, tool: Tool | None = None) -> list[Path]:
    """Draw a replayed recording.

    Args:
        recording: a replayed recording, or any other: a figure whose columns are missing is left out.
        folder: where to write; made if it is not there.
        title: what was replayed; stands over every figure.
        tool: the tool at the flange; if it carries the force sensor its moments are drawn about the flange.

    Returns:
        The files, in the order in which one would look at them: position, velocity, torque, current, tcp_path, wrench.
    """
    drawn = {quantity.key: _quantity(recording.robot, quantity, title) for quantity in QUANTITIES}
    drawn["tcp_path"] = _tcp_path(recording.robot, title)
    drawn["wrench"] = _wrench(recording, title, tool)
    return [paper.save(figure, folder / f"{key}.png") for key, figure in drawn.items() if figure is not None]


def _quantity(table: Table, quantity: Quantity, title: str) -> Figure | None:
    """A row per joint: the signal on the left, what is left between its lines on the right."""
    series, differences = quantity.series_in(table), quantity.differences_in(table)
    if not series:
        return None
    figure = paper.new_figure(_WIDTH, 12.0, quantity.title, title)
    axes = paper.panels(figure, len(JOINT_NAMES), 2 if differences else 1)
    for joint, joint_name in enumerate(JOINT_NAMES):
        panel = axes[joint, 0]
        paper.name(panel, joint_name)
        for rank, item in enumerate(series):
            paper.line(panel, table.time, table[item.column][:, joint], item.colour, rank, item.label)
        # A joint that stands still would fill its panel with the last digit of its encoder.
        panel.set_ylim(paper.wide(panel.get_ylim(), 0.01))
        # Last to first, so that the twin's own line lies on top.
        for row, item in reversed(list(enumerate(differences))):
            error = item.values(table)[:, joint] * quantity.error_scale
            paper.line(axes[joint, 1], table.time, error, item.colour, 2, item.label)
            rms, mae = paper.rms_and_mae(error)
            paper.remark(axes[joint, 1], f"RMS {rms:.3g}  MAE {mae:.3g} {quantity.error_unit}", item.colour, row)
    paper.legend(axes[0, 0], f"{quantity.title}, {quantity.unit}")
    if differences:
        paper.legend(axes[0, 1], f"{quantity.error_title}, {quantity.error_unit}")
    return figure


def _tcp_path(table: Table, title: str) -> Figure | None:
    """The flange's path in space, and over time its coordinates and how far the twin is off."""
    if not has(table, "actual_TCP_pose") or not has(table, "sim_actual_TCP_pose"):
        return None
    measured, twin = table["actual_TCP_pose"][:, :3], table["sim_actual_TCP_pose"][:, :3]
    figure = paper.new_figure(_WIDTH, 7.5, "Path of the flange", title)
    axes = paper.panels(figure, 4, 2)
    for panel in axes[:, 0]:
        panel.remove()
    space = figure.add_axes((0.0, 0.03, 0.48, 0.88), projection="3d", computed_zorder=False)
    every = max(1, len(measured) // 2000)
    for path, colour, width, label in ((measured, MEASURED, 3.0, "measured"), (twin, TWIN, 1.0, "twin")):
        space.plot(*path[::every].T, color=colour, linewidth=width, label=label)
    space.set(xlabel="x, m", ylabel="y, m", zlabel="z, m", aspect="equal")
    space.tick_params(labelsize=8)
    space.legend(loc="upper left", frameon=False, fontsize=9)
    for panel, coordinate, label in zip(axes[:3, 1], range(3), "xyz", strict=True):
        paper.name(panel, f"{label}, m")
        paper.line(panel, table.time, measured[:, coordinate], MEASURED, 0, "measured")
        paper.line(panel, table.time, twin[:, coordinate], TWIN, 2, "twin")
    distance = np.linalg.norm(measured - twin, axis=1) * 1e3
    paper.name(axes[3, 1], "distance of the twin, mm")
    paper.line(axes[3, 1], table.time, distance, TWIN, 2)
    rms, _ = paper.rms_and_mae(distance)
    paper.remark(axes[3, 1], f"RMS {rms:.3g}  largest {np.nanmax(distance):.3g} mm", TWIN)
    paper.legend(axes[0, 1], "Coordinates in the base frame")
    return figure


def _wrench(recording: Recording, title: str, tool: Tool | None) -> Figure | None:
    """Force on the left, moment on the right, a row per axis, every estimate and measurement in one panel."""
    robot = recording.robot
    known = has(robot, "actual_TCP_pose")
    X_BF = spatial.pose_from_vector(robot["actual_TCP_pose"]) if known else np.full((len(robot), 4, 4), np.nan)
    found = wrenches.find(recording, X_BF, tool)
    if not found:
        return None
    figure = paper.new_figure(_WIDTH, 7.5, "Wrench on the arm, at the flange, in base axes", title)
    axes = paper.panels(figure, 3, 2)
    reference = next((item for item in found if item.label == "truth"), None)
    reference = reference or next((item for item in found if item.key == "sensor"), None)
    for axis, (label, unit) in enumerate(zip(WRENCH_AXES, WRENCH_UNITS, strict=True)):
        panel = axes[axis % 3, axis // 3]
        paper.name(panel, f"{label}, {unit}")
        others = [item for item in found if item is not reference]
        for rank, item in enumerate([reference, *others] if reference else others):
            paper.line(panel, robot.time, item.values[:, axis], item.colour, 0 if rank == 0 else 2, item.label)
        for row, item in enumerate(others if reference else ()):
            rms, mae = paper.rms_and_mae(item.values[:, axis] - reference.values[:, axis])
            paper.remark(panel, f"against {reference.label}: RMS {rms:.3g}  MAE {mae:.3g} {unit}", item.colour, row)
    paper.legend(axes[0, 0], "Force, N")
    paper.legend(axes[0, 1], "Moment, Nm")
    return figure
