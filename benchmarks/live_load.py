"""What ``live`` costs and how long an estimate takes, beside a controller that runs in real time in another process.

    python benchmarks/live_load.py [--seconds 20] [--scenario press_plate]

The controller is ``serve``'s, its ticks computed beforehand, so that its physics takes nothing from what is measured.
CPU seconds of live, the process of ur_rtde included, over seconds on the wall, three seconds after the start; rows that
came, ticks that never came, and the delay from a row's arrival to its estimate. A share of 1 is one core.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import psutil

from ur5_twin.arm.drive import drives_of, load_drive
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.gains import load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.estimation import create, load_nominal
from ur5_twin.live.run import run
from ur5_twin.live.session import Session
from ur5_twin.scenario import load_scenario
from ur5_twin.sources import live
from ur5_twin.twin.live import LiveTwin
from ur5_twin.twin.replay import ReplaySettings
from ur5_twin.views.rerun_live import RerunLive
from ur5_twin.wire.controller import VirtualController
from ur5_twin.wire.server import Server, port_names
from ur5_twin.wire.state import State
from ur5_twin.wire.version import version

TOOL = "ati_gamma+ball_probe"
CASES = (
    ("5.x", "rtde", True, True),
    ("5.x", "realtime", True, True),
    ("5.x", "realtime", True, False),
    ("5.x", "realtime", False, False),
    ("3.x", "rtde", True, True),
    ("3.x", "realtime", True, True),
)


def settings() -> ReplaySettings:
    plant = load_model("plant", TOOL)
    return ReplaySettings(
        load_model("controller"), plant, load_gains("servo"), load_drive("thesis"), load_target_current_law(),
        joints=drives_of(plant),
    )  # fmt: skip


def cpu(process: psutil.Process, server: int) -> float:
    """CPU seconds so far of a process and its children, but for the server's."""
    total = 0.0
    for one in (process, *process.children(recursive=True)):
        if one.pid == server:
            continue
        try:
            times = one.cpu_times()
        except psutil.NoSuchProcess:
            continue
        total += times.user + times.system
    return total


def measure(
    server: int, host: str, interface: str, beside: bool, drawn: bool, seconds: float, folder: Path
) -> dict[str, float]:
    source = live.connect(host, "rtde" if interface == "rtde" else "realtime")
    told = settings()
    estimators = {"friction_kalman": create("friction_kalman", load_nominal(tool=TOOL))} if beside else {}
    session = Session("load", estimators=estimators, twin=LiveTwin(told) if beside else None, folder=folder)
    views = [RerunLive(told.plant, "load", save=folder / "live.rrd")] if drawn else []
    me = psutil.Process()
    # The first seconds hold the compiler's and the imports' work, which a run does once.
    warm = threading.Event()
    begun: dict[str, float] = {}

    def tell(status, _) -> None:
        if not warm.is_set() and status.counts.rows and time.monotonic() - start > 3.0:
            warm.set()
            begun.update(cpu=cpu(me, server), wall=time.monotonic(), rows=status.counts.rows, lost=status.counts.lost)
        elif warm.is_set():
            begun.update(cpu_end=cpu(me, server), wall_end=time.monotonic())

    start = time.monotonic()
    run(source, session, views, stop=threading.Event(), duration=seconds + 3.0, tell=tell)
    status = session.status()
    session.close()
    wall = begun["wall_end"] - begun["wall"]
    return {
        "rows": (status.counts.rows - begun["rows"]) / wall,
        "lost": status.counts.lost - begun["lost"],
        "share": (begun["cpu_end"] - begun["cpu"]) / wall,
        "median": 1e3 * status.latency[0],
        "p99": 1e3 * status.latency[1],
    }


class Played:
    """As ``VirtualController`` to the ports: ticks that were computed before, then the last one again and again."""

    def __init__(self, scenario: str, series: str, seconds: float) -> None:
        self.version = version(series)
        self.failure = None
        self.messages: deque = deque(maxlen=1)
        self.scenario = load_scenario(scenario)
        controller = VirtualController(self.scenario, self.version)
        self._states = [controller.tick() for _ in range(round(seconds / self.version.period))]
        self._next = 0
        self.state = self._states[0]

    def tick(self) -> State:
        self._next += 1
        last = self._states[min(self._next, len(self._states) - 1)]
        stamp = self._states[0].timestamp + self._next * self.version.period
        self.state = replace(last, tick=self._next, timestamp=stamp, signals={**last.signals, "timestamp": stamp})
        return self.state


def serve(scenario: str, series: str, seconds: float, host: str) -> None:
    """Serve until the process is ended; says so when it begins."""
    # The ports ask no more of it than this has.
    played = cast(VirtualController, Played(scenario, series, seconds))
    ports = dict.fromkeys(port_names(played.version), 0)
    with Server(played, bind=host, ports=ports | {"rtde": 30004, "realtime": 30003}) as server:
        print("serving", flush=True)
        sys.stdin.read()
        said = server.statistics
    late = 1e3 * np.percentile(said.interval[1:], 99)
    print(f"{said.ticks} ticks, {said.behind} late, 99 % of intervals below {late:.2f} ms", file=sys.stderr, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--scenario", default="press_plate")
    parser.add_argument("--serve", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        scenario, series, seconds, host = options.serve
        serve(scenario, series, float(seconds), host)
        return
    # ur_rtde knows no port but 30004: an address of our own instead.
    host = f"127.{192 + os.getpid() // 65536 % 32}.{os.getpid() // 256 % 256}.{1 + os.getpid() % 254}"
    print("| controller | interface | twin, estimator | Rerun | rows/s | lost | cores | delay, ms: median, 99 % |")
    print("|---|---|---|---|---|---|---|---|")
    for series, interface, beside, drawn in CASES:
        asked = [options.scenario, series, str(options.seconds + 6.0), host]
        server = subprocess.Popen(
            [sys.executable, __file__, "--serve", *asked], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert server.stdout is not None
        server.stdout.readline()
        try:
            with tempfile.TemporaryDirectory() as folder:
                found = measure(server.pid, host, interface, beside, drawn, options.seconds, Path(folder))
        finally:
            server.communicate()
        yes = {True: "yes", False: "no"}
        print(
            f"| {series} | {interface} | {yes[beside]} | {yes[drawn]} | {found['rows']:.0f} | {found['lost']:.0f} "
            f"| {found['share']:.2f} | {found['median']:.1f}, {found['p99']:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
