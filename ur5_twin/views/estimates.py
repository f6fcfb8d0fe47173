"""Figures and files of force estimates, in the manner of the thesis' figures 6.4 to 6.9."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ur5_twin.atomic import write_text
from ur5_twin.evaluation.estimate_report import Judged, deviation, render_estimates, summarise_estimates, with_columns
from ur5_twin.evaluation.reporting import render_json
from ur5_twin.evaluation.scores import NINETY
from ur5_twin.recording import write_parquet
from ur5_twin.spatial import WRENCH_AXES
from ur5_twin.views import paper
from ur5_twin.views.style import ESTIMATES, SENSOR, TRUTH

_SIZE = (13.0, 8.5)
#: As many as a panel and its legend bear: the best by force.
_MOST = 3
_PARTS = (("force", slice(0, 3), "N"), ("moment", slice(3, 6), "Nm"))


def write_estimates(judged: Judged, folder: Path, *, log: Path, rerun: bool, figures: bool) -> dict[str, Any]:
    """Write ``report.json``, ``report.md``, ``recording.parquet``, figures and ``twin.rrd``; returns the report.

    Args:
        judged: estimators on a recording.
        folder: made if needed; what an earlier run left in it is removed first.
        log: what they ran on, as it was given.
        rerun: write ``twin.rrd``.
        figures: draw ``figures/*.png``.
    """
    report = {"log": str(log), **summarise_estimates(judged)}
    recording = with_columns(judged)
    folder.mkdir(parents=True, exist_ok=True)
    for stale in (folder / "report.json", folder / "report.md", folder / "twin.rrd", *folder.glob("figures/*.png")):
        stale.unlink(missing_ok=True)
    write_parquet(recording, folder / "recording.parquet")
    drawn = draw_estimates(judged, folder / "figures") if figures else []
    if rerun:
        from ur5_twin.views import rerun_view

        rerun_view.write_rrd(recording, judged.nominal.arm, folder / "twin.rrd", title=judged.recording.source)
    write_text(folder / "report.md", render_estimates(report, drawn))
    write_text(folder / "report.json", render_json(report))
    return report


def draw_estimates(judged: Judged, folder: Path) -> list[Path]:
    """Forces, moments and their errors over time, and the best estimate with its 90 % interval, as PNG.

    The three estimators whose forces are best are drawn; without a truth the first three.
    """
    names = best(judged)[:_MOST]
    # The best one lies above the others.
    drawn_last_first = list(zip(names, ESTIMATES, strict=False))[::-1]
    time, truth = judged.recording.robot.time, judged.truth
    drawn = []
    for part, axes, unit in _PARTS:
        figure = paper.new_figure(*_SIZE, f"{judged.recording.source}: estimated {part}")
        panels = paper.panels(figure, 3, 1 if truth is None else 2)
        for row, axis in enumerate(range(axes.start, axes.stop)):
            panel = panels[row, 0]
            paper.name(panel, WRENCH_AXES[axis])
            for name, colour in drawn_last_first:
                paper.line(panel, time, judged.estimates[name].wrench[:, axis], colour, 0.9, _words(name))
            if truth is None:
                continue
            paper.line(panel, time, truth.wrench[:, axis], _colour(truth.what), 1.6, _words(truth.what))
            said = []
            for name, colour in drawn_last_first:
                error = judged.estimates[name].wrench[:, axis] - truth.wrench[:, axis]
                paper.line(panels[row, 1], time, error, colour, 0.7)
                said.append((f"MAE {np.nanmean(np.abs(error)):.3g}", colour))
            paper.name(panels[row, 1], WRENCH_AXES[axis])
            paper.remarks(panels[row, 1], said)
        paper.heading(panels[0, 0], f"{part.capitalize()} on the arm at the flange, base axes, {unit}")
        if truth is not None:
            paper.heading(panels[0, 1], f"Estimate minus {_words(truth.what)}, {unit}")
        drawn.append(paper.save(figure, folder / f"{part}.png"))
    drawn.append(_interval(judged, names[0], folder / "interval.png"))
    return drawn


def best(judged: Judged) -> list[str]:
    """Names of the estimators, the ones with the smallest force errors first."""
    names, truth = list(judged.estimates), judged.truth
    if truth is None:
        return names
    known = np.isfinite(truth.wrench).all(axis=1)
    error = {
        name: np.abs(found.wrench[known, :3] - truth.wrench[known, :3]).mean()
        for name, found in judged.estimates.items()
    }
    return sorted(names, key=error.__getitem__)


def _interval(judged: Judged, name: str, path: Path) -> Path:
    """One estimate with its 90 % interval, six panels."""
    found, truth, time = judged.estimates[name], judged.truth, judged.recording.robot.time
    width = NINETY * deviation(found)
    figure = paper.new_figure(*_SIZE, f"{judged.recording.source}: {_words(name)} with its 90 % interval")
    panels = paper.panels(figure, 3, 2)
    thin = np.unique(np.linspace(0, len(time) - 1, min(len(time), 3000)).astype(int))
    for axis in range(6):
        panel = panels[axis % 3, axis // 3]
        paper.name(panel, WRENCH_AXES[axis])
        low, high = (found.wrench[thin, axis] + sign * width[thin, axis] for sign in (-1, 1))
        panel.fill_between(time[thin], low, high, color=ESTIMATES[0], alpha=0.25, linewidth=0.0, label="90 % interval")
        paper.line(panel, time, found.wrench[:, axis], ESTIMATES[0], 0.9, _words(name))
        if truth is not None:
            paper.line(panel, time, truth.wrench[:, axis], _colour(truth.what), 1.6, _words(truth.what))
    paper.heading(panels[0, 0], "Force on the arm at the flange, base axes, N")
    paper.heading(panels[0, 1], "Moment, Nm")
    return paper.save(figure, path)


def _colour(what: str) -> str:
    return SENSOR if what == "ft" else TRUTH


def _words(name: str) -> str:
    return {"ft": "force sensor", "truth": "truth", "zero": "zero"}.get(name, name.replace("_", " "))
