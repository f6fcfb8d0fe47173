"""The output folder of a replay: recording, report, figures and the Rerun recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ur5_twin.atomic import write_text
from ur5_twin.errors import ReplayError
from ur5_twin.evaluation import replay_report
from ur5_twin.evaluation.reporting import render_json
from ur5_twin.recording import write_parquet
from ur5_twin.recording.table import Recording
from ur5_twin.twin.replay import ReplaySettings


def output_folder(out: Path | None, recording: Recording, log: Path) -> Path:
    """The folder to write to, by default ``out/<name of the log>``; asked for before any work is done.

    Raises:
        ReplayError: it is a file, or is the default and holds the replay of another log, which would be lost.
    """
    folder = out if out is not None else Path("out") / recording.source
    if folder.exists() and not folder.is_dir():
        raise ReplayError(f"--out {folder} is a file; give a folder")
    other = None if out is not None else _replayed_into(folder)
    if other is not None and Path(other).resolve() != log.resolve():
        raise ReplayError(f"{folder} holds the replay of another log ({other}); name a folder with --out")
    return folder


def _replayed_into(folder: Path) -> str | None:
    """Path of the log whose replay a folder holds, as it was given; None if it holds none."""
    try:
        return str(json.loads((folder / "report.json").read_text(encoding="utf-8"))["log"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_replay(
    recording: Recording, settings: ReplaySettings, folder: Path, *, log: Path, rerun: bool, figures: bool
) -> dict[str, Any]:
    """Write a replayed recording and all that is made of it; what an earlier run left in the folder is removed first.

    Args:
        recording: with the twin's columns.
        settings: of the replay.
        folder: made if needed; files in it that no replay writes stay.
        log: what was replayed, as it was given.
        rerun: write ``twin.rrd``.
        figures: draw ``figures/*.png``.

    Returns:
        The report.
    """
    report = {"log": str(log), **replay_report.summarise(recording, settings)}
    folder.mkdir(parents=True, exist_ok=True)
    # What an earlier run left here must not be taken for this one's.
    for stale in (folder / "report.json", folder / "report.md", folder / "twin.rrd", *folder.glob("figures/*.png")):
        stale.unlink(missing_ok=True)
    write_parquet(recording, folder / "recording.parquet")
    drawn: list[Path] = []
    if figures:
        from ur5_twin.views.figures import write_figures

        drawn = write_figures(recording, folder / "figures", title=recording.source, tool=settings.plant.tool)
    if rerun:
        from ur5_twin.views import rerun_view

        rerun_view.write_rrd(recording, settings.plant, folder / "twin.rrd", title=recording.source)
    write_text(folder / "report.md", replay_report.render_markdown(report, drawn))
    write_text(folder / "report.json", render_json(report))
    return report
