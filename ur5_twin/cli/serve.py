"""``ur5-twin serve``: a scenario's cell behind a robot's ports. Heavy imports stay inside the command."""

from __future__ import annotations

import sys
import threading
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from ur5_twin.cli.common import quiet_engine, stop_signals

if TYPE_CHECKING:
    from ur5_twin.wire.server import Server
    from ur5_twin.wire.state import State

EXAMPLES = """[bold]Examples[/bold]

ur5-twin serve   [dim]# an arm alone, as a CB3 with 125 Hz[/dim]

ur5-twin serve press_plate --version 5.x

ur5-twin serve free_motion --version 1.6 --late-packages   [dim]# the thesis' robot[/dim]

ur5-twin serve --ports rtde=31004,dashboard=0   [dim]# 0 takes a free port[/dim]
"""

#: What is served when no scenario is named.
_ALONE = "empty_cell"
#: How often it is looked whether it is time to stop, s.
_LOOK = 0.1
#: How often a terminal is told how it goes, s.
_TELL = 2.0
#: What a client does at a port.
_USES = {
    "dashboard": "power, brakes, play, stop; try: nc {host} {port}",
    "primary": "the state at 10 Hz, what programs say; URScript",
    "secondary": "the state at 10 Hz; URScript",
    "realtime": "a packet each tick; URScript",
    "primary_readonly": "the state at 10 Hz, what programs say",
    "secondary_readonly": "the state at 10 Hz",
    "realtime_readonly": "a packet each tick",
    "net_ft": "the force sensor (UDP), its page at {page}: ur5-twin record --ft {host}:{port},{page}",
    "mti": "the accelerometer: ur5-twin record --imu {path}",
    "rtde": 'whatever you choose; ur_rtde: RTDEReceiveInterface("{host}")',
}


def _complete(incomplete: str) -> list[str]:
    from ur5_twin.scenario import scenario_names

    return [name for name in scenario_names() if name.startswith(incomplete)]


def serve(
    scenario: Annotated[
        str | None,
        typer.Argument(autocompletion=_complete, help="A scenario that ships, or a TOML. Default: an arm alone."),
    ] = None,
    version: Annotated[
        str, typer.Option(help="Version of the controller's software: 1.6, 1.8, 3.x, 5.x, or such as 3.15.8.")
    ] = "3.x",
    bind: Annotated[str, typer.Option(help="Address to listen at.")] = "127.0.0.1",
    ports: Annotated[
        str | None,
        typer.Option(
            help="Ports that differ from a robot's: rtde=31004,dashboard=0. 0 takes a free one. net_ft and net_ft_page "
            "are the force sensor's."
        ),
    ] = None,
    free_ports: Annotated[bool, typer.Option("--free-ports", help="Free ports for all that --ports leaves.")] = False,
    realtime: Annotated[
        bool, typer.Option("--realtime/--fast", help="A tick each period, or as fast as the simulation goes.")
    ] = True,
    late_packages: Annotated[
        bool,
        typer.Option("--late-packages", help="The real-time interface's packages late and split, as the lab saw them."),
    ] = False,
    idle: Annotated[bool, typer.Option("--idle", help="The scenario's motion waits for the dashboard's play.")] = False,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the sensors' noise. Default: the scenario's.")] = None,
    duration: Annotated[
        float | None, typer.Option(min=0.0, help="Stop after so many seconds of the controller's clock.")
    ] = None,
) -> None:
    """Serve the cell of a scenario behind the network ports of a UR5, until Ctrl-C."""
    from ur5_twin.errors import SimulationError
    from ur5_twin.scenario import load_scenario
    from ur5_twin.wire import sensors
    from ur5_twin.wire.controller import VirtualController, warm_up
    from ur5_twin.wire.server import Server, port_names
    from ur5_twin.wire.version import version as parsed

    quiet_engine()
    software = parsed(version)
    numbers = dict.fromkeys([*port_names(software), *sensors.NUMBERS], 0) if free_ports else {}
    numbers |= _numbers(ports)
    of_sensors = {name: numbers.pop(name) for name in sensors.NUMBERS if name in numbers}
    loaded = load_scenario(scenario or _ALONE)
    if seed is not None:
        loaded = replace(loaded, seed=seed)
    with stop_signals() as stop:
        warm_up(software)
        controller = VirtualController(loaded, software, run=not idle)
        controller.reaches_out = not _is_loopback(bind)
        devices = sensors.sensor_ports(loaded, bind, of_sensors)
        server = Server(
            controller, bind=bind, ports=numbers, devices=devices, late_packages=late_packages, realtime=realtime
        )
        with server:
            speed = "in real time" if realtime else "as fast as it goes"
            _show(server, f"{loaded.title}: a UR5 with software {software}, {1 / software.period:g} Hz, {speed}", bind)
            _watch(server, stop, duration)
    _show_statistics(server)
    if server.failure is not None:
        raise SimulationError(server.failure)


def _watch(server: Server, stop: threading.Event, duration: float | None) -> None:
    """Wait for the end, and say on a terminal how it goes."""
    from ur5_twin.terminal import serve_line

    begun = server.controller.state.timestamp
    told, ticks = time.monotonic(), server.statistics.ticks
    with serve_line() as tell:
        while not stop.is_set() and not server.wait(_LOOK):
            state = server.controller.state
            if duration is not None and state.timestamp - begun >= duration:
                break
            now = time.monotonic()
            if now - told >= _TELL:
                statistics = server.statistics
                tell(statistics, (statistics.ticks - ticks) / (now - told), _doing(state))
                told, ticks = now, statistics.ticks


def _doing(state: State) -> str:
    """Whether a program plays, and what the safety system says if it is not normal."""
    from ur5_twin.wire.dashboard import SAFETY
    from ur5_twin.wire.modes import RuntimeState, SafetyMode

    runtime = RuntimeState(int(state.signals["runtime_state"])).name.lower()  # type: ignore[arg-type]
    safety = int(state.signals["safety_mode"])  # type: ignore[arg-type]
    return f"program {runtime}" if safety == SafetyMode.NORMAL else f"program {runtime}, {SAFETY[safety]}"


def _numbers(text: str | None) -> dict[str, int]:
    """``rtde=31004,dashboard=0`` -> numbers by name."""
    from ur5_twin.errors import WireError

    found: dict[str, int] = {}
    for part in (text or "").split(","):
        name, _, number = part.partition("=")
        if part.strip():
            if not number.strip().isdecimal():
                raise WireError(f"--ports: '{part.strip()}' is not NAME=NUMBER, such as rtde=31004")
            found[name.strip()] = int(number)
    return found


def _show(server: Server, title: str, bind: str) -> None:
    from ur5_twin.wire.server import NUMBERS

    print(title)
    for name, address in server.addresses.items():
        if isinstance(address, str):
            print(f"  {name:<18} {address}  {_USES[name].format(path=address)}")
            continue
        host, number, *page = address
        use = _USES.get(name, "").format(host=host, port=number, page=page[0] if page else "")
        if name == "rtde" and number != NUMBERS["rtde"]:
            use = "whatever you choose; ur_rtde knows no port but 30004"
        print(f"  {name:<18} {host}:{number:<5}  {use}")
    if not _is_loopback(bind):
        print(
            f"warning: whoever reaches {bind} can run programs on this simulated robot; nothing asks for a password",
            file=sys.stderr,
        )
    print("Ctrl-C stops it", flush=True)


def _show_statistics(server: Server) -> None:
    found = server.statistics
    print(f"{found.ticks} ticks, {found.behind} of them late, a tick took {found.busy:.0%} of its period")
    if found.packages_dropped or found.not_published:
        print(f"{found.packages_dropped} packages were left out for clients that read too slowly", end="")
        print(f", {found.not_published} for all clients" if found.not_published else "")


def _is_loopback(bind: str) -> bool:
    import ipaddress

    try:
        return ipaddress.ip_address(bind).is_loopback
    except ValueError:
        return bind == "localhost"
