"""``ur5-twin record``: robot, force sensor and accelerometer in parallel. Heavy imports stay inside the command."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ur5_twin.cli.common import command_line, stop_signals, writable

if TYPE_CHECKING:
    from ur5_twin.live.motion_file import MotionFile
    from ur5_twin.live.test_stand import TestStand
    from ur5_twin.sources.link import Link

EXAMPLES = """[bold]Examples[/bold]

ur5-twin record 192.168.1.10 --ft 192.168.1.1 --imu /dev/ttyUSB0 --out measured/monday

ur5-twin record 192.168.1.10 --ft 192.168.1.1 --program waypoints.txt   [dim]# asks before the arm moves[/dim]

ur5-twin record --ft 127.0.0.1:49152,8080 --duration 10   [dim]# a force sensor alone, its page at port 8080[/dim]

ur5-twin replay measured/monday   [dim]# also if record was killed[/dim]
"""


def record(
    host: Annotated[
        str | None, typer.Argument(help="Address or name of the robot, or of 'ur5-twin serve'. Default: no robot.")
    ] = None,
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
    ft: Annotated[
        str | None,
        typer.Option(
            metavar="HOST[:UDP[,HTTP]]", help="An ATI Net F/T; its ports if they are not 49152 and, for its page, 80."
        ),
    ] = None,
    imu: Annotated[
        str | None, typer.Option(metavar="DEVICE", help="Serial port of an Xsens MTi: /dev/ttyUSB0.")
    ] = None,
    imu_baud: Annotated[int, typer.Option(min=1200, help="Of that serial port.")] = 115200,
    imu_rate: Annotated[
        float | None, typer.Option(min=10.0, max=512.0, help="Samples/s to set the MTi to. Default: as it is set.")
    ] = None,
    program: Annotated[
        Path | None,
        typer.Option(
            help="A waypoint or servoj file to run meanwhile, once you have typed 'yes' and the arm is at its start. "
            "[bold]Moves the robot.[/bold]"
        ),
    ] = None,
    script_port: Annotated[int, typer.Option(min=1, max=0xFFFF, help="Where the robot takes URScript.")] = 30002,
    duration: Annotated[
        float | None,
        typer.Option(min=0.1, help="Stop after this many seconds. Default: Ctrl-C, or the end of --program."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Output folder. Default: out/record-<date>-<time>.", callback=writable),
    ] = (None),
) -> None:
    """Record what is connected: robot, force sensor, accelerometer, each with its own time stamps.

    Only listens, unless --program is given. Ctrl-C stops it: the recording is then in the output folder, as Parquet and
    in the lab's layout. Killed at any moment it leaves a journal there, which every command reads.
    """
    from ur5_twin.errors import WireError
    from ur5_twin.live.test_stand import TestStand
    from ur5_twin.terminal import record_line, show_recorded

    if program is not None and host is None:
        raise typer.BadParameter("a program needs the robot's HOST", param_hint="--program")
    folder = out if out is not None else Path("out") / f"record-{time.strftime('%Y%m%d-%H%M%S')}"
    stand = TestStand(_devices(host, port, frequency, ft, imu, imu_baud, imu_rate), folder, name=folder.name)
    stand.connect()
    try:
        task = None
        if program is not None and host is not None:
            from ur5_twin.live.motion_file import Run, ScriptLine

            motion = _confirmed(stand, program)
            line = ScriptLine(host, script_port)
            task = Run(motion, line)
            _check_start(stand, motion)
    except BaseException:
        stand.disconnect()
        raise
    with stop_signals() as stop, record_line(stand.describe(), folder) as tell:
        stand.run(stop=stop, duration=duration, task=task, tell=tell)
    recording = stand.finish({"command": command_line()})
    show_recorded(recording, folder)
    if task is not None and task.failure is not None:
        raise WireError(f"{task.failure}; what was recorded is in {folder}")


def _devices(
    host: str | None,
    port: str,
    frequency: float | None,
    ft: str | None,
    imu: str | None,
    imu_baud: int,
    imu_rate: float | None,
) -> dict[str, Callable[[], Link]]:
    """What connects to each device, by the option that asks for it."""
    devices: dict[str, Callable[[], Link]] = {}
    if host is not None:
        from ur5_twin.cli.live import connect_robot

        devices[f"HOST {host}"] = lambda: connect_robot(host, port, frequency)
    if ft is not None:
        from ur5_twin.sources.net_ft import NetFTSource

        name, udp, page = _ft_address(ft)
        devices[f"--ft {ft}"] = lambda: _started(NetFTSource(name, udp, page=page))
    if imu is not None:
        from ur5_twin.sources.mti import MTiSource

        devices[f"--imu {imu}"] = lambda: _started(MTiSource(imu, baud=imu_baud, rate=imu_rate))
    return devices


def _started(source: Link) -> Link:
    source.start()
    return source


def _ft_address(text: str) -> tuple[str, int, int]:
    """``HOST``, ``HOST:UDP`` or ``HOST:UDP,HTTP``."""
    from ur5_twin.wire.rdt import HTTP_PORT, RDT_PORT

    host, _, ports = text.partition(":")
    numbers = ports.split(",") if ports else []
    if not host or len(numbers) > 2 or not all(n.isascii() and n.isdigit() and 0 < int(n) <= 0xFFFF for n in numbers):
        raise typer.BadParameter(f"'{text}' is not HOST, HOST:UDP or HOST:UDP,HTTP", param_hint="--ft")
    given = [int(number) for number in numbers]
    return host, given[0] if given else RDT_PORT, given[1] if len(given) > 1 else HTTP_PORT


def _confirmed(stand: TestStand, path: Path) -> MotionFile:
    """The file, once it was checked, the arm is at its start, and a person has said yes."""
    from ur5_twin.arm.parameters import load_model
    from ur5_twin.live.motion_file import describe_steps, read_motion_file

    arm = load_model("controller")
    motion = read_motion_file(path, arm, stand.newest()["actual_q"])
    _check_start(stand, motion)
    typer.echo(f"{motion.name}: {describe_steps(motion.steps)}")
    typer.echo(f"It takes about {motion.duration:.0f} s from its start, {motion.start_in_words()}, where the arm is.")
    typer.echo("Is the way free, and is somebody at the emergency stop? Ctrl-C stops the arm.")
    if typer.prompt("type 'yes' to let the robot move", default="", show_default=False) != "yes":
        raise typer.Abort
    return motion


def _check_start(stand: TestStand, motion: MotionFile) -> None:
    """Refuse where the arm is not at the start of a file, or moves."""
    import numpy as np

    from ur5_twin.arm.parameters import load_model
    from ur5_twin.errors import WireError
    from ur5_twin.live.motion_file import STANDING

    newest = stand.newest()
    away = motion.away(newest["actual_q"], load_model("controller"))
    if away is not None:
        raise WireError(
            f"{motion.name}: the arm is not at its start, {motion.start_in_words()}: {away}; move it there with the "
            "teach pendant, then start again"
        )
    if np.abs(newest["actual_qd"]).max() > STANDING:
        raise WireError(f"{motion.name}: the arm moves; wait until it stands, then start again")
