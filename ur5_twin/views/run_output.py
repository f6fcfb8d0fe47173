"""The output folder of a scenario's run: recording, log in the lab's format, report, figures, Rerun recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ur5_twin.atomic import write_text
from ur5_twin.control.commands import Command, Pose, ServoJ, Wait
from ur5_twin.errors import ScenarioError
from ur5_twin.evaluation import run_report
from ur5_twin.evaluation.reporting import render_json
from ur5_twin.recording import write_lab_csv, write_parquet
from ur5_twin.recording.table import Recording
from ur5_twin.twin.scenario_run import ScenarioRun
from ur5_twin.twin.telemetry import LINKS

#: The log in the lab's format, a folder that ``replay`` takes.
LOG = "log"


def run_folder(out: Path | None, name: str) -> Path:
    """The folder to write to, by default ``out/<name of the scenario>``; asked for before any work is done.

    Raises:
        ScenarioError: it is a file, or is the default and holds something that is no run.
    """
    folder = out if out is not None else Path("out") / name
    if folder.exists() and not folder.is_dir():
        raise ScenarioError(f"--out {folder} is a file; give a folder")
    if out is None and folder.is_dir() and any(folder.iterdir()) and not _holds_a_run(folder):
        raise ScenarioError(f"{folder} holds something that is no run of a scenario; name a folder with --out")
    return folder


def facts(run: ScenarioRun) -> run_report.RunFacts:
    """What a report needs to know that the recording does not tell."""
    scenario, arm = run.scenario, run.scenario.arm
    return run_report.RunFacts(
        name=scenario.name,
        title=scenario.title,
        description=scenario.description,
        seed=run.seed,
        tool=arm.tool,
        controller=run.setup.controller.name,
        plant=run.setup.plant.name,
        gains=run.setup.gains.name,
        sensors=scenario.sensors.preset,
        stop_reason=run.cell.stop_reason,
        failure=run.cell.failure,
        obstacles=tuple(obstacle.name for obstacle in run.setup.obstacles),
        links=LINKS,
        executed=tuple((_words(item.command), item.start, item.end) for item in run.reference.executed),
        ignored=tuple((_words(item.command), item.time, item.time) for item in run.reference.ignored),
    )


def _words(command: Command) -> str:
    """A command as URScript, numbers short."""
    if isinstance(command, Wait):
        return f"sleep({command.seconds:g})"
    if isinstance(command, ServoJ):
        return f"servoj, {len(command.points)} set points"
    pose = isinstance(command.goal, Pose)
    numbers = command.goal.vector if isinstance(command.goal, Pose) else command.goal
    goal = ", ".join(f"{number:.4g}" for number in numbers)
    return f"{command.name}({'p' if pose else ''}[{goal}], a={command.a:g}, v={command.v:g})"


def _holds_a_run(folder: Path) -> bool:
    try:
        return "scenario" in json.loads((folder / "report.json").read_text(encoding="utf-8"))
    except (OSError, ValueError, TypeError):
        return False


def write_run(run: ScenarioRun, recording: Recording, folder: Path, *, rerun: bool, figures: bool) -> dict[str, Any]:
    """Write a run, whole or ended early; what an earlier run left in the folder is removed first.

    Args:
        run: that made the recording.
        recording: what its devices reported, with the truth.
        folder: made if needed; files in it that no run writes stay.
        rerun: write ``twin.rrd``.
        figures: draw ``figures/*.png``.

    Returns:
        The report.
    """
    report = run_report.summarise_run(recording, scenario=facts(run))
    folder.mkdir(parents=True, exist_ok=True)
    # What an earlier run left here must not be taken for this one's.
    for stale in (folder / "report.json", folder / "report.md", folder / "twin.rrd", *folder.glob("figures/*.png")):
        stale.unlink(missing_ok=True)
    write_parquet(recording, folder / "recording.parquet")
    write_lab_csv(recording, folder / LOG)
    tool, names = run.setup.plant.tool, tuple(obstacle.name for obstacle in run.setup.obstacles)
    drawn: list[Path] = []
    if figures:
        from ur5_twin.views.figures import write_figures

        drawn = write_figures(recording, folder / "figures", title=run.scenario.title, tool=tool, obstacles=names)
    if rerun:
        from ur5_twin.views import rerun_view

        rerun_view.write_rrd(
            recording, run.setup.plant, folder / "twin.rrd", title=run.scenario.title, obstacles=run.setup.obstacles
        )
    write_text(folder / "report.md", run_report.render_run_markdown(report, drawn))
    write_text(folder / "report.json", render_json(report))
    return report
