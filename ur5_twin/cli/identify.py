"""``ur5-twin identify``: model files from logs. Heavy imports stay inside the commands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ur5_twin.cli.common import command_line, quiet_engine, read_all
from ur5_twin.terminal import progress

if TYPE_CHECKING:
    from ur5_twin.identification.results import Result

_EXAMPLES = """[bold]Examples[/bold]

ur5-twin identify controller monday.csv tuesday.csv --out out/mine

ur5-twin replay wednesday.csv --model out/mine/controller.toml

ur5-twin identify drive monday.csv tuesday.csv wednesday.csv --out out/drive

ur5-twin replay thursday.csv --joints out/drive/joints.toml

ur5-twin identify plant monday.csv tuesday.csv --tool ati_gamma --out out/plant

ur5-twin replay thursday.csv --plant out/plant/plant.toml --joints plant
"""

app = typer.Typer(help="Turn logs of your arm into model files for the twin.", no_args_is_help=True)
_Logs = Annotated[list[Path], typer.Argument(help="Logs, as 'replay' takes them. More logs, more to check against.")]
_Repair = Annotated[bool, typer.Option("--repair", help="Repair what is broken in a log and report it.")]


@app.command("controller", epilog=_EXAMPLES)
def identify_controller(
    logs: _Logs,
    out: Annotated[Path, typer.Option("--out", "-o", help="Output folder.")] = Path("out/controller"),
    repair: _Repair = False,
) -> None:
    """Find the model your controller linearises with, from its target_moment.

    Writes controller.toml for 'replay --model', and a report with the error on each log of a fit to all the others.
    """
    from ur5_twin.arm.parameters import load_model
    from ur5_twin.identification import controller, results

    recordings = read_all(logs, repair)
    model = load_model("c")
    fit = controller.fit_rigid(recordings, model)
    held_out = controller.held_out_moment(recordings, model) if len(recordings) > 1 else None
    result = results.controller_result(fit, held_out, load_model("controller"), recordings, command_line())
    _write(result, out, _errors(result, out))


@app.command("controller-current", epilog=_EXAMPLES)
def identify_controller_current(
    logs: _Logs,
    out: Annotated[Path, typer.Option("--out", "-o", help="Output folder.")] = Path("out/controller-current"),
    repair: _Repair = False,
) -> None:
    """Find how your controller's target_current follows from its target_moment and target_qd.

    Writes target_current.toml for 'replay --target-current', and a report.
    """
    from ur5_twin.identification import controller, results

    recordings = read_all(logs, repair)
    fit = controller.fit_target_current(recordings)
    result = results.current_result(fit, recordings, command_line())
    _write(result, out, _errors(result, out))


@app.command("drive", epilog=_EXAMPLES)
def identify_drive(
    logs: _Logs,
    out: Annotated[Path, typer.Option("--out", "-o", help="Output folder.")] = Path("out/drive"),
    repair: _Repair = False,
) -> None:
    """Find your arm's torque constants, friction and ripple from logs of free motion.

    Writes joints.toml for 'replay --joints', and a report with the error on each log of a fit to all the others.
    """
    from ur5_twin.arm.parameters import load_model
    from ur5_twin.identification import drive, drive_plant, drive_result, drive_terms

    recordings = read_all(logs, repair)
    model = load_model("plant")
    plant = drive_plant.fit_plant([drive_terms.ride(recording, model) for recording in recordings])
    held_out = drive.held_out(recordings, model) if len(recordings) > 1 else []
    _write(drive_result.drive_result(plant, held_out, recordings, command_line()), out)


@app.command("plant", epilog=_EXAMPLES)
def identify_plant(
    logs: _Logs,
    tool: Annotated[
        str,
        typer.Option(help="What is bolted to the flange: a tool's name, or a TOML with one table like tools.toml."),
    ] = "none",
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
    out: Annotated[Path, typer.Option("--out", "-o", help="Output folder.")] = Path("out/plant"),
    repair: _Repair = False,
) -> None:
    """Find your arm's rotor inertias, torque constants, friction and ripple from measured motion and currents.

    Writes plant.toml, with joints.toml beside it, for 'replay --plant DIR/plant.toml --joints plant', with 95 %
    intervals, and a report with the error on each log of a fit to all the others.
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
    recordings = read_all(logs, repair)
    motions = [motion(recording, model) for recording in recordings]
    with progress("fit", 6) as advance:
        fit = plant.fit_plant(motions, drives, model.rotor_inertia, given, advance)
    unseen = []
    if len(recordings) > 1:
        with progress("leave one log out", len(recordings)) as advance:
            unseen = plant_check.unseen(recordings, model, drives, given, advance)
    links = plant_result.links_of(base)
    result = plant_result.plant_result(fit, unseen, model, links, drives, recordings, command_line())
    figures = draw(motions, fit, drives, model.rotor_inertia, out / "figures")
    _write(result, out, [*_errors(result, out), *figures])


@app.command("noise", epilog=_EXAMPLES)
def identify_noise(
    logs: _Logs,
    out: Annotated[Path, typer.Option("--out", "-o", help="Output folder.")] = Path("out/noise"),
    sensors: Annotated[str, typer.Option(help="Simulated devices: a preset's name or a TOML.")] = "lab",
    seed: Annotated[int, typer.Option(min=0, help="Of the simulated noise.")] = 0,
    repair: _Repair = False,
) -> None:
    """Measure your devices' noise, steps and clocks, beside the simulated devices' in the same motion."""
    from ur5_twin.identification.noise import measure
    from ur5_twin.sensing import load_sensors
    from ur5_twin.twin.retrace import retrace
    from ur5_twin.views.noise import write_noise

    recordings = read_all(logs, repair)
    suite = load_sensors(sensors)
    measured, simulated = [], []
    with progress("retrace", len(recordings)) as advance:
        for done, recording in enumerate(recordings, start=1):
            measured.append(measure(recording))
            simulated.append(measure(retrace(recording, suite, seed)))
            advance(done)
    print(write_noise(measured, simulated, out, command_line()))
    print(f"written to {out}: report.md, report.json, figures")


def _write(result: Result, folder: Path, figures: Sequence[Path] = ()) -> None:
    """Write it, and say on stdout what was found and where it is."""
    from ur5_twin.identification.results import write

    tables = write(result, folder, figures)
    print(*(f"- {finding}" for finding in result.findings), sep="\n")
    if tables:
        print(f"\n{tables}\n")
    print(f"written to {folder}: {result.file}, report.md, report.json")


def _errors(result: Result, folder: Path) -> list[Path]:
    """The figure of the result's tables, if it has any."""
    from ur5_twin.views.identification import draw_errors

    return [draw_errors(result.tables, folder / "figures" / "errors.png")] if result.tables else []
