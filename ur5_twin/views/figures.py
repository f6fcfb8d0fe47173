"""Figures of a recording, replayed or of a scenario's run, as PNG files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ur5_twin import spatial
from ur5_twin.arm.parameters import JOINT_NAMES, Tool
from ur5_twin.evaluation import contacts
from ur5_twin.evaluation.run_report import protective_stop
from ur5_twin.recording.table import Recording, Table
from ur5_twin.spatial import WRENCH_AXES
from ur5_twin.views import paper, wrenches
from ur5_twin.views.style import MEASURED, QUANTITIES, STOPPED, TRUTH, TRUTH_TOO, TWIN, Quantity, has

_SIZE = (13.0, 8.0)
_TALL = (13.0, 12.5)
#: Line widths of the series in drawing order: broad ones beneath, so that lines that coincide are all seen.
_BROAD = (4.4, 2.6, 1.2, 1.2, 1.2)
_FINE = (0.7, 1.3, 1.3, 1.3)
_ALONE = (1.6,)
_ERROR_WIDTH = 0.8
#: Pairs of link and obstacle that have a row in the figure of contacts, those of the largest forces.
_MOST_TOUCHES = 8
#: x, y and z, as the viewer has them.
_AXIS_COLOURS = ("#d33c3c", "#3f9b3f", "#3a6fd0")


def write_figures(
    recording: Recording, folder: Path, *, title: str, tool: Tool | None = None, obstacles: Sequence[str] = ()
) -> list[Path]:
    """Draw a recording.

    Args:
        recording: a replay, a run of a scenario, or any other: a figure whose columns are missing is left out.
        folder: where to write; made if it is not there.
        title: what was recorded; stands over every figure.
        tool: the tool at the flange; if it carries the force sensor its moments are drawn about the flange.
        obstacles: names of the obstacles of a run, in the scenario's order.

    Returns:
        The files, in the order in which one would look at them: position, velocity, torque, current, external_torque,
        tcp_path, wrench, contact.
    """
    drawn = {quantity.key: _quantity(recording.robot, quantity, title) for quantity in QUANTITIES}
    drawn["tcp_path"] = _tcp_path(recording.robot, title)
    drawn["wrench"] = _wrench(recording, title, tool)
    drawn["contact"] = _contact(recording, title, obstacles)
    stop = protective_stop(recording.robot)
    figures = {key: figure for key, figure in drawn.items() if figure is not None}
    if stop is not None:
        for figure in figures.values():
            paper.stopped(figure, stop, STOPPED)
    return [paper.save(figure, folder / f"{key}.png") for key, figure in figures.items()]


def _quantity(table: Table, quantity: Quantity, title: str) -> Figure | None:
    """A row per joint: the signal on the left, the differences of its lines on the right."""
    series, differences = quantity.series_in(table), quantity.differences_in(table)
    if not series:
        return None
    figure = paper.new_figure(*_TALL, title)
    axes = paper.panels(figure, len(JOINT_NAMES), 2 if differences else 1)
    widths = _ALONE if len(series) == 1 else _FINE if quantity.noisy else _BROAD
    for joint, joint_name in enumerate(JOINT_NAMES):
        panel = axes[joint, 0]
        paper.name(panel, joint_name)
        for item, width in zip(series, widths, strict=False):
            paper.line(panel, table.time, table[item.column][:, joint], item.colour, width, item.label)
        # A joint that stands still would fill its panel with the last digit of its encoder.
        panel.set_ylim(paper.wide(panel.get_ylim(), 0.01))
        said = []
        for item in differences[::-1]:  # the twin's own line last, above the others
            error = quantity.error(item, table)[:, joint]
            paper.line(axes[joint, 1], table.time, error, item.colour, _ERROR_WIDTH, item.label)
            said.append((paper.rms_and_mae(error), item.colour))
        if differences:
            paper.name(axes[joint, 1], joint_name)
            paper.remarks(axes[joint, 1], said)
    paper.heading(axes[0, 0], f"{quantity.title}, {quantity.unit}")
    if differences:
        paper.heading(axes[0, 1], f"{quantity.error_title}, {quantity.error_unit}")
    return figure


def _tcp_path(table: Table, title: str) -> Figure | None:
    """The flange's path in space, and over time its coordinates and how far the twin is off."""
    if not has(table, "actual_TCP_pose") or not has(table, "sim_actual_TCP_pose"):
        return None
    measured, twin = table["actual_TCP_pose"][:, :3], table["sim_actual_TCP_pose"][:, :3]
    figure = paper.new_figure(*_SIZE, title)
    axes = paper.panels(figure, 4, 2)
    for panel in axes[:, 0]:
        panel.remove()
    _path_in_space(figure, measured, twin)
    for panel, coordinate, label in zip(axes[:3, 1], range(3), "xyz", strict=True):
        paper.name(panel, f"{label}, m")
        paper.line(panel, table.time, measured[:, coordinate], MEASURED, _BROAD[0], "measured")
        paper.line(panel, table.time, twin[:, coordinate], TWIN, _BROAD[2], "twin")
    distance = np.linalg.norm(measured - twin, axis=1) * 1e3
    paper.name(axes[3, 1], "distance of the twin from the arm, mm")
    paper.line(axes[3, 1], table.time, distance, TWIN, _ERROR_WIDTH)
    paper.remarks(axes[3, 1], [(paper.rms_and_mae(distance), TWIN)])
    paper.heading(axes[0, 1], "Path of the flange in the base frame")
    return figure


def _path_in_space(figure: Figure, measured: np.ndarray, twin: np.ndarray) -> None:
    space: Any = figure.add_axes((0.0, 0.04, 0.46, 0.86), projection="3d", computed_zorder=False)
    every = max(1, len(measured) // 2000)
    for path, colour, width in ((measured, MEASURED, 4.0), (twin, TWIN, 1.1)):
        space.plot(*path[::every].T, color=colour, linewidth=width)
    limits = [getattr(space, f"get_{axis}lim")() for axis in "xyz"]
    # A path in a plane or on a line still gets a box to look into.
    least = 0.5 * max(high - low for low, high in limits)
    space.set(**{f"{axis}lim": paper.wide(limit, least) for axis, limit in zip("xyz", limits, strict=True)})
    space.set(xlabel="x, m", ylabel="y, m", zlabel="z, m", aspect="equal")
    space.tick_params(labelsize=8)
    space.locator_params(nbins=5)


def _wrench(recording: Recording, title: str, tool: Tool | None) -> Figure | None:
    """Force on the left, moment on the right, a row per axis, every estimate and measurement in one panel."""
    robot = recording.robot
    posed = has(robot, "actual_TCP_pose")
    X_BF = spatial.pose_from_vector(robot["actual_TCP_pose"]) if posed else np.full((len(robot), 4, 4), np.nan)
    found = wrenches.find(recording, X_BF, tool)
    if not found:
        return None
    figure = paper.new_figure(*_SIZE, title)
    axes = paper.panels(figure, 3, 2)
    reference = wrenches.reference(found)
    others = [item for item in found if item is not reference]
    for axis, label in enumerate(WRENCH_AXES):
        panel = axes[axis % 3, axis // 3]
        paper.name(panel, label)
        if reference is not None:
            paper.line(panel, robot.time, reference.values[:, axis], reference.colour, 3.0, reference.label)
        said = []
        for item in others:
            paper.line(panel, robot.time, item.values[:, axis], item.colour, 1.1, item.label)
            if reference is not None:
                error = item.values[:, axis] - reference.values[:, axis]
                said.append((paper.rms_and_mae(error), item.colour))
        paper.remarks(panel, said)
    against = f"; RMS and MAE against the {reference.label}" if reference is not None and others else ""
    paper.heading(axes[0, 0], f"Force on the arm, base axes, N{against}")
    paper.heading(axes[0, 1], "Moment on the arm about the flange, base axes, Nm")
    return figure


def _contact(recording: Recording, title: str, obstacles: Sequence[str]) -> Figure | None:
    """A row per pair of link and obstacle: the size of its force on the left, where it acts on the right."""
    time = recording.robot.time
    touched = contacts.touches(recording)
    if not touched:
        return None
    strongest = sorted(touched, key=lambda touch: -touch.size.max())[:_MOST_TOUCHES]
    shown = [touch for touch in touched if any(touch is other for other in strongest)]
    figure = paper.new_figure(_TALL[0], 1.9 + 1.8 * max(2, len(shown)), title)
    axes = paper.panels(figure, len(shown), 2)
    for row, touch in zip(axes, shown, strict=True):
        colour = TRUTH_TOO if touch.is_push else TRUTH
        size, point = touch.over(len(time)), np.full((len(time), 3), np.nan)
        point[touch.rows] = touch.point
        peak = int(np.argmax(size))
        for panel in row:
            paper.name(panel, touch.name(obstacles))
        paper.filled(row[0], time, size, colour)
        row[0].set_ylim(bottom=0.0)
        said = f"{size[peak]:.3g} N at {time[peak]:.2f} s, {touch.duration:.3g} s, "
        paper.remarks(row[0], [(f"{said}{np.linalg.norm(touch.impulse):.3g} N s", colour)])
        for axis, (label, shade) in enumerate(zip("xyz", _AXIS_COLOURS, strict=True)):
            paper.line(row[1], time, point[:, axis], shade, 1.6, label)
        row[1].set_ylim(paper.wide(row[1].get_ylim(), 0.01))
    left = "" if len(shown) == len(touched) else f"; {len(touched) - len(shown)} weaker pairs are left out"
    paper.heading(axes[0, 0], f"True force on the arm, N{left}")
    paper.heading(axes[0, 1], "Where it acts in the base frame, m")
    return figure
