"""``ur5-twin live``: the twin and force estimators beside a running robot. Heavy imports stay inside the command."""

from __future__ import annotations

import time
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ur5_twin.cli.common import (
    command_line,
    complete_gains,
    complete_models,
    complete_tools,
    quiet_engine,
    replay_settings,
    stop_signals,
    writable,
)

if TYPE_CHECKING:
    from ur5_twin.sources.live import RealtimeSource, RtdeSource

EXAMPLES = """[bold]Examples[/bold]

ur5-twin live 192.168.1.10 --rerun

ur5-twin live 192.168.1.10 --estimator momentum_observer --estimator friction_kalman --tool ati_gamma --duration 60

ur5-twin live 10.0.0.5 --port realtime   [dim]# a controller before 3.3, or without ur_rtde[/dim]

ur5-twin estimate out/live-10.0.0.5-20261123-101500   [dim]# afterwards: all estimators on what was recorded[/dim]
"""


class Mode(StrEnum):
    """How the twin follows the robot."""

    servo = "servo"
    shadow = "shadow"
    none = "none"


def _complete(incomplete: str) -> list[str]:
    from ur5_twin.estimation.registry import estimator_names

    return [name for name in estimator_names() if name.startswith(incomplete)]


def live(
    host: Annotated[str, typer.Argument(help="Address or name of the robot, or of 'ur5-twin serve'.")],
    port: Annotated[
        str,
        typer.Option(
            help="[bold]rtde[/bold] (30004, needs the extra 'live'), [bold]realtime[/bold] (30003), the TCP port of a "
            "real-time interface, or [bold]auto[/bold]: rtde where there is one."
        ),
    ] = "auto",
    frequency: Annotated[
        float | None, typer.Option(min=1.0, max=500.0, help="Of RTDE, Hz. Default: the controller's, 125 or 500.")
    ] = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option(
            "--estimator",
            "-e",
            autocompletion=_complete,
            help="A name, path/to/file.py:Class, or 'none'. The first is shown. Default: friction_kalman.",
        ),
    ] = None,
    mode: Annotated[
        Mode,
        typer.Option(
            help="[bold]servo[/bold]: the twin's closed loop follows the robot's targets. [bold]shadow[/bold]: the "
            "twin is put into the measured state each tick. [bold]none[/bold]: no twin."
        ),
    ] = Mode.servo,
    model: Annotated[
        str, typer.Option("--model", "-m", autocompletion=complete_models, help="Model the controller linearises with.")
    ] = "controller",
    plant: Annotated[
        str | None, typer.Option(autocompletion=complete_models, help="Model that is simulated. Default: plant.")
    ] = None,
    gains: Annotated[
        str | None,
        typer.Option(
            "--gains", "-g", autocompletion=complete_gains, help="Gains of the twin's servo. Default: as in replay."
        ),
    ] = None,
    joints: Annotated[
        str,
        typer.Option(
            help="Motors, gears and friction of the simulated arm: 'plant', a TOML, or 'none' for motors that give "
            "what the controller asks for."
        ),
    ] = "plant",
    tool: Annotated[
        str,
        typer.Option(autocompletion=complete_tools, help="At the flange, for the twin and the estimators."),
    ] = "none",
    payload: Annotated[
        str, typer.Option(autocompletion=complete_tools, help="Tool that the real controller was told of.")
    ] = "none",
    nominal: Annotated[
        str, typer.Option(autocompletion=complete_models, help="Rigid bodies that the estimators believe in.")
    ] = "plant",
    current_map: Annotated[
        str, typer.Option(help="Drives as identified, for friction_kalman: lab or a TOML of 'identify drive'.")
    ] = "lab",
    settings: Annotated[
        Path | None, typer.Option(help="TOML of the estimators' gains and levels. Default: models/estimators.toml.")
    ] = None,
    rerun: Annotated[bool, typer.Option("--rerun", help="Show it in the Rerun viewer.")] = False,
    save: Annotated[Path | None, typer.Option(help="Write what the viewer would show to this .rrd file.")] = None,
    connect: Annotated[
        str | None, typer.Option(help="Show it in a viewer elsewhere: rerun+http://HOST:9876/proxy.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Output folder. Default: out/live-<host>-<date>-<time>.", callback=writable),
    ] = None,
    record: Annotated[bool, typer.Option("--record/--no-record", help="Keep the whole recording.")] = True,
    keep: Annotated[float, typer.Option(min=0.1, max=60.0, help="Minutes that are kept in memory.")] = 2.0,
    duration: Annotated[float | None, typer.Option(min=0.1, help="Stop after this many seconds.")] = None,
) -> None:
    """Run the twin and force estimators beside a robot. Only listens: nothing here moves a robot.

    Ctrl-C stops it; the recording is then in the output folder, with the twin's and the estimators' columns.
    """
    from ur5_twin.atomic import write_text
    from ur5_twin.estimation.nominal import load_nominal
    from ur5_twin.estimation.registry import create
    from ur5_twin.evaluation.reporting import render_json
    from ur5_twin.live.run import Beside, run
    from ur5_twin.live.session import Session
    from ur5_twin.terminal import live_line, show_live
    from ur5_twin.twin.live import LiveTwin
    from ur5_twin.views import rerun_view
    from ur5_twin.views.rerun_live import RerunLive

    drawn = rerun or save is not None or connect is not None
    if drawn:
        rerun_view.need_rerun()
    quiet_engine()
    names = estimator or ["friction_kalman"]
    believed = load_nominal(nominal, tool, current_map=current_map, settings=settings)
    estimators = {name: create(name, believed) for name in names if name != "none"}
    told = replay_settings(
        model, plant, gains, joints, "none", None, "thesis", None, tool, payload, "servo" if mode is Mode.none else mode
    )
    twin = None if mode is Mode.none else LiveTwin(told)
    name = f"live-{host}"
    folder = _folder(out, name) if record else None
    source = connect_robot(host, port, frequency)
    with stop_signals() as stop:
        views = [Beside(RerunLive(told.plant, name, spawn=rerun, save=save, connect=connect))] if drawn else []
        session = Session(name, estimators=estimators, twin=twin, folder=folder, seconds=60.0 * keep)
        session.note(f"from {source.describe()}")
        with live_line(source.describe(), next(iter(estimators), None)) as tell:
            run(source, session, views, stop=stop, duration=duration, tell=tell)
    status = session.status()
    facts = {"live": host, "source": source.describe(), "estimators": list(estimators), **session.facts()}
    if folder is not None:
        session.finish({"command": command_line()})
        write_text(folder / "report.json", render_json(facts))
    show_live(status, session.notes, folder)


def connect_robot(host: str, port: str, frequency: float | None) -> RtdeSource | RealtimeSource:
    """Connect to a robot as ``--port`` says."""
    from ur5_twin.sources import live

    if port in ("auto", "rtde", "realtime"):
        return live.connect(host, port, frequency=frequency)
    if not (port.isascii() and port.isdigit() and 0 < int(port) <= 0xFFFF):
        raise typer.BadParameter(
            f"'{port}' is none of auto, rtde, realtime and no TCP port (1 to 65535)", param_hint="--port"
        )
    return live.connect(host, "realtime", port=int(port))


def _folder(out: Path | None, name: str) -> Path:
    from ur5_twin.errors import RecordingError
    from ur5_twin.recording.reading import JOURNAL_FILE, RECORDING_FILE

    folder = out if out is not None else Path("out") / f"{name}-{time.strftime('%Y%m%d-%H%M%S')}"
    for file in (RECORDING_FILE, JOURNAL_FILE):
        if (folder / file).exists():
            raise RecordingError(f"{folder / file} exists already, and what was measured is never written over")
    return folder
