"""Current over torque, in the manner of the thesis' figures 6.1 and 6.2: without friction, and with it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ur5_twin.arm.drive import LinearDrive
from ur5_twin.arm.parameters import JOINT_NAMES, N_JOINTS, ArmModel
from ur5_twin.drives.current_map import CurrentMap
from ur5_twin.drives.terms import Ride
from ur5_twin.identification.thesis_drive import model_torque
from ur5_twin.recording.table import Recording
from ur5_twin.views import paper
from ur5_twin.views.style import MEASURED, TARGET, TWIN

_SIZE = (17.0, 6.2)
#: Points of a panel: more hide one another.
_MOST = 6000
_TITLES = {
    "torque_without_friction": "Measured current over the model's torque (thesis figure 6.1)",
    "torque_with_friction": "Measured current over torque with friction (thesis figure 6.2)",
}


def draw_relation(
    recordings: Sequence[Recording],
    rides: Sequence[Ride],
    links: ArmModel,
    two_step: LinearDrive,
    ours: CurrentMap,
    folder: Path,
) -> list[Path]:
    """Both figures as PNG: the thesis' method above, ours below, a column a joint.

    Args:
        recordings: logs of free motion.
        rides: the same, prepared for ``ours``.
        links: the rigid bodies of the thesis' method.
        two_step: its map.
        ours: our map; its torque with friction is its current times its torque constant.
        folder: where to.
    """
    current = np.concatenate([recording.robot["actual_current"] for recording in recordings])
    bare = np.concatenate([model_torque(recording, links) for recording in recordings])
    rubbing = bare + np.concatenate([two_step.friction(recording.robot["target_qd"]) for recording in recordings])
    plant = np.concatenate([ride.torque for ride in rides])
    whole = ours.torque_constant * np.concatenate([ours.current(ride) for ride in rides])
    shown = np.unique(np.linspace(0, len(current) - 1, _MOST).astype(int))
    drawn = []
    for key, rows in (("torque_without_friction", (bare, plant)), ("torque_with_friction", (rubbing, whole))):
        figure = paper.new_figure(*_SIZE, _TITLES[key])
        axes = figure.subplots(
            2, N_JOINTS, gridspec_kw={"left": 0.045, "right": 0.99, "bottom": 0.08, "top": 0.86, "hspace": 0.35}
        )
        for row, (torque, who, colour) in enumerate(zip(rows, ("thesis", "ours"), (MEASURED, TWIN), strict=True)):
            for j, panel in enumerate(axes[row]):
                paper.dress(panel)
                x, y = torque[:, j], current[:, j]
                panel.plot(x[shown], y[shown], ".", color=colour, markersize=1.5, alpha=0.35, rasterized=True)
                slope, offset = np.polyfit(y, x, 1)
                ends = np.array([y.min(), y.max()])
                panel.plot(slope * ends + offset, ends, color=TARGET, linewidth=1.2)
                explained = np.corrcoef(x, y)[0, 1] ** 2
                paper.name(panel, f"{JOINT_NAMES[j]}, {who}")
                paper.remarks(panel, [(f"R^2 {explained:.2f}", colour)])
                if row == 1:
                    panel.set_xlabel("torque, Nm", fontsize=9)
            axes[row][0].set_ylabel("current, A", fontsize=9)
        drawn.append(paper.save(figure, folder / f"{key}.png"))
    return drawn
