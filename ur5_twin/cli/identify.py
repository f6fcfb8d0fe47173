"""``ur5-twin identify``: model files from logs. Heavy imports stay inside the commands."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ur5_twin.cli.common import command_line, complete_models, complete_tools, quiet_engine, read_all
from ur5_twin.terminal import progress

if TYPE_CHECKING:
    from ur5_twin.identification.results import Result

_EXAMPLES = """[bold]Examples[/bold]

ur5-twin identify controller monday.csv tuesday.csv --out out/mine

ur5-twin replay wednesday.csv --model out/mine/controller.toml

ur5-twin identify drive monday.csv tuesday.csv wednesday.csv --out out/drive

ur5-twin replay thursday.csv --joints out/drive/joints.toml

ur5-twin identify servo pushed.csv monday.csv tuesday.csv --out out/servo

ur5-twin replay thursday.csv --gains out/servo/gains.toml

ur5-twin identify plant monday.csv tuesday.csv --tool ati_gamma --out out/plant

ur5-twin replay thursday.csv --plant out/plant/plant.toml --joints plant
"""

_EXCITE_EXAMPLES = """[bold]Examples[/bold]

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


app = typer.Typer(help="Turn logs of your arm into model files for the twin.", no_args_is_help=True)
_Logs = Annotated[list[Path], typer.Argument(help="Logs, as 'replay' takes them. More logs, more to check against.")]
_Repair = Annotated[bool, typer.Option("--repair", help="Repair what is broken in a log and report it.")]


class DriveMethod(StrEnum):
    """How ``identify drive`` finds the map from current to torque."""

    map = "map"
    thesis = "thesis"


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
    method: Annotated[
        DriveMethod,
        typer.Option(help="[bold]map[/bold]: ours. [bold]thesis[/bold]: its two-step method, (6.1) to (6.6)."),
    ] = DriveMethod.map,
    tool: Annotated[str, typer.Option(help="What hung on the flange, as 'replay' takes it.")] = "none",
    out: Annotated[Path, typer.Option("--out", "-o", help="Output folder.")] = Path("out/drive"),
    repair: _Repair = False,
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
    _write(result, out, draw_relation(recordings, rides, links, two_step.drive, free, out / "figures"))


@app.command("servo", epilog=_EXAMPLES)
def identify_servo(
    logs: _Logs,
    out: Annotated[Path, typer.Option("--out", "-o", help="Output folder.")] = Path("out/servo"),
    repair: _Repair = False,
) -> None:
    """Find your servo's gains: from logs of pushes at standstill, from tracking errors of moving ones, or both.

    Writes gains.toml for 'replay --gains', and a report: what each joint's logs tell, the tracking error on each moving
    log by a servo from all the others, and whether the thesis' fit of PD gains to free motion can tell any.
    """
    from ur5_twin.arm.parameters import load_model
    from ur5_twin.control.gains import load_gains
    from ur5_twin.control.target_current import load_target_current_law
    from ur5_twin.identification import servo_nlse, servo_result, servo_tracking
    from ur5_twin.views import servo as views

    recordings = read_all(logs, repair)
    moving = [recording for recording in recordings if not servo_tracking.is_standstill(recording)]
    knowledge = load_gains("servo"), load_model("controller"), load_target_current_law()
    servo = servo_result.fit(recordings, *knowledge)
    with progress("replay", len(moving)) as advance:
        checked = servo_result.held_out(recordings, *knowledge, advance)
    nlse = servo_nlse.fit_nlse(moving) if moving else None
    result = servo_result.servo_result(servo, checked, nlse, recordings, command_line())
    _write(result, out, views.draw(checked, nlse, out / "figures"))


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


@app.command("excite", epilog=_EXCITE_EXAMPLES)
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
    out: Annotated[Path, typer.Option("--out", "-o", help="Output folder.")] = Path("out/excite"),
    repair: _Repair = False,
) -> None:
    """Find a motion that tells what you want to identify, within your limits, and try it in the twin first.

    Writes the file for the controller, the planned path as CSV, a scenario that 'run' takes, and a report with the
    standard errors to expect. Writes nothing where there is no such motion.
    """
    import numpy as np

    from ur5_twin.atomic import write_text
    from ur5_twin.errors import IdentificationError
    from ur5_twin.identification import excite, excite_search
    from ur5_twin.identification.excite_trial import PLAIN, plain_file
    from ur5_twin.identification.workspace import START
    from ur5_twin.views.excitation import draw_excitation

    if out.exists() and not out.is_dir():
        raise IdentificationError(f"--out {out} is a file; give a folder")
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
    _write(excite.excite_result(found, command_line()), out, figures)
    print(f"for the arm: {found.sent[0]}, or {PLAIN}; in the twin: ur5-twin run {out / 'scenario.toml'}")


def _write(result: Result, folder: Path, figures: Sequence[Path] = ()) -> None:
    """Write it, and say on stdout what was found and where it is."""
    from ur5_twin.identification.results import write

    tables = write(result, folder, figures)
    print(*(f"- {finding}" for finding in result.findings), sep="\n")
    if tables:
        print(f"\n{tables}\n")
    print(f"written to {folder}: {', '.join(file.name for file in result.files)}, report.md, report.json")


def _errors(result: Result, folder: Path) -> list[Path]:
    """The figure of the result's tables, if it has any."""
    from ur5_twin.views.identification import draw_errors

    return [draw_errors(result.tables, folder / "figures" / "errors.png")] if result.tables else []
