"""``ur5-twin identify``: model files from logs. Heavy imports stay inside the commands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ur5_twin.cli.common import command_line, read_all
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
