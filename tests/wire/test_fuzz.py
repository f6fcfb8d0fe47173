"""Every port against bytes that mean no good: the server goes on, and keeps nothing of them."""

from __future__ import annotations

import contextlib
import gc
import os
import random
import select
import socket
import struct
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import psutil
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ur5_twin.wire import rdt, xbus
from ur5_twin.wire.mti import MTiPort
from ur5_twin.wire.net_ft import NetFTPort
from ur5_twin.wire.rtde_signals import INPUTS, OUTPUTS
from ur5_twin.wire.server import Server
from ur5_twin.wire.state import State

Serve = Callable[..., Server]

#: What may be left of hundreds of conversations, bytes, beside the length of each tick that the server keeps.
_LEFT, _TICK = 80_000, 40
_COMMANDS = ["power on", "power off", "play", "stop", "popup", "load", "programState", "quit", "shutdown", "addToLog"]
_LINES = ["def f():", "end", "movej([0,0,0,0,0,0])", "while True:", 'x = "def', "# end", "sec s():", "f(", "\x00\xff"]
_REQUESTS = ["GET /netftapi2.xml HTTP/1.1", "HEAD / HTTP/1.0", "POST /netftapi2.xml HTTP/1.1", "Host: x", "", "GET"]


def rtde_package(kind: int, payload: bytes, lie: int) -> bytes:
    """A package whose size is off by ``lie``."""
    return struct.pack(">HB", max(0, min(3 + len(payload) + lie, 0xFFFF)), kind) + payload


names = st.lists(st.sampled_from([*INPUTS, *OUTPUTS, "", "nonsense", "\xe9"]), max_size=8).map(
    lambda found: ",".join(found).encode("latin-1")
)
payloads = st.one_of(
    st.binary(max_size=60), names, st.binary(min_size=8, max_size=8).flatmap(lambda f: names.map(f.__add__))
)
kinds = st.one_of(st.sampled_from(b"VvOISPUM"), st.integers(0, 255))
packages = st.builds(rtde_package, kinds, payloads, st.sampled_from([0, 0, 0, -1, 1, -5, 9000]))
lines = st.lists(st.sampled_from([*_COMMANDS, *_LINES, *_REQUESTS]), max_size=6).map(
    lambda found: "\r\n".join([*found, ""]).encode("latin-1")
)
requests = st.builds(
    struct.pack, st.just(">HHI"), st.sampled_from([0x1234, 0]), st.integers(0, 0x50), st.integers(0, 2**32 - 1)
)
frames = st.builds(xbus.pack, st.integers(0, 255), st.binary(max_size=20))
oversized = st.sampled_from([b"x" * 70_000, b"def f():\n" + b"  y = 1\n" * 9000, b"\xff" * 70_000])
#: Any kind of talk, for any port: whole, cut short, or too long.
pieces = st.one_of(st.binary(max_size=300), packages, lines, requests, frames, oversized)
talks = st.lists(st.one_of(pieces, st.tuples(pieces, st.integers(0, 40)).map(lambda cut: cut[0][: cut[1]])), max_size=5)


class Talker:
    """Says the same at every port of a server."""

    def __init__(self, server: Server) -> None:
        self.server = server
        self._tcp = {name: found for name, found in server.addresses.items() if name not in ("net_ft", "mti")}
        host, self._udp, page = server.addresses["net_ft"]
        self._tcp["net_ft_page"] = (host, page)
        self._host = host
        self._line = os.open(server.addresses["mti"], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._process = psutil.Process()
        self._files = self._process.num_fds()

    def close(self) -> None:
        os.close(self._line)

    def say(self, talk: Sequence[bytes], *, abruptly: bool) -> None:
        for address in self._tcp.values():
            with contextlib.suppress(ConnectionError), socket.create_connection(address, timeout=5.0) as client:
                if abruptly:
                    # Closing resets the connection instead of ending it.
                    client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                for piece in talk:
                    client.sendall(piece)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            for piece in talk:
                # What no datagram can hold does not leave this side.
                with contextlib.suppress(OSError):
                    client.sendto(piece, (self._host, self._udp))
        for piece in talk:
            self._write(piece)

    def _write(self, data: bytes) -> None:
        """To the terminal, whose two sides hold only so much: it is read meanwhile."""
        end = time.monotonic() + 10.0
        while data:
            assert time.monotonic() < end, "the device does not read"
            can_read, can_write, _ = select.select([self._line], [self._line], [], 1.0)
            if can_read:
                os.read(self._line, 65536)
            if can_write:
                data = data[os.write(self._line, data) :]

    def assert_alive(self) -> None:
        """Every port still does what it is for."""
        assert self.server.failure is None
        for name, address in self._tcp.items():
            with socket.create_connection(address, timeout=5.0) as client:
                if name == "net_ft_page":
                    client.sendall(f"GET {rdt.PAGE} HTTP/1.1\r\n\r\n".encode())
                elif name == "rtde":
                    client.sendall(b"\x00\x05V\x00\x02")
                assert client.recv(100), name
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.settimeout(5.0)
            # Others that the talk made the sensor serve make room only when they are found to be gone.
            for _ in range(100):
                client.sendto(rdt.request(rdt.Command.REAL_TIME, 1), (self._host, self._udp))
                with contextlib.suppress(TimeoutError):
                    client.settimeout(0.1)
                    assert rdt.parse_records(client.recv(1000)) is not None
                    break
            else:
                raise AssertionError("the force sensor is silent")
        found = xbus.Frames()
        # What a frame that was never finished announced has to be over.
        self._write(bytes(xbus.LONGEST + 10) + xbus.pack(xbus.Message.GO_TO_CONFIG))
        for _ in range(500):
            if select.select([self._line], [], [], 0.01)[0]:
                data = found.feed(os.read(self._line, 65536))
                if any(frame.message == xbus.Message.GO_TO_CONFIG + 1 for frame in data):
                    break
        else:
            raise AssertionError("the MTi is silent")
        self._write(xbus.pack(xbus.Message.GO_TO_MEASUREMENT))

    def left_of(self, talk: Callable[[], None], times: int) -> int:
        """Bytes that are left of talk after the first time, once it has had the time to be cleared away."""
        tracemalloc.start()
        try:
            talk()
            before, ticks = tracemalloc.get_traced_memory()[0], self.server.statistics.ticks
            for _ in range(times):
                talk()
            # A conversation's task may outlive its socket by some turns of the loop; what is kept is kept for ever.
            for _ in range(200):
                gc.collect()
                found = tracemalloc.get_traced_memory()[0] - before
                found -= _TICK * (self.server.statistics.ticks - ticks)
                if found < _LEFT:
                    break
                time.sleep(0.05)
        finally:
            tracemalloc.stop()
        return found

    def assert_all_gone(self) -> None:
        """Waits for it: a connection may still be in the queue of those to be accepted, on neither side's list."""
        for _ in range(6000):
            counts = self.server.statistics.clients
            talking = any(count for name, count in counts.items() if name != "net_ft")
            files = self._process.num_fds()
            if not talking and files <= self._files:
                return
            time.sleep(0.005)
        raise AssertionError(f"clients stay: {counts}, and {files - self._files} sockets")


@pytest.fixture
def talker(swinging: Any, serve: Serve) -> Iterator[Talker]:
    """A server with both sensors, whose readings come at each tick."""

    class Sensing(swinging):
        def _next(self) -> State:
            state = super()._next()
            time_ = np.array([state.timestamp])
            imu = {name: np.zeros((1, 3)) for name in ("imu_acc", "imu_gyro", "imu_mag")}
            ft = {"time": time_, "ft_wrench": np.ones((1, 6))}
            return replace(state, readings={"ft": ft, "imu": {"time": time_, **imu}})

        def forget(self) -> None:
            for kept in (self.written, self.scripts, self.asked, self.messages):
                kept.clear()

    made = Talker(serve(Sensing(), devices=[NetFTPort(number=0, http=0), MTiPort()]))
    yield made
    made.close()


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(talks, st.booleans())
def test_no_talk_at_any_port_stops_it(talker: Talker, talk: list[bytes], abruptly: bool) -> None:
    talker.say(talk, abruptly=abruptly)
    talker.assert_alive()


def test_what_was_said_is_not_kept(talker: Talker) -> None:
    noise = random.Random(5)
    served: Any = talker.server.controller

    def talk() -> None:
        for _ in range(25):
            said = [noise.randbytes(noise.randrange(400)), b"def f():\n" + noise.randbytes(3000)]
            said += [rtde_package(kind, noise.randbytes(20), noise.choice([0, 1, 500])) for kind in b"VOIUSM"]
            said += [b"power on\npopup " + b"y" * 3000 + b"\n", xbus.pack(noise.randrange(256), noise.randbytes(9))]
            said.append(b"z" * 60_000)
            noise.shuffle(said)
            talker.say(said, abruptly=noise.random() < 0.5)
        talker.assert_all_gone()
        served.forget()

    talk()
    assert talker.left_of(talk, 4) < _LEFT
    talker.assert_alive()


def test_fifty_clients_come_and_go(talker: Talker) -> None:
    process = psutil.Process()

    def fifty() -> None:
        for _ in range(50):
            talker.say([b"\x00\x05V\x00\x02"], abruptly=False)
        talker.assert_all_gone()

    fifty()
    threads, files = threading.active_count(), process.num_fds()
    assert talker.left_of(fifty, 3) < _LEFT
    assert threading.active_count() == threads
    assert process.num_fds() == files
    talker.server.stop()
    assert threading.active_count() == threads - 2
    assert process.num_fds() < files
