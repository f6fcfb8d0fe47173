"""``ur5-twin estimate``: force estimators on a log. Heavy imports stay inside the command."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ur5_twin.cli.common import complete_tools, shipped, writable
from ur5_twin.terminal import progress

if TYPE_CHECKING:
    import numpy as np

    from ur5_twin.arm.parameters import ArmModel
    from ur5_twin.evaluation.scores import Truth
    from ur5_twin.recording.table import Recording

EXAMPLES = """[bold]Examples[/bold]

ur5-twin estimate lab_logs/kufieta2014/Movement_No9_Singularity_Free_ForceSensor

ur5-twin estimate out/press_plate --estimator friction_kalman --estimator momentum_observer --rerun

ur5-twin estimate monday.csv --against zero   [dim]# free motion: whatever is estimated is a phantom[/dim]

ur5-twin estimate tuesday.csv --estimator mine.py:MyObserver --current-map out/drive/drive.toml
"""


class Against(StrEnum):
    """What the estimates are compared with."""

    ft = "ft"
    truth = "truth"
    zero = "zero"
    nothing = "nothing"


def _complete(incomplete: str) -> list[str]:
    from ur5_twin.estimation.registry import NOT_CAUSAL, estimator_names

    return [name for name in (*estimator_names(), *NOT_CAUSAL) if name.startswith(incomplete)]


def estimate(
    log: Annotated[
        Path, typer.Argument(help="A log as 'replay' takes it, or the output folder of a run, which holds the truth.")
    ],
    estimator: Annotated[
        list[str] | None,
        typer.Option(
            "--estimator",
            "-e",
            autocompletion=_complete,
            help="A name, or path/to/file.py:Class. Default: all that ship.",
        ),
    ] = None,
    against: Annotated[
        Against | None,
        typer.Option(
            help="[bold]truth[/bold] of a run, [bold]ft[/bold] for the force sensor, [bold]zero[/bold] for a log in "
            "which nothing touches the arm. Default: truth or ft, whichever the log has."
        ),
    ] = None,
    tool: Annotated[
        str | None,
        typer.Option(autocompletion=complete_tools, help="At the flange. Default: the devices that the log has."),
    ] = None,
    model: Annotated[str, typer.Option(help="Rigid bodies that the estimators believe in: name or TOML.")] = "plant",
    joints: Annotated[str | None, typer.Option(help="Motors and gears they believe in: a TOML.")] = None,
    current_map: Annotated[
        str, typer.Option(help="Drives as identified, for friction_kalman: lab or a TOML of 'identify drive'.")
    ] = "lab",
    settings: Annotated[
        Path | None, typer.Option(help="TOML of gains and levels. Default: models/estimators.toml.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Output folder. Default: out/estimate-<name of the log>.", callback=writable),
    ] = None,
    rerun: Annotated[
        bool | None,
        typer.Option("--rerun/--no-rerun", help="Write twin.rrd. Default: if the Rerun SDK is installed."),
    ] = None,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures/*.png.")] = True,
    repair: Annotated[
        bool, typer.Option("--repair", help="Repair what is broken in the log and report it, instead of refusing.")
    ] = False,
) -> None:
    """Estimate the contact force from a log's motor currents, by one estimator or all, and judge them."""
    from ur5_twin.estimation.nominal import load_nominal
    from ur5_twin.estimation.registry import estimator_names
    from ur5_twin.evaluation.estimate_report import judge
    from ur5_twin.recording import read
    from ur5_twin.recording.carried import carried_tool
    from ur5_twin.terminal import show_estimates
    from ur5_twin.views import rerun_view
    from ur5_twin.views.estimates import write_estimates

    if rerun:
        rerun_view.need_rerun()
    source = shipped(log)
    recording = read(source, repair=repair)
    nominal = load_nominal(
        model, carried_tool(recording) if tool is None else tool, joints, current_map=current_map, settings=settings
    )
    truth, at_tool = _truth(recording, nominal.arm, against)
    names = estimator or list(estimator_names())
    with progress("estimate", len(names)) as advance:
        judged = judge(recording, names, nominal, truth, at_tool, advance)
    folder = out if out is not None else Path("out") / f"estimate-{recording.source}"
    report = write_estimates(
        judged, folder, log=source, rerun=rerun_view.has_rerun() if rerun is None else rerun, figures=figures
    )
    show_estimates(report, folder)


def _truth(recording: Recording, arm: ArmModel, against: Against | None) -> tuple[Truth | None, np.ndarray | None]:
    from ur5_twin.evaluation import truths

    if against is None:
        known = "truth_wrench" in recording.robot
        against = Against.truth if known else Against.ft if "ft" in recording.tables else Against.nothing
    if against is Against.truth:
        return truths.against_truth(recording), truths.at_tool(recording)
    if against is Against.ft:
        return truths.against_sensor(recording, arm), None
    return (truths.against_zero(recording) if against is Against.zero else None), None
