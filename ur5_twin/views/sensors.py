"""Figures of ``identify sensor``: readings against predictions, and how clocks agree over their shift."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ur5_twin.identification.sensor_result import Found
from ur5_twin.spatial import WRENCH_AXES
from ur5_twin.views import paper
from ur5_twin.views.style import MEASURED, TARGET, TWIN

_SIZE = (13.0, 7.0)
_IMU_AXES = tuple(f"{what} {axis}" for what in ("acceleration, m/s^2:", "rate of turn, rad/s:") for axis in "xyz")


def draw_sensors(found: Sequence[Found], folder: Path) -> list[Path]:
    """Every figure that the fits give, as PNGs; returns their paths."""
    drawn = []
    for item in found:
        name = item.source.removeprefix("Movement_")
        if item.imu is not None:
            lines = ((item.imu.preset, TARGET, "before"), (item.imu.predicted, TWIN, "after"))
            drawn.append(
                _readings(item.imu.time, item.imu.reading, lines, _IMU_AXES, f"{name}: IMU", folder / f"{name}_imu.png")
            )
        if item.ft is not None:
            free = np.where(item.ft.untouched[:, None], item.ft.reading, np.nan)
            first = np.broadcast_to(item.ft.reading[:6].mean(axis=0), free.shape)
            lines = ((first, TARGET, "first reading"), (item.ft.predicted, TWIN, "bias and load"))
            title = f"{name}: force sensor without contact, N and Nm"
            drawn.append(_readings(item.ft.time, free, lines, WRENCH_AXES, title, folder / f"{name}_ft.png"))
    drawn.append(_clocks(found, folder / "clocks.png"))
    return drawn


def _readings(
    time: np.ndarray,
    reading: np.ndarray,
    lines: Sequence[tuple[np.ndarray, str, str]],
    axes: Sequence[str],
    title: str,
    path: Path,
) -> Path:
    figure = paper.new_figure(*_SIZE, title)
    panels = paper.panels(figure, 3, 2)
    for k, axis in enumerate(axes):
        panel = panels[k % 3, k // 3]
        paper.name(panel, axis)
        paper.line(panel, time, reading[:, k], MEASURED, 2.2, "measured")
        for values, colour, label in lines:
            paper.line(panel, time, values[:, k], colour, 1.1, label)
        known = np.isfinite(reading[:, k])
        span = np.percentile(reading[known, k], [1, 99])
        panel.set_ylim(*paper.wide((span[0] - 0.15 * np.ptp(span), span[1] + 0.15 * np.ptp(span)), 1e-3))
    paper.heading(panels[0, 0], "below 4 Hz")
    return paper.save(figure, path)


def _clocks(found: Sequence[Found], path: Path) -> Path:
    figure = paper.new_figure(9.0, 4.5, "Agreement of the clocks")
    panel = figure.add_axes((0.09, 0.13, 0.55, 0.72))
    paper.dress(panel)
    for item in found:
        name = item.source.removeprefix("Movement_")
        clocks = [("IMU", None if item.imu is None else item.imu.clock)]
        clocks.append(("force sensor", None if item.ft is None or item.ft.pushes is None else item.ft.pushes.clock))
        for what, clock in clocks:
            if clock is not None:
                near = clock.values > 0.0
                panel.plot(1e3 * clock.shifts[near], clock.values[near], linewidth=1.4, label=f"{name}, {what}")
                panel.axvline(1e3 * clock.shift, color=TARGET, linewidth=0.6)
    panel.set_xlabel("shift of the device's clock, ms", fontsize=9)
    panel.set_ylabel("correlation", fontsize=9)
    panel.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False, fontsize=7)
    return paper.save(figure, path)
