"""What hangs on the flange: payload, force sensor, IMU. Heavy imports stay inside the commands."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from ur5_twin.cli.common import command_line, complete_models, complete_tools, read_all
from ur5_twin.cli.identify.options import Logs, Out, Repair, error_figure, write_result
from ur5_twin.terminal import progress


class Source(StrEnum):
    """What a payload is told from."""

    currents = "currents"
    target_moment = "target_moment"


class Pushed(StrEnum):
    """Whether somebody pushed through a force sensor."""

    none = "none"
    measured = "measured"


def identify_payload(
    logs: Logs,
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
    out: Out = Path("out/payload"),
    repair: Repair = False,
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
    write_result(result, out, error_figure(result, out))


def identify_sensor(
    logs: Logs,
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
    out: Out = Path("out/sensor"),
    repair: Repair = False,
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
    write_result(result, out, draw_sensors(found, out / "figures"))
