"""Figures of an identified plant: currents as measured and as the law has them, and the intervals of its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ur5_twin.arm.drive import JointDrives
from ur5_twin.arm.parameters import JOINT_NAMES, N_JOINTS
from ur5_twin.identification.plant import PlantFit
from ur5_twin.identification.plant_check import current_of
from ur5_twin.identification.plant_solve import FIELDS
from ur5_twin.identification.plant_windows import SLOWEST, Motion
from ur5_twin.views import paper
from ur5_twin.views.style import MEASURED, TARGET, TWIN


def draw_currents(of: Motion, fit: PlantFit, drives: JointDrives, path: Path) -> Path:
    """Measured current and that of the law while each joint moves, one log, as a PNG; returns its path."""
    figure = paper.new_figure(11.0, 9.0, f"Motor currents in motion, {of.source}")
    panels = paper.panels(figure, 3, 2)
    late = fit.loaded(of).late(fit.delay)
    predicted = current_of(fit.drives(drives, "fit"), fit.values["rotor_inertia"], late)
    for j, panel in enumerate(panels.flat):
        moving = of.joined & (np.abs(of.qd[:, j]) > SLOWEST)
        measured, law = (np.where(moving, x[:, j], np.nan) for x in (of.current, predicted))
        paper.line(panel, of.time, measured, MEASURED, 1.2, "measured")
        paper.line(panel, of.time, law, TWIN, 0.8, "law")
        paper.name(panel, f"joint {j + 1}, {JOINT_NAMES[j]}, A")
        paper.remarks(panel, [(paper.rms_and_mae(law - measured), TWIN)])
    panels[0, 0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.08), ncols=2, frameon=False, fontsize=9)
    return paper.save(figure, path)


def draw_intervals(fit: PlantFit, base: JointDrives, rotor_inertia: np.ndarray, path: Path) -> Path:
    """Each number with its 95 % interval beside the base's, as a PNG; returns its path."""
    figure = paper.new_figure(11.0, 9.0, "The plant's numbers with 95 % intervals, and those of the base model")
    panels = figure.subplots(
        4, 2, gridspec_kw={"top": 0.91, "bottom": 0.06, "left": 0.07, "right": 0.98, "hspace": 0.45}
    )
    joints = np.arange(1, N_JOINTS + 1)
    numbers = {"torque_constant": base.torque_constant, "rotor_inertia": rotor_inertia}
    for panel, (name, unit) in zip(panels.flat, FIELDS.items(), strict=True):
        paper.dress(panel)
        values, low, high = fit.values[name], fit.low[name], fit.high[name]
        told = ~fit.known[name] & np.isfinite(low)
        usual = numbers.get(name, getattr(base.friction, name, None))
        panel.plot(joints + 0.15, usual, "_", color=TARGET, markersize=12, label="base")
        panel.vlines(joints[told], low[told], high[told], color=TWIN, linewidth=3)
        panel.plot(joints[told], values[told], "o", color=TWIN, label="fitted, 95 %")
        panel.plot(joints[~told], values[~told], "o", color=TWIN, fillstyle="none", label="taken as known")
        panel.set_xticks(joints)
        paper.name(panel, f"{name.replace('_', ' ')}, {unit}")
    panels[0, 0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.12), ncols=3, frameon=False, fontsize=9)
    return paper.save(figure, path)


def draw(
    motions: Sequence[Motion], fit: PlantFit, base: JointDrives, rotor_inertia: np.ndarray, folder: Path
) -> list[Path]:
    """All figures of a fit in a folder: the currents of each log, and the intervals."""
    names = [f"currents_{k}.png" for k in range(1, len(motions) + 1)]
    drawn = [draw_currents(of, fit, base, folder / name) for of, name in zip(motions, names, strict=True)]
    return [draw_intervals(fit, base, rotor_inertia, folder / "intervals.png"), *drawn]
