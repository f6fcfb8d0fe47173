"""Files and figures of a benchmark."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ur5_twin.atomic import write_text
from ur5_twin.evaluation.benchmark.report import render_html, render_markdown, sections
from ur5_twin.evaluation.benchmark.run import Finished
from ur5_twin.evaluation.reporting import render_json
from ur5_twin.views import paper
from ur5_twin.views.style import MEASURED, STOPPED, TWIN

#: What intervals of 90 % shall cover.
_COVERED = (0.85, 0.95)
#: How bright red, green and blue look, and below which brightness a cell's number is white.
_LUMINANCE, _DARK = (0.299, 0.587, 0.114), 0.45
_LEVELS = (MEASURED, "#f2b56b", TWIN, STOPPED)


def write_benchmark(finished: Finished, folder: Path) -> list[Path]:
    """Write ``leaderboard.json``, ``.md`` and ``.html``, ``cost.json`` and ``figures/*.png``; returns the figures."""
    for stale in folder.glob("figures/*.png"):
        stale.unlink()
    board = finished.board
    figures = draw_benchmark(board, folder / "figures") if board["levels"] else []
    made = sections(board, finished.microseconds)
    write_text(folder / "cost.json", render_json({"microseconds_per_sample": finished.microseconds}))
    write_text(folder / "leaderboard.md", render_markdown(made, figures))
    write_text(folder / "leaderboard.html", render_html(made, figures))
    write_text(folder / "leaderboard.json", render_json(board))
    return figures


def draw_benchmark(board: dict[str, Any], folder: Path) -> list[Path]:
    """Errors of all estimators, coverage by regime, and errors by scenario at the last level, as PNG."""
    last = list(board["levels"])[-1]
    found = board["levels"][last]
    covered = f"Level {last}: share within the stated 90 % interval, least axis"
    missed = "mean of the three force errors, N"
    return [
        _errors(board, folder / "errors.png"),
        _map(found, "regimes", covered, folder / "coverage.png", _least, (0.4, 1.0), "{:.2f}"),
        _map(found, "scenarios", f"Level {last}: {missed}", folder / "scenarios.png", _force, (0.0, 20.0), "{:.1f}"),
    ]


def _least(item: dict[str, Any]) -> float:
    return np.nan if item["coverage_90"] is None else min(item["coverage_90"])


def _force(item: dict[str, Any]) -> float:
    return np.nan if item["mae"] is None else float(np.mean(item["mae"][:3]))


def _errors(board: dict[str, Any], path: Path) -> Path:
    """Force and moment errors, a bar a level."""
    levels = board["levels"]
    order = list(reversed(next(reversed(levels.values()))["ranking"]))
    height = 1.6 + 0.16 * len(order) * (len(levels) + 1)
    figure = paper.new_figure(12.0, height, "Mean absolute error over all runs")
    panels = figure.subplots(1, 2, sharey=True, gridspec_kw=_margins(height, 0.06))
    for panel, axes, words in zip(panels, (slice(0, 3), slice(3, 6)), ("force, N", "moment, Nm"), strict=True):
        paper.dress(panel)
        paper.name(panel, f"{words}, mean of three axes")
        for k, (level, colour) in enumerate(zip(levels, _LEVELS, strict=False)):
            values = [levels[level]["estimators"][name]["mae"] for name in order]
            sizes = [np.nan if value is None else np.mean(value[axes]) for value in values]
            at = np.arange(len(order)) + 0.4 - 0.8 * (k + 0.5) / len(levels)
            panel.barh(at, sizes, height=0.75 / len(levels), color=colour, label=f"level {level}")
        panel.set_yticks(range(len(order)), [_short(name) for name in order])
        panel.margins(y=0.01)
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="upper right", ncols=len(levels), fontsize=9, frameon=False
    )
    return paper.save(figure, path)


def _map(
    found: dict[str, Any],
    key: str,
    title: str,
    path: Path,
    value: Callable[[dict[str, Any]], float],
    limits: tuple[float, float],
    form: str,
) -> Path:
    """Estimators by regimes or scenarios as numbers on colours."""
    order = found["ranking"]
    names = list(found["estimators"][order[0]][key])
    cells = np.array([[value(found["estimators"][name][key][part]) for part in names] for name in order])
    height = 2.1 + 0.3 * len(order)
    figure = paper.new_figure(12.0, height, title)
    panel = figure.subplots(gridspec_kw=_margins(height, 0.0) | {"top": 1.0 - 1.35 / height})
    colours = "RdYlGn" if key == "regimes" else "YlOrRd"
    drawn = panel.imshow(cells, aspect="auto", cmap=colours, vmin=limits[0], vmax=limits[1])
    for (row, column), number in np.ndenumerate(cells):
        right = key == "regimes" and _COVERED[0] <= number <= _COVERED[1]
        text = "-" if np.isnan(number) else form.format(number)
        brightness = float(np.dot(drawn.to_rgba(number)[:3], _LUMINANCE))
        panel.text(
            column,
            row,
            text,
            ha="center",
            va="center",
            fontsize=8,
            fontweight="bold" if right else "normal",
            color="black" if np.isnan(number) or brightness > _DARK else "white",
        )
    panel.set_yticks(range(len(order)), [_short(name) for name in order], fontsize=8)
    panel.set_xticks(range(len(names)), [name.replace("_", "\n") for name in names], fontsize=6.5)
    panel.xaxis.tick_top()
    panel.tick_params(length=0)
    for spine in panel.spines.values():
        spine.set_visible(False)
    return paper.save(figure, path)


def _margins(height: float, between: float) -> dict[str, float]:
    return {"left": 0.17, "right": 0.985, "bottom": 0.45 / height, "top": 1.0 - 0.8 / height, "wspace": between}


def _short(name: str) -> str:
    return name.rpartition(":")[2].replace("_", " ")
