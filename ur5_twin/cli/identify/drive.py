"""Motors and gears: the map from torque to current. Heavy imports stay inside the commands."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from ur5_twin.cli.common import command_line, read_all
from ur5_twin.cli.identify.options import Logs, Out, Repair, write_result
from ur5_twin.terminal import progress


class DriveMethod(StrEnum):
    """How ``identify drive`` finds the map from current to torque."""

    map = "map"
    thesis = "thesis"


def identify_drive(
    logs: Logs,
    method: Annotated[
        DriveMethod,
        typer.Option(help="[bold]map[/bold]: ours. [bold]thesis[/bold]: its two-step method, (6.1) to (6.6)."),
    ] = DriveMethod.map,
    tool: Annotated[str, typer.Option(help="What hung on the flange, as 'replay' takes it.")] = "none",
    out: Out = Path("out/drive"),
    repair: Repair = False,
) -> None:
    """Find your arm's torque constants, friction and ripple from logs of free motion.

    Writes joints.toml for 'replay --joints', drive.toml and drive_following.toml for 'replay --drive', and a report
    with the error on each log of a fit to all the others.
    """
    from ur5_twin.arm.drive import load_drive
    from ur5_twin.arm.parameters import load_model
    from ur5_twin.drives import terms
    from ur5_twin.identification import drive, drive_plant, drive_result, thesis_drive
    from ur5_twin.views.drive_relation import draw_relation

    recordings = read_all(logs, repair)
    links = load_model("c", tool)
    rides = [terms.ride(recording, load_model(drive.MODEL, tool)) for recording in recordings]
    two_step, free = thesis_drive.fit_two_step(recordings, links), drive.fit_drive(rides)
    study = None
    if len(recordings) > 1:
        with progress("leave one out", len(recordings)) as advance:
            study = drive.study(recordings, rides, links, load_drive("thesis"), advance)
    if method is DriveMethod.thesis:
        result = drive_result.two_step_result(two_step, study.two_step if study else [], recordings, command_line())
    else:
        plant = drive_plant.fit_plant(rides)
        candidates = study.candidates if study else drive.FREE
        chosen = drive.fit_drive(rides, candidates)
        with progress("errors", 12) as advance:
            free = drive.with_residuals(free, drive.FREE, rides, advance)
            chosen = drive.with_residuals(chosen, candidates, rides, lambda done: advance(6 + done))
        result = drive_result.drive_result(plant, free, chosen, study, recordings, command_line())
    write_result(result, out, draw_relation(recordings, rides, links, two_step.drive, free, out / "figures"))
