"""The plant: rotors, torque constants, friction. Heavy imports stay inside the commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ur5_twin.cli.common import command_line, quiet_engine, read_all
from ur5_twin.cli.identify.options import Logs, Out, Repair, error_figure, write_result
from ur5_twin.terminal import progress


def identify_plant(
    logs: Logs,
    tool: Annotated[
        str,
        typer.Option(help="What is bolted to the flange: a tool's name, or a TOML with one table like tools.toml."),
    ] = "none",
    payload: Annotated[
        bool,
        typer.Option(
            "--payload",
            help="Something of unknown weight hangs there besides: find its mass, centre and tensor too.",
        ),
    ] = False,
    bare: Annotated[
        list[Path] | None,
        typer.Option(help="With --payload, a log of the same arm without it, to tell more; more than one: again."),
    ] = None,
    known: Annotated[
        list[str] | None,
        typer.Option(
            help="FIELD=six values, or FIELD.JOINT=VALUE, to be taken as known: torque_constant, rotor_inertia, "
            "coulomb_positive, coulomb_negative, load, viscous, stribeck, stribeck_speed."
        ),
    ] = None,
    base: Annotated[
        str, typer.Option(help="Model whose links are known, and whose numbers stand where the logs tell nothing.")
    ] = "plant",
    out: Out = Path("out/plant"),
    repair: Repair = False,
) -> None:
    """Find your arm's rotor inertias, torque constants, friction and ripple from measured motion and currents.

    Writes plant.toml, with joints.toml beside it, for 'replay --plant DIR/plant.toml --joints plant', with 95 %
    intervals, and a report with the error on each log of a fit to all the others; with --payload also payload.toml, for
    'replay --tool DIR/payload.toml'.
    """
    from ur5_twin.arm.drive import drives_of
    from ur5_twin.arm.parameters import load_model
    from ur5_twin.identification import plant, plant_check, plant_result
    from ur5_twin.identification.plant_solve import FIELDS
    from ur5_twin.identification.plant_windows import motion
    from ur5_twin.views.plant import draw

    quiet_engine()
    given = plant_check.known_values(known or [], tuple(FIELDS))
    model = load_model(base, tool)
    drives = drives_of(model)
    if bare and not payload:
        raise typer.BadParameter("it is for --payload: a log without the payload that is sought", param_hint="--bare")
    recordings = read_all([*logs, *(bare or [])], repair)
    motions = [motion(recording, model, payload=payload) for recording in recordings]
    motions[len(logs) :] = [of.bare() for of in motions[len(logs) :]]
    with progress("fit", 6) as advance:
        fit = plant.fit_plant(motions, drives, model.rotor_inertia, given, advance)
    unseen = []
    if len(recordings) > 1:
        with progress("leave one log out", len(recordings)) as advance:
            unseen = plant_check.unseen(recordings, motions, model, drives, given, advance)
    links = plant_result.links_of(base)
    result = plant_result.plant_result(fit, unseen, model, links, drives, recordings, command_line())
    figures = draw(motions, fit, drives, model.rotor_inertia, out / "figures")
    write_result(result, out, [*error_figure(result, out), *figures])
