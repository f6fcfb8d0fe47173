"""``ur5-twin live``: the twin beside a running robot. Heavy imports stay inside the command."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ur5_twin.cli.common import complete_models, complete_tools, quiet_engine
from ur5_twin.errors import WireError

if TYPE_CHECKING:
    from ur5_twin.estimation.nominal import NominalModel
    from ur5_twin.live.follow import Beat, Follower
    from ur5_twin.sources.device import Device
    from ur5_twin.twin.replay import ReplaySettings
    from ur5_twin.views.rerun_live import LiveView

EXAMPLES = """[bold]Examples[/bold]

ur5-twin live 192.168.1.10 --rerun

ur5-twin live 192.168.1.10 --port realtime --estimator momentum_observer   [dim]# a controller before 3.3[/dim]

ur5-twin serve press_plate --version 5.x   [dim]# and in another terminal:[/dim]   ur5-twin live 127.0.0.1 --rerun
"""

#: Pictures a second for the viewer, and lines a second for the terminal.
_PICTURES, _LINES = 8.0, 4.0
#: Rows before the viewer opens.
_FIRST_ROWS = 20


def live(
    host: Annotated[str, typer.Argument(help="The robot's name or address.")],
    port: Annotated[
        str,
        typer.Option(
            help="[bold]rtde[/bold] (30004, by ur_rtde), [bold]realtime[/bold] (30003, any version), a number for a "
            "real-time interface elsewhere, or auto: RTDE, and if there is none the real-time interface."
        ),
    ] = "auto",
    estimator: Annotated[
        list[str] | None,
        typer.Option("--estimator", "-e", help="A name, or path/to/file.py:Class. Default: friction_kalman."),
    ] = None,
    rerun: Annotated[bool, typer.Option("--rerun", help="Open the Rerun viewer.")] = False,
    save: Annotated[Path | None, typer.Option(help="Write what the viewer would show to an .rrd file.")] = None,
    connect: Annotated[str | None, typer.Option(help="URL of a Rerun viewer that is open elsewhere.")] = None,
    tool: Annotated[str, typer.Option(autocompletion=complete_tools, help="At the flange: a name or a TOML.")] = "none",
    payload: Annotated[
        str | None,
        typer.Option(autocompletion=complete_tools, help="What the controller was told of it. Default: the tool."),
    ] = None,
    model: Annotated[
        str, typer.Option(autocompletion=complete_models, help="Rigid bodies of the twin and the estimators.")
    ] = "plant",
    joints: Annotated[str | None, typer.Option(help="Motors and gears: a TOML. Default: the model's.")] = None,
    current_map: Annotated[str, typer.Option(help="Drives as identified, for friction_kalman.")] = "lab",
    settings: Annotated[Path | None, typer.Option(help="TOML of the estimators' gains and levels.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Output folder. Default: out/live-<date and time>.")
    ] = None,
    duration: Annotated[float | None, typer.Option(min=0.0, help="Stop after so many seconds.")] = None,
) -> None:
    """Run the twin and force estimators beside a robot; it is only listened to, never moved."""
    from ur5_twin.estimation.nominal import load_nominal
    from ur5_twin.estimation.registry import create
    from ur5_twin.live.follow import Follower, warm_up
    from ur5_twin.live.session import beats
    from ur5_twin.recording import read, write_parquet
    from ur5_twin.recording.journal import JOURNAL_FILE, Journal
    from ur5_twin.recording.reading import RECORDING_FILE
    from ur5_twin.views import rerun_view

    if rerun or save is not None or connect is not None:
        rerun_view.need_rerun()
    quiet_engine()
    nominal = load_nominal(model, tool, joints, current_map=current_map, settings=settings)
    estimators = {_short(name): create(name, nominal) for name in estimator or ["friction_kalman"]}
    twin = _twin(nominal, model, tool, payload, joints)
    folder = out if out is not None else Path("out") / time.strftime("live-%Y%m%d-%H%M%S")
    if rerun or save is not None or connect is not None:
        pass  # takes a second, in which the robot would wait
    warm_up(twin, estimators)
    estimators = {_short(name): create(name, nominal) for name in estimator or ["friction_kalman"]}
    robot = _robot(host, port)
    try:
        with Journal(folder / JOURNAL_FILE, source=f"live-{host}") as journal, _stopping() as stopped:
            follower = Follower(robot.columns, twin, estimators, journal)
            shown = _Shown(follower, host, rerun, save, connect)
            ends = None if duration is None else time.monotonic() + duration
            for found in beats(robot, follower, stopped):
                shown.update(found)
                if ends is not None and time.monotonic() >= ends:
                    break
            shown.close()
    finally:
        robot.close()
    if not follower.ring.count:
        raise WireError(f"{host}: nothing came that could be recorded")
    recording = read(folder / JOURNAL_FILE)
    write_parquet(recording, folder / RECORDING_FILE)
    (folder / JOURNAL_FILE).unlink()
    counts = follower.clock.counts
    print(
        f"{counts.rows:,} rows, {counts.lost:,} lost, {counts.late:,} late, {counts.jumps} jumps of the clock, "
        f"{counts.reconnects} reconnects; written to {folder}"
    )
    for note in recording.notes:
        print(f"- {note}")


class _Shown:
    """What is seen meanwhile: a line on the terminal, and the viewer."""

    def __init__(self, follower: Follower, host: str, rerun: bool, save: Path | None, connect: str | None) -> None:
        from rich.console import Console

        self._follower, self._host = follower, host
        self._wanted, self._save, self._connect = rerun or save is not None or connect is not None, save, connect
        self._view: LiveView | None = None
        self._drawn = 0
        self._next_picture = self._next_line = 0.0
        self._console = Console(stderr=True)

    def update(self, found: list[Beat]) -> None:
        now = time.monotonic()
        if self._wanted and now >= self._next_picture and self._follower.ring.count >= _FIRST_ROWS:
            self._next_picture = now + 1.0 / _PICTURES
            self._draw()
        if found and now >= self._next_line and self._console.is_terminal:
            self._next_line = now + 1.0 / _LINES
            self._console.print(_line(found[-1], self._follower), end="\r", highlight=False, markup=False)

    def _draw(self) -> None:
        from ur5_twin.views.rerun_live import LiveView

        rows = self._follower.ring.last(self._follower.ring.count - self._drawn)
        if self._view is None:
            self._view = LiveView(
                self._follower.drawn, rows, f"live {self._host}", save=self._save, connect=self._connect
            )
        self._view.show(rows)
        self._drawn = self._follower.ring.count

    def close(self) -> None:
        if self._wanted and self._follower.ring.count:
            self._draw()
        if self._view is not None:
            self._view.close()
        if self._console.is_terminal:
            self._console.print()


def _line(beat: Beat, follower: Follower) -> str:
    import numpy as np

    from ur5_twin.evaluation.scores import NINETY

    counts, period = follower.clock.counts, follower.clock.period
    parts = [f"{beat.time:9.2f} s", f"{1.0 / period:.0f} Hz" if period else "", f"lost {counts.lost}"]
    parts.append(f"late {counts.late}")
    error = 1e3 * np.abs(beat.columns["sim_actual_q"] - beat.columns["actual_q"]).max()
    parts.append(f"twin off {error:.2f} mrad")
    for name, found in beat.estimates.items():
        force = found.wrench[:3]
        spread = NINETY * np.sqrt(np.maximum(np.diag(found.covariance)[:3], 0.0))
        shown = " ".join(f"{f:+6.1f}±{s:.0f}" for f, s in zip(force, spread, strict=True))
        parts.append(f"{name} {shown} N, contact {found.contact:.2f}")
    return " | ".join(part for part in parts if part)


def _short(name: str) -> str:
    """What an estimator's columns are called: its own name, or that of the class in somebody's file."""
    return name.rpartition(":")[2] if name.rpartition(":")[0].endswith(".py") else name


def _twin(nominal: NominalModel, model: str, tool: str, payload: str | None, joints: str | None) -> ReplaySettings:
    from ur5_twin.arm.drive import drives_of, load_joint_drives
    from ur5_twin.arm.parameters import load_model
    from ur5_twin.control.gains import load_gains
    from ur5_twin.twin.replay import ReplaySettings

    plant = load_model(model, tool)
    return ReplaySettings(
        model=load_model("controller", tool if payload is None else payload),
        plant=plant,
        gains=load_gains("servo"),
        drive=nominal.current_map,
        target_current=nominal.law,
        joints=drives_of(plant) if joints is None else load_joint_drives(joints),
    )


def _robot(host: str, port: str) -> Device:
    """The robot, connected."""
    from ur5_twin.sources.realtime import PORT, RealtimeSource
    from ur5_twin.sources.rtde import RtdeSource

    if port.isdigit():
        robot: Device = RealtimeSource(host, int(port))
    elif port == "realtime":
        robot = RealtimeSource(host, PORT)
    elif port in ("rtde", "auto"):
        robot = RtdeSource(host)
    else:
        raise WireError(f"--port {port}: auto, rtde, realtime or a number")
    try:
        robot.start()
    except WireError as error:
        if port != "auto":
            raise
        robot = RealtimeSource(host, PORT)
        try:
            robot.start()
        except WireError:
            raise error from None
    return robot


@contextlib.contextmanager
def _stopping() -> Iterator[threading.Event]:
    """An event that Ctrl-C and SIGTERM set."""
    stopped = threading.Event()
    before = {number: signal.signal(number, lambda *_: stopped.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stopped
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
