"""matplotlib as the figures use it: own objects, no global state, the same look everywhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ur5_twin.atomic import replacing

#: Points a line is drawn with: twice the pixels of the widest panel would not show more.
_MOST_POINTS = 2400
_INK = "#2b2f36"
_FAINT = "#d9dce1"
_DPI = 110


def new_figure(width: float, height: float, title: str, subtitle: str) -> Figure:
    """An empty figure, inches, with a title over the panels."""
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    top = 1.0 - 0.12 / height
    figure.text(0.45 / width, top, title, ha="left", va="top", fontsize=14, fontweight="bold", color=_INK)
    figure.text(1.0 - 0.2 / width, top, subtitle, ha="right", va="top", fontsize=10, color="#6a707a")
    return figure


def panels(figure: Figure, rows: int, columns: int, *, legend_rows: int = 1) -> np.ndarray:
    """(rows, columns) panels with a shared time axis; room above them for a title and legends."""
    width, height = figure.get_size_inches()
    axes = figure.subplots(
        rows,
        columns,
        sharex=True,
        squeeze=False,
        gridspec_kw={
            "left": 0.75 / width,
            "right": 1.0 - 0.2 / width,
            "bottom": 0.5 / height,
            "top": 1.0 - (0.55 + 0.22 * legend_rows) / height,
            "hspace": 0.16,
            "wspace": 0.14,
        },
    )
    for panel in axes.flat:
        dress(panel)
    for panel in axes[-1]:
        panel.set_xlabel("robot time, s", color=_INK, fontsize=9)
    return axes


def dress(panel: Axes) -> None:
    """Light grid, no box, small ticks."""
    panel.grid(color=_FAINT, linewidth=0.6)
    panel.set_axisbelow(True)
    panel.tick_params(labelsize=8, color=_FAINT, labelcolor=_INK, length=3)
    panel.margins(x=0.01, y=0.08)
    for side, spine in panel.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color("#9aa0a8")


def name(panel: Axes, text: str) -> None:
    """A name in the panel's upper left corner, inside."""
    _corner(panel, 0.008, "left", text, _INK, 0, weight="bold")


def remark(panel: Axes, text: str, colour: str, row: int = 0) -> None:
    """A number in the panel's upper right corner, in the colour of the line it speaks of."""
    _corner(panel, 0.995, "right", text, colour, row)


def _corner(panel: Axes, x: float, side: Any, text: str, colour: str, row: int, weight: str = "normal") -> None:
    panel.annotate(
        text,
        (x, 1.0),
        xycoords="axes fraction",
        xytext=(0, -1 - 11 * row),
        textcoords="offset points",
        ha=side,
        va="top",
        fontsize=8,
        fontweight=weight,
        color=colour,
        bbox={"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1.0},
        zorder=10,
    )


def line(panel: Axes, time: np.ndarray, values: np.ndarray, colour: str, rank: int = 0, label: str = "") -> None:
    """A signal over time; ``rank`` 0 is drawn broad and beneath, each further one finer and above.

    Where lines coincide, as a good twin's do, all of them are still seen.
    """
    at, thinned = envelope(time, values)
    panel.plot(at, thinned, color=colour, linewidth=(2.6, 1.4, 0.9, 0.9)[min(rank, 3)], label=label, zorder=2 + rank)


def legend(panel: Axes, title: str, columns: int = 4) -> None:
    """The legend over a column of panels, headed by what the column shows."""
    handles, labels = panel.get_legend_handles_labels()
    panel.set_title(title, loc="left", fontsize=10, color=_INK, fontweight="bold", pad=20)
    shown = panel.legend(
        handles,
        labels,
        loc="lower left",
        bbox_to_anchor=(-0.012, 0.985),
        ncols=columns,
        frameon=False,
        fontsize=8.5,
        handlelength=1.4,
        columnspacing=1.2,
        borderaxespad=0.1,
    )
    for handle in shown.get_lines():
        handle.set_linewidth(2.5)


def envelope(time: np.ndarray, values: np.ndarray, most: int = _MOST_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """A signal with fewer points that looks the same: of each bin of rows its least and greatest value, in order.

    Args:
        time: (n,)
        values: (n,), NaN where unknown.
        most: number of points that may be left.

    Returns:
        Time and value of each point left, in the order of time; a bin without a number leaves one NaN, so that gaps
        stay gaps.
    """
    if len(time) <= most:
        return time, values
    bins = most // 2
    size = -(-len(time) // bins)
    padded = np.full(size * -(-len(time) // size), np.nan)
    padded[: len(values)] = values
    rows = padded.reshape(-1, size)
    first = np.arange(len(rows)) * size
    least = first + np.argmin(np.where(np.isnan(rows), np.inf, rows), axis=1)
    greatest = first + np.argmax(np.where(np.isnan(rows), -np.inf, rows), axis=1)
    keep = np.unique(np.concatenate([least, greatest]))
    return time[keep], values[keep]


def save(figure: Figure, path: Path) -> Path:
    """Write the figure as a PNG in one piece and return its path."""
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=_DPI, format="png", metadata={"Software": None})
    return path


def rms_and_mae(values: np.ndarray) -> tuple[float, float]:
    """Root of the mean square, and mean of the absolute value, over the rows that are numbers."""
    known = values[np.isfinite(values)]
    if not len(known):
        return float("nan"), float("nan")
    return float(np.sqrt(np.mean(known**2))), float(np.mean(np.abs(known)))


def wide(limits: Sequence[float], least: float) -> tuple[float, float]:
    """Limits at least ``least`` apart, about the same middle."""
    low, high = limits
    more = max(0.0, least - (high - low)) / 2
    return low - more, high + more
