"""Every wrench a recording holds, brought to one meaning: on the arm, at the flange, in base axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ur5_twin.arm.parameters import Tool
from ur5_twin.recording.force_sensor import on_arm, sensor_bias
from ur5_twin.recording.table import Recording, Table
from ur5_twin.views.style import ESTIMATES, SENSOR, TARGET, TRUTH, has


@dataclass(frozen=True)
class Wrench:
    """One wrench over the rows of the robot's table.

    Attributes:
        key: name for entities.
        label: the legend's word for it.
        colour: ``#rrggbb``.
        values: (n, 6) force in N and moment in Nm on the arm, at the flange, in base axes; NaN where unknown.
    """

    key: str
    label: str
    colour: str
    values: np.ndarray


def find(recording: Recording, X_BF: np.ndarray, tool: Tool | None, bias: np.ndarray | None = None) -> list[Wrench]:
    """The wrenches of a recording: controller's, force sensor's, estimates and truth, those that are there.

    Args:
        recording: what to look through.
        X_BF: (n, 4, 4) the flange's pose at each row of the robot's table.
        tool: what carries the force sensor; without one the moments are about the sensor's own origin.
        bias: (6,) what the sensor reads without load, in its axes; ``sensor_bias`` of the recording if not given.
    """
    aligned = recording.aligned()
    found = []
    if has(aligned, "actual_TCP_force"):
        # The controller publishes what the arm does to its surroundings.
        found.append(Wrench("controller", "controller's estimate", TARGET, -aligned["actual_TCP_force"]))
    if has(aligned, "ft_wrench"):
        unloaded = sensor_bias(recording) if bias is None else bias
        found.append(Wrench("sensor", "force sensor", SENSOR, on_arm(aligned["ft_wrench"], X_BF, tool, unloaded)))
    estimates = [name for name in sorted(aligned.columns) if name.startswith("est_") and _is_wrench(aligned, name)]
    for number, name in enumerate(estimates):
        label = name.removeprefix("est_").removesuffix("_wrench").replace("_", " ")
        colour = ESTIMATES[number % len(ESTIMATES)]
        found.append(Wrench(name, f"estimate by {label}", colour, aligned[name]))
    truths = [name for name in sorted(aligned.columns) if name.startswith("truth_") and _is_wrench(aligned, name)]
    found += [Wrench(name, "truth", TRUTH, aligned[name]) for name in truths]
    return [item for item in found if np.isfinite(item.values).any()]


def reference(found: list[Wrench]) -> Wrench | None:
    """What the others are compared with: the truth where there is one, else the force sensor."""
    for label in ("truth", "force sensor"):
        for item in found:
            if item.label == label:
                return item
    return None


def _is_wrench(table: Table, name: str) -> bool:
    named = "wrench" in name or "force" in name.lower()
    return named and table[name].shape[1] == 6 and has(table, name)
