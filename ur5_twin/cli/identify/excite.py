"""A motion that tells most. Heavy imports stay inside the commands."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from ur5_twin.cli.common import command_line, complete_models, complete_tools, quiet_engine, read_all
from ur5_twin.cli.identify.options import Out, Repair, write_result
from ur5_twin.terminal import progress

EXCITE_EXAMPLES = """[bold]Examples[/bold]

ur5-twin identify excite --for drive --out out/excite

ur5-twin run out/excite/scenario.toml   [dim]# the motion, in the twin[/dim]

ur5-twin identify excite --for plant --carry 1.5 0.06 0 0.05 --format servoj --box -0.8 0.2 -0.6 0.6 0.05 0.9

ur5-twin identify excite --for payload --tool ati_gamma --beside monday.csv
"""

_Six = tuple[float, float, float, float, float, float]


class Purpose(StrEnum):
    """What a motion shall tell."""

    drive = "drive"
    plant = "plant"
    payload = "payload"
    servo = "servo"
    all = "all"


class Format(StrEnum):
    """What the controller is sent."""

    waypoints = "waypoints"
    servoj = "servoj"


def identify_excite(
    purpose: Annotated[
        Purpose,
        typer.Option(
            "--for",
            help="[bold]drive[/bold]: torque constants and friction. [bold]plant[/bold]: rotor inertia too. "
            "[bold]payload[/bold]: ten numbers of what is on the flange. [bold]servo[/bold]: its gains. "
            "[bold]all[/bold] of these.",
        ),
    ] = Purpose.drive,
    duration: Annotated[float, typer.Option(min=1.0, max=600.0, help="Of the motion, s.")] = 120.0,
    format: Annotated[
        Format,
        typer.Option(
            help="[bold]waypoints[/bold]: movej with stops, as any controller takes them. [bold]servoj[/bold]: set "
            "points every 8 ms."
        ),
    ] = Format.waypoints,
    plant: Annotated[str, typer.Option(autocompletion=complete_models, help="The arm: a model or a TOML.")] = "plant",
    tool: Annotated[str, typer.Option(autocompletion=complete_tools, help="Tool at the flange.")] = "none",
    payload: Annotated[
        str, typer.Option(autocompletion=complete_tools, help="Tool that the controller is told of.")
    ] = "none",
    carry: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            help="A weight at the flange beside the tool: kg, and x, y, z of its centre in the flange frame, m. Known "
            "and told to the controller, or, where the payload is asked for, about what is expected."
        ),
    ] = None,
    q_start: Annotated[
        _Six | None, typer.Option(help="Where the arm stands, rad. Default: bent, all joints amid their range.")
    ] = None,
    joint_range: Annotated[float, typer.Option(min=0.1, help="How far a joint may be from its start, rad.")] = 2.4,
    speed_limit: Annotated[float, typer.Option(help="Of every joint, rad/s.")] = 1.5,
    acceleration_limit: Annotated[float, typer.Option(help="Of every joint, rad/s^2.")] = 4.0,
    box: Annotated[
        _Six | None,
        typer.Option(help="Walls for flange and tool in the base frame, m: least and greatest x, then y, then z."),
    ] = None,
    min_height: Annotated[
        float, typer.Option(help="Least height of forearm, wrist and tool over the base's plane, m.")
    ] = 0.05,
    clearance: Annotated[
        float, typer.Option(min=0.0, max=0.1, help="Least distance between the arm's parts and to its stand, m.")
    ] = 0.01,
    seed: Annotated[int, typer.Option(min=0, help="Of the search; the same seed gives the same files.")] = 0,
    beside: Annotated[list[Path] | None, typer.Option(help="A log whose motion to compare with; any number.")] = None,
    out: Out = Path("out/excite"),
    repair: Repair = False,
) -> None:
    """Find a motion that tells what you want to identify, within your limits, and try it in the twin first.

    Writes the file for the controller, the planned path as CSV, a scenario that 'run' takes, and a report with the
    standard errors to expect. Writes nothing where there is no such motion.
    """
    import numpy as np

    from ur5_twin.atomic import write_text
    from ur5_twin.identification import excite, excite_search
    from ur5_twin.identification.excite_trial import PLAIN, plain_file
    from ur5_twin.identification.workspace import START
    from ur5_twin.views.excitation import draw_excitation

    quiet_engine()
    walls = np.array([[-np.inf, np.inf]] * 3) if box is None else np.reshape(box, (3, 2))
    request = excite.Request(
        purpose=purpose.value,
        format=format.value,
        duration=duration,
        plant=str(Path(plant).resolve()) if plant.endswith(".toml") else plant,
        tool=tool,
        payload=payload,
        weight=None if carry is None else (carry[0], np.array(carry[1:])),
        q_start=START if q_start is None else np.array(q_start),
        reach=joint_range,
        speed=speed_limit,
        acceleration=acceleration_limit,
        box=walls,
        height=min_height,
        clearance=clearance,
        seed=seed,
    )
    recordings = read_all(beside or [], repair)
    with (
        progress("search", excite_search.GREEDY + excite_search.EXCHANGES) as searching,
        progress("try in the twin", None) as trying,
    ):
        found = excite.excite(request, command_line(), recordings, searching=searching, trying=trying)
    figures = draw_excitation(found, out / "figures")
    write_text(out / found.sent[0], found.sent[1])
    write_text(out / PLAIN, plain_file(found.trial.reference))
    write_result(excite.excite_result(found, command_line()), out, figures)
    print(f"for the arm: {found.sent[0]}, or {PLAIN}; in the twin: ur5-twin run {out / 'scenario.toml'}")
