"""A stream of the real-time interface, made of a log, and somebody who serves it."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pytest

from ur5_twin.recording import Recording, read
from ur5_twin.resources import data_dir
from ur5_twin.wire.realtime_layout import encode

#: Pieces of a stream; None drops the connection and waits for the next one.
Script = Sequence[bytes | None]


class Streamer:
    """Sends a script to whoever connects, a piece at a time; afterwards it is silent."""

    def __init__(self, script: Script, pause: float = 0.002) -> None:
        self._script, self._pause = list(script), pause
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(0.1)
        self.port: int = self._listener.getsockname()[1]
        self._stopping = threading.Event()
        self.finished = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        client = None
        for piece in self._script:
            while client is None and not self._stopping.is_set():
                try:
                    client = self._listener.accept()[0]
                    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                except TimeoutError:
                    continue
            if self._stopping.is_set() or client is None:
                break
            if piece is None:
                client.close()
                client = None
                continue
            try:
                client.sendall(piece)
            except OSError:
                break
            time.sleep(self._pause)
        self.finished.set()
        self._stopping.wait()
        if client is not None:
            client.close()

    def close(self) -> None:
        self._stopping.set()
        self._thread.join()
        self._listener.close()


@pytest.fixture
def stream() -> Iterator[Callable[..., Streamer]]:
    """Serve a script; it is stopped after the test."""
    running: list[Streamer] = []

    def start(script: Script, **options: float) -> Streamer:
        running.append(Streamer(script, **options))
        return running[-1]

    yield start
    for streamer in running:
        streamer.close()


@pytest.fixture(scope="session")
def demo() -> Recording:
    """The log that ships."""
    return read(data_dir("replay") / "demo")


@pytest.fixture(scope="session")
def packets(demo: Recording) -> Callable[..., list[bytes]]:
    """Packets of rows of the log, in the layout of a size, the controller's clock beginning at ``start``."""

    def made(size: int, rows: slice = slice(0, 100), start: float = 100.0) -> list[bytes]:
        robot = demo.robot
        return [
            encode(size, {"timestamp": start + robot.time[k], **{name: robot[name][k] for name in robot.columns}})
            for k in np.arange(len(robot))[rows]
        ]

    return made
