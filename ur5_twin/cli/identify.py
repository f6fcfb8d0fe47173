"""``ur5-twin identify``: model files from logs. Heavy imports stay inside the commands."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ur5_twin.cli.common import command_line, complete_models, complete_tools, read_all
from ur5_twin.terminal import progress

if TYPE_CHECKING:
    from ur5_twin.identification.results import Result

_EXAMPLES = """[bold]Examples[/bold]

ur5-twin identify controller monday.csv tuesday.csv --out out/mine

ur5-twin replay wednesday.csv --model out/mine/controller.toml

ur5-twin identify drive monday.csv tuesday.csv wednesday.csv --out out/drive

ur5-twin replay thursday.csv --joints out/drive/joints.toml

ur5-twin identify payload loaded.csv --bare unloaded.csv --out out/payload

ur5-twin replay loaded.csv --tool out/payload/payload.toml

ur5-twin identify sensor monday.csv tuesday.csv --out out/sensor

ur5-twin run free_motion --sensors out/sensor/sensors.toml
"""


class Source(StrEnum):
    """What a payload is told from."""

    currents = "currents"
    target_moment = "target_moment"


class Pushed(StrEnum):
    """Whether somebody pushed through a force sensor."""

    none = "none"
    measured = "measured"


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


@app.command("payload", epilog=_EXAMPLES)
def identify_payload(
    logs: _Logs,
    source: Annotated[
        Source,
        typer.Option(
            "--from",
            help="[bold]currents[/bold]: what really hangs on the flange, from what the motors draw. "
            "[bold]target_moment[/bold]: what the controller was told of, exact.",
        ),
    ] = Source.currents,
    bare: Annotated[
        list[Path] | None,
        typer.Option(
            help="A log of the same arm without the load, so that the difference counts; more than one: again."
        ),
    ] = None,
    between: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Only the logs' rows from one to another second, where the load changes within a log."),
    ] = None,
    tool: Annotated[
        str,
        typer.Option(
            autocompletion=complete_tools,
            help="Tool that is known to be at the flange, or that the controller was told of: the payload is what is "
            "there besides.",
        ),
    ] = "none",
    wrench: Annotated[
        Pushed,
        typer.Option(
            help="[bold]measured[/bold]: an ATI Gamma on the flange felt the pushes in the logs; they are taken off."
        ),
    ] = Pushed.none,
    plant: Annotated[str, typer.Option(autocompletion=complete_models, help="The arm's links and rotors.")] = "plant",
    controller: Annotated[
        str, typer.Option(autocompletion=complete_models, help="The controller's own model, for target_moment.")
    ] = "controller",
    joints: Annotated[str, typer.Option(help="Drives to begin with: 'plant' or a TOML of 'identify drive'.")] = "plant",
    out: Annotated[Path, typer.Option("--out", "-o", help="Output folder.")] = Path("out/payload"),
    repair: _Repair = False,
) -> None:
    """Find mass, mass centre and, where a log tells, inertia of what hangs on the flange.

    Two different things: what the controller was TOLD of is part of its target_moment, without noise; what REALLY hangs
    there shows in the motors' currents, beside friction. Writes payload.toml for --tool and --payload of 'replay',
    'model' and scenarios, unless there is nothing, and a report with 95 % intervals.
    """
    from ur5_twin.arm.drive import load_joint_drives
    from ur5_twin.arm.parameters import FT_SENSOR, load_model, load_tool
    from ur5_twin.identification import payload, payload_result

    recordings = read_all(logs, repair)
    if between is not None:
        recordings = [payload.between(recording, *between) for recording in recordings]
    if source is Source.target_moment:
        fit = payload.fit_told(recordings, load_model(controller, tool))
        result = payload_result.told_result(fit, recordings, command_line())
    else:
        others = read_all([*logs, *bare], repair)[len(logs) :] if bare else []
        sensor = load_tool(FT_SENSOR)
        p_FS = sensor.sensors[FT_SENSOR] if sensor is not None and wrench is Pushed.measured else None
        with progress("fit", None):
            fit = payload.fit_carried(recordings, others, load_model(plant, tool), load_joint_drives(joints), p_FS)
        result = payload_result.carried_result(fit, recordings, others, command_line())
    _write(result, out, _errors(result, out))


@app.command("sensor", epilog=_EXAMPLES)
def identify_sensor(
    logs: _Logs,
    tool: Annotated[
        str | None,
        typer.Option(
            autocompletion=complete_tools,
            help="Tool that carries the sensors, with what hangs on it. Default: ati_gamma, xsens_mti or both, by what "
            "is in the logs.",
        ),
    ] = None,
    sensors: Annotated[
        str, typer.Option(help="Devices whose numbers are kept where the logs tell none: a preset or a TOML.")
    ] = "lab",
    plant: Annotated[str, typer.Option(autocompletion=complete_models, help="The arm's links and rotors.")] = "plant",
    out: Annotated[Path, typer.Option("--out", "-o", help="Output folder.")] = Path("out/sensor"),
    repair: _Repair = False,
) -> None:
    """Find how force sensor and IMU are mounted, what they read without load, and how their clocks run.

    Writes sensors.toml for --sensors of 'run' and 'identify noise' and for a scenario's sensors.preset, and a report
    with 95 % intervals and figures: readings against predictions, agreement of the clocks over their shift.
    """
    from ur5_twin.arm.parameters import load_model
    from ur5_twin.identification import sensor_result
    from ur5_twin.views.sensors import draw_sensors

    recordings = read_all(logs, repair)
    found = []
    with progress("fit", len(recordings)) as advance:
        for done, recording in enumerate(recordings, start=1):
            found.append(sensor_result.fit(recording, lambda name: load_model(plant, name), tool, sensors))
            advance(done)
    result = sensor_result.result(found, recordings, sensors, command_line())
    _write(result, out, draw_sensors(found, out / "figures"))


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
    written = "" if result.model is None else f"{result.file}, "
    print(f"written to {folder}: {written}report.md, report.json")


def _errors(result: Result, folder: Path) -> list[Path]:
    """The figure of the result's tables, if it has any."""
    from ur5_twin.views.identification import draw_errors

    return [draw_errors(result.tables, folder / "figures" / "errors.png")] if result.tables else []
