"""matplotlib as the figures use it: own objects, no global state, the same look everywhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from ur5_twin.atomic import replacing

#: Points a line is drawn with: twice the pixels of the widest panel would not show more.
_MOST_POINTS = 1600
_INK = "#2b2f36"
_FAINT = "#d9dce1"
_DPI = 110
_COLOURS = 96
#: Left margin, inches.
_LEFT = 0.75


def new_figure(width: float, height: float, title: str) -> Figure:
    """An empty figure, inches, with a title over the panels."""
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    figure.text(_LEFT / width, 1.0 - 0.13 / height, title, ha="left", va="top", fontsize=14, weight="bold", color=_INK)
    return figure


def panels(figure: Figure, rows: int, columns: int) -> np.ndarray:
    """(rows, columns) panels with a shared time axis, and room above each for its name."""
    width, height = figure.get_size_inches()
    axes = figure.subplots(
        rows,
        columns,
        sharex=True,
        squeeze=False,
        gridspec_kw={
            "left": _LEFT / width,
            "right": 1.0 - 0.2 / width,
            "bottom": 0.5 / height,
            "top": 1.0 - 1.15 / height,
            "hspace": 0.27,
            "wspace": 0.12,
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
    # A common power of ten stands left of the axis, where it does not cross the panel's name.
    panel.yaxis.get_offset_text().set(ha="right", fontsize=8, color=_INK)
    for side, spine in panel.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color("#9aa0a8")


def name(panel: Axes, text: str) -> None:
    """A name over the panel's left corner."""
    _above(panel, 0.0, "left", text, _INK, weight="bold")


def remarks(panel: Axes, texts_and_colours: Sequence[tuple[str, str]]) -> None:
    """Numbers over the panel's right end, side by side, each in the colour of the line it speaks of."""
    for place, (text, colour) in enumerate(reversed(texts_and_colours)):
        _above(panel, 1.0 - 0.28 * place, "right", text, colour)


def _above(panel: Axes, x: float, side: Any, text: str, colour: str, weight: str = "normal") -> None:
    panel.annotate(
        text,
        (x, 1.0),
        xycoords="axes fraction",
        xytext=(0, 3),
        textcoords="offset points",
        ha=side,
        va="bottom",
        fontsize=8.5,
        fontweight=weight,
        color=colour,
    )


def line(panel: Axes, time: np.ndarray, values: np.ndarray, colour: str, width: float, label: str = "") -> None:
    """A signal over time; later ones lie above earlier ones."""
    at, thinned = envelope(time, values)
    panel.plot(at, thinned, color=colour, linewidth=width, label=label)


def filled(panel: Axes, time: np.ndarray, values: np.ndarray, colour: str) -> None:
    """A size over time, with the area below it."""
    at, thinned = envelope(time, values)
    panel.fill_between(at, thinned, color=colour, alpha=0.25, linewidth=0.0)
    panel.plot(at, thinned, color=colour, linewidth=1.2)


def stopped(figure: Figure, time: float, colour: str) -> None:
    """Shade every panel over time from a protective stop on, and say so over the panels."""
    for panel in figure.axes:
        if panel.name == "rectilinear":
            low, high = panel.get_xlim()
            panel.axvspan(time, high, color=colour, alpha=0.08, linewidth=0.0, zorder=0)
            panel.axvline(time, color=colour, linewidth=1.0, linestyle=(0, (4, 2)))
            panel.set_xlim(low, high)
    width, height = figure.get_size_inches()
    text = f"protective stop at {time:.2f} s"
    figure.text(1.0 - 0.2 / width, 1.0 - 0.15 / height, text, ha="right", va="top", fontsize=11, color=colour)


def heading(panel: Axes, title: str) -> None:
    """Over a column of panels: what the column shows, and its legend."""
    above: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points", "ha": "left", "va": "bottom"}
    panel.annotate(title, (0.0, 1.0), xytext=(0, 37), fontsize=10.5, fontweight="bold", color=_INK, **above)
    handles, labels = panel.get_legend_handles_labels()
    shown = panel.legend(
        handles,
        labels,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0, 1.0, 0.0),
        ncols=4,
        frameon=False,
        fontsize=9,
        handlelength=1.4,
        columnspacing=1.4,
        borderpad=0.0,
        borderaxespad=1.9,
    )
    for handle in shown.get_lines():
        handle.set_linewidth(3.0)


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
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(_DPI)
    canvas.draw()
    # A plot has few colours: with a palette the file is a third as large.
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]).quantize(
        _COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
    )
    with replacing(path) as temporary:
        picture.save(temporary, format="png", optimize=True)
    return path


def rms_and_mae(values: np.ndarray) -> str:
    """Root of the mean square and mean of the absolute value, over the rows that are numbers, in words."""
    known = values[np.isfinite(values)]
    if not len(known):
        return ""
    return f"RMS {_short(float(np.sqrt(np.mean(known**2))))}  MAE {_short(float(np.mean(np.abs(known))))}"


def _short(value: float) -> str:
    return f"{value:.3g}" if value >= 1e-3 or value == 0.0 else f"{value:.1e}".replace("e-0", "e-")


def wide(limits: Sequence[float], least: float) -> tuple[float, float]:
    """Limits at least ``least`` apart, about the same middle."""
    low, high = limits
    more = max(0.0, least - (high - low)) / 2
    return low - more, high + more
