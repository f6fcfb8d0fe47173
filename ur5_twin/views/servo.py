"""Figures of ``identify servo``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ur5_twin.atomic import replacing
from ur5_twin.evaluation.tables import JOINT_COLUMNS
from ur5_twin.identification.servo_nlse import Nlse
from ur5_twin.identification.servo_result import HeldOut
from ur5_twin.views.style import MEASURED, TWIN


def draw_profiles(nlse: Nlse, path: Path) -> Path:
    """The cost of (2.83) over either gain, the other at its best; returns the path."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    for panel, profile, unit in zip(figure.subplots(1, 2), nlse.profile, ("K0, 1/s²", "K1, 1/s"), strict=True):
        for curve, label in zip(profile, JOINT_COLUMNS, strict=True):
            panel.plot(nlse.grid, curve, label=label)
        panel.set_xscale("log")
        # Costs that differ by a thousandth are drawn as what they are: the same.
        panel.set_ylim(0.0, min(max(2.0, float(profile.max())), 10.0))
        panel.set_xlabel(unit)
        panel.set_ylabel("cost over its least")
        panel.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=7, ncols=2)
    return _save(figure, path)


def draw_tracking(checked: HeldOut, path: Path) -> Path:
    """Tracking error of a log that was not fitted, the arm's and the twin's; returns the path."""
    robot = checked.recording.robot
    figure = Figure(figsize=(10.0, 10.0), layout="constrained")
    FigureCanvasAgg(figure)
    for j, panel in enumerate(figure.subplots(6, 1, sharex=True)):
        for name, label, colour in (("actual_q", "arm", MEASURED), ("sim_actual_q", "twin", TWIN)):
            error = 1e3 * (robot[name][:, j] - robot["target_q"][:, j])
            panel.plot(robot.time - robot.time[0], error, label=label, color=colour, linewidth=0.7)
        panel.set_ylabel(f"{JOINT_COLUMNS[j]}\nmrad")
        panel.grid(alpha=0.3)
    figure.axes[0].set_title(f"q - target_q, {checked.recording.source}, by a servo from other logs", fontsize=10)
    figure.axes[0].legend(fontsize=8, ncols=2)
    figure.axes[-1].set_xlabel("s")
    return _save(figure, path)


def draw(checked: Sequence[HeldOut], nlse: Nlse | None, folder: Path) -> list[Path]:
    """All figures there is something to draw for."""
    drawn = [] if nlse is None else [draw_profiles(nlse, folder / "cost_profile.png")]
    return drawn + [draw_tracking(item, folder / f"tracking_{item.recording.source}.png") for item in checked[-1:]]


def _save(figure: Figure, path: Path) -> Path:
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120)
    return path
