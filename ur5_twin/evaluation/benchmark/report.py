"""The leaderboard for people: Markdown, and one HTML page that needs nothing beside it."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ur5_twin.evaluation.benchmark.leaderboard import LEVER
from ur5_twin.evaluation.reporting import short_number
from ur5_twin.evaluation.tables import markdown
from ur5_twin.spatial import WRENCH_AXES, WRENCH_UNITS

#: What 90 % intervals shall cover, and what is marked where they do not.
_COVERED = (0.85, 0.95)


class Section(NamedTuple):
    """A heading, sentences below it, and a table or none."""

    title: str
    text: str
    head: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    words: int = 1


def sections(board: dict[str, Any], microseconds: dict[str, float]) -> list[Section]:
    """The report's content, for either form."""
    suite = board["suite"]
    about = (
        f"{suite['title']}: {board['runs']} runs, {len(suite['scenarios'])} scenarios, levels "
        f"{', '.join(suite['levels'])}, seeds {suite['seeds'][0]} to {suite['seeds'][-1]}. Every estimator gets the "
        "same samples and the same drives, identified from simulated free motion of the arm without deviation. "
        f"Estimators stand in the order of error: the mean of three force errors and of three moment errors over "
        f"{LEVER:g} m, in N. Errors are mean absolute ones over all rows."
    )
    made = [Section(f"Benchmark {suite['name']}", about)]
    for level, found in board["levels"].items():
        made += _level(level, found, suite["levels"][level]["source"], microseconds)
    if "lab" in board:
        made += _lab(board["lab"])
    if board["failed"]:
        rows = [(str(f["scenario"]), f["level"], str(f["seed"]), f["failure"]) for f in board["failed"]]
        made.append(Section("Runs that could not be had", "", ("scenario", "level", "seed", "why"), tuple(rows), 4))
    versions = ", ".join(f"{name} {value}" for name, value in suite["versions"].items())
    return [*made, Section("Versions", f"{versions}; key {board['key'][:16]}")]


def _level(level: str, found: dict[str, Any], source: str, microseconds: dict[str, float]) -> list[Section]:
    order, of = found["ranking"], found["estimators"]
    best = []
    for name in order:
        item = of[name]
        hits = item["detection"]
        delay = "-" if hits["delay_s"] is None else " / ".join(f"{1e3 * value:.0f}" for value in hits["delay_s"])
        hourly = hits["false_alarms_per_hour"]
        best.append(
            (
                name,
                _number(item["error_n"]),
                *_numbers(item["mae"]),
                f"{hits['found']} of {hits['touches']}",
                str(hits["missed"]),
                delay,
                "-" if hourly is None else f"{hourly:.0f}",
                f"{microseconds[name]:.0f}" if name in microseconds else "-",
            )
        )
    head = ("estimator", "error N", *(f"{axis} {unit}" for axis, unit in zip(WRENCH_AXES, WRENCH_UNITS, strict=True)))
    head += ("found", "missed", "delay ms, median / 95 %", "false alarms an hour", "us a sample, here")
    regimes, scenarios = (list(of[order[0]][key]) for key in ("regimes", "scenarios"))
    covered = f"; within {_COVERED[0]:.0%} to {_COVERED[1]:.0%} is as it should be"
    tables = [
        Section(f"Level {level}", f"{source[0].upper()}{source[1:]}.", head, tuple(best)),
        Section(
            f"Level {level}: share of rows within the stated 90 % interval, least of the six axes",
            f"Over all rows and by regime{covered}.",
            ("estimator", "all", *(name.replace("_", " ") for name in regimes)),
            tuple(
                (name, _least(of[name]), *(_least(of[name]["regimes"][regime]) for regime in regimes)) for name in order
            ),
        ),
    ]
    for key, names in (("regimes", regimes), ("scenarios", scenarios)):
        tables.append(
            Section(
                f"Level {level}: errors by {key[:-1]}",
                "Mean of the three force errors, N / of the three moment errors, Nm.",
                ("estimator", *(name.replace("_", " ") for name in names)),
                tuple((name, *(_pair(of[name][key][part]["mae"]) for part in names)) for name in order),
            )
        )
    return tables


def _lab(lab: dict[str, Any]) -> list[Section]:
    runs = [*lab["real"].values(), *lab["twin"].values()]
    rows = [(name, *(_number(run[name]) for run in runs)) for name in lab["ranking"]]
    logs = [log.removeprefix("Movement_") for log in lab["real"]]
    head = ("estimator", *(f"{log}, real" for log in logs), *(f"{log}, twin" for log in logs))
    tau = ", ".join(f"{name} {value:.2f}" for name, value in lab["kendall_tau"].items())
    text = (
        "The twin follows the log's targets while the wrench that its force sensor measured acts on it; error as "
        "above, N, on the real run against the sensor and on the twin's against the truth. Kendall's tau of the order "
        f"of estimators by the mean over the real logs, with that of: {tau}."
    )
    return [Section("Against the lab's logs", text, head, tuple(rows))]


def _number(value: float | None) -> str:
    return "-" if value is None else short_number(value)


def _numbers(values: Sequence[float] | None) -> list[str]:
    return ["-"] * len(WRENCH_AXES) if values is None else [short_number(value) for value in values]


def _pair(mae: Sequence[float] | None) -> str:
    return "-" if mae is None else f"{np.mean(mae[:3]):.2f} / {np.mean(mae[3:]):.2f}"


def _least(item: dict[str, Any]) -> str:
    return "-" if item["coverage_90"] is None else f"{min(item['coverage_90']):.2f}"


def render_markdown(made: Sequence[Section], figures: Sequence[Path]) -> str:
    """The report in Markdown; figures are linked relative to its folder."""
    lines = []
    for k, section in enumerate(made):
        lines += [f"{'#' if k == 0 else '##'} {section.title}", ""]
        if section.text:
            lines += [section.text, ""]
        if section.rows:
            lines += [markdown(section.head, section.rows, words=section.words), ""]
        if k == 0:
            for figure in figures:
                lines += [f"![{figure.stem}]({figure.parent.name}/{figure.name})", ""]
    return "\n".join(lines)


def render_html(made: Sequence[Section], figures: Sequence[Path]) -> str:
    """The report as one page, its figures within."""
    body = []
    for k, section in enumerate(made):
        body.append(f"<h{1 if k == 0 else 2}>{html.escape(section.title)}</h{1 if k == 0 else 2}>")
        if section.text:
            body.append(f"<p>{html.escape(section.text)}</p>")
        if section.rows:
            body.append(_table(section))
        if k == 0:
            body += [_picture(figure) for figure in figures]
    return _PAGE.format(title=html.escape(made[0].title), body="\n".join(body))


def _table(section: Section) -> str:
    def line(cells: Sequence[str], tag: str) -> str:
        kinds = ["" if k < section.words else ' class="n"' for k in range(len(cells))]
        return (
            "<tr>" + "".join(f"<{tag}{c}>{html.escape(x)}</{tag}>" for c, x in zip(kinds, cells, strict=True)) + "</tr>"
        )

    rows = "\n".join(line(row, "td") for row in section.rows)
    return f'<div class="wide"><table><thead>{line(section.head, "th")}</thead><tbody>\n{rows}\n</tbody></table></div>'


def _picture(path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f'<img alt="{html.escape(path.stem.replace("_", " "))}" src="data:image/png;base64,{data}">'


_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; color: #2b2f36; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; }}
h1 {{ font-size: 1.6rem; }} h2 {{ font-size: 1.15rem; margin-top: 2rem; }}
.wide {{ overflow-x: auto; }}
table {{ border-collapse: collapse; font-size: 13px; }}
th, td {{ padding: .25rem .6rem; border-bottom: 1px solid #d9dce1; text-align: left; white-space: nowrap; }}
th {{ vertical-align: bottom; }}
.n {{ text-align: right; font-variant-numeric: tabular-nums; }}
img {{ max-width: 100%; display: block; margin: 1rem 0; }}
</style>
</head>
<body>
{body}
</body>
</html>
"""
