"""The rates that ``serve`` holds with the physics running, and how long it takes from a tick to its estimate.

    python benchmarks/serve_rates.py [--seconds 60] [--scenario free_motion] [--series 3.x 5.x]

The served cell runs in a process of its own. A plain RTDE client in this one asks for what an estimator needs, every
tick, and runs ``friction_kalman`` on each package as it comes. Lost are ticks that the server computed and whose
package did not come, by the stamps; intervals are between packages that arrive, in periods of the controller; the
latency is from the end of the tick, by the same machine's clock, to the estimate. Prints Markdown.
"""

from __future__ import annotations

import argparse
import json
import socket
import struct
import subprocess
import sys
import threading
import time

import numpy as np

from ur5_twin.cli.common import quiet_engine
from ur5_twin.estimation import create, load_nominal
from ur5_twin.estimation.protocol import Sample
from ur5_twin.evaluation.tables import markdown
from ur5_twin.scenario import load_scenario
from ur5_twin.wire.controller import VirtualController, warm_up
from ur5_twin.wire.server import Server, port_names
from ur5_twin.wire.state import State
from ur5_twin.wire.version import version

NAMES = tuple(name for name in Sample._fields[1:] if not name.startswith("imu"))
#: Left out at the beginning: compiling, connecting, s.
START = 2.0
ABSENT = np.full(3, np.nan)


class Noted:
    """A device that writes down when each tick was there."""

    name, address, connected = "noted", None, None

    def __init__(self) -> None:
        self.ticks: list[tuple[float, float]] = []

    async def start(self) -> None:
        pass

    def publish(self, state: State) -> None:
        self.ticks.append((state.timestamp, time.monotonic()))

    async def close(self) -> None:
        pass


def serve(scenario: str, series: str, seconds: float) -> None:
    """The child: the cell behind its ports; then what it counted, as JSON."""
    quiet_engine()
    of = version(series)
    warm_up(of)
    controller, noted = VirtualController(load_scenario(scenario), of), Noted()
    with Server(controller, ports=dict.fromkeys(port_names(of), 0), devices=[noted]) as server:
        print(json.dumps(server.addresses["rtde"]), flush=True)
        server.wait(seconds)
        found = server.statistics
    print(json.dumps({"busy": found.busy, "behind": found.behind, "ticks": found.ticks, "noted": noted.ticks}))


class Rtde:
    """A client of version 2 with one recipe."""

    def __init__(self, address: tuple[str, int], frequency: float) -> None:
        self._socket = socket.create_connection(address, timeout=5.0)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._bytes = b""
        self._ask(b"V", struct.pack(">H", 2))
        self._ask(b"O", struct.pack(">d", frequency) + ",".join(("timestamp", *NAMES)).encode())
        self._ask(b"S", b"")

    def package(self) -> tuple[float, np.ndarray]:
        """Stamp and signals (9, 6) of the next package."""
        while True:
            kind, body = self._next()
            if kind == b"U":
                values = np.frombuffer(body, dtype=">f8", offset=1).astype(float)
                return float(values[0]), values[1:].reshape(-1, 6)

    def _ask(self, kind: bytes, body: bytes) -> None:
        self._socket.sendall(struct.pack(">Hc", 3 + len(body), kind) + body)
        while self._next()[0] != kind:
            pass

    def _next(self) -> tuple[bytes, bytes]:
        while len(self._bytes) < 3 or len(self._bytes) < struct.unpack_from(">H", self._bytes)[0]:
            received = self._socket.recv(65536)
            if not received:
                raise ConnectionResetError
            self._bytes += received
        size = struct.unpack_from(">H", self._bytes)[0]
        package, self._bytes = self._bytes[:size], self._bytes[size:]
        return package[2:3], package[3:]


def measure(scenario: str, series: str, seconds: float) -> list[str]:
    of = version(series)
    estimator = create("friction_kalman", load_nominal("plant", "none"))
    q = np.array([0.1, -1.4, 1.3, -1.2, -1.5, 0.2])
    for k in range(5):  # compiled before the first package
        estimator.update(Sample._make((0.008 * k, q, *np.zeros((4, 6)), q, *np.zeros((3, 6)), ABSENT, ABSENT)))
    estimator = create("friction_kalman", load_nominal("plant", "none"))
    command = [sys.executable, __file__, "--child", scenario, series, str(seconds + START + 1.0)]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    client = Rtde(tuple(json.loads(child.stdout.readline())), 1.0 / of.period)
    stamps, arrived, done = [], [], []
    until = time.monotonic() + START + seconds
    while time.monotonic() < until:
        stamp, values = client.package()
        arrived.append(time.monotonic())
        estimator.update(Sample._make((stamp, *values, ABSENT, ABSENT)))
        done.append(time.monotonic())
        stamps.append(stamp)
    rest: list[str] = []
    reader = threading.Thread(target=lambda: rest.append(child.stdout.read()))  # type: ignore[union-attr]
    reader.start()
    child.wait(timeout=30.0)
    reader.join()
    said = json.loads(rest[0].strip().splitlines()[-1])
    ticked = {round(stamp, 6): at for stamp, at in said["noted"]}
    keep = np.array(arrived) > arrived[0] + START
    seen = np.round(np.array(stamps)[keep], 6)
    sent = [stamp for stamp in ticked if seen[0] <= stamp <= seen[-1]]
    interval = np.diff(np.array(arrived)[keep]) / of.period
    latency = 1e3 * np.array([at - ticked[stamp] for stamp, at in zip(seen, np.array(done)[keep], strict=True)])
    wall = np.array(arrived)[keep][-1] - np.array(arrived)[keep][0]
    return [
        f"{series}, {1.0 / of.period:.0f} Hz",
        f"{(len(seen) - 1) / wall:.1f}",
        f"{len(sent) - len(seen)}",
        " / ".join(f"{value:.2f}" for value in np.percentile(interval, (50, 99))),
        " / ".join(f"{value:.2f}" for value in np.percentile(latency, (50, 99))),
        f"{said['behind']} of {said['ticks']}",
        f"{said['busy']:.2f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--scenario", default="free_motion")
    parser.add_argument("--series", nargs="+", default=["3.x", "5.x"])
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        serve(options.child[0], options.child[1], float(options.child[2]))
        return
    head = (
        "controller",
        "packages/s",
        "lost",
        "interval in periods, median / 99 %",
        "tick to estimate ms, median / 99 %",
        "ticks late by a period",
        "share of a period a tick takes",
    )
    print(markdown(head, [measure(options.scenario, series, options.seconds) for series in options.series]))


if __name__ == "__main__":
    main()
