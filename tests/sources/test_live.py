"""RTDE by the real ur_rtde from the virtual controller. It knows no port but 30004, hence addresses of our own."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from ur5_twin.errors import MissingExtraError, WireError
from ur5_twin.scenario import load_scenario
from ur5_twin.sources import live
from ur5_twin.sources.live import RtdeSource, connect
from ur5_twin.sources.realtime import RealtimeSource
from ur5_twin.sources.rtde_reader import SIGNALS
from ur5_twin.wire.controller import VirtualController
from ur5_twin.wire.server import Server
from ur5_twin.wire.version import version


class Remembering(VirtualController):
    """Keeps what it has published."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self.published: dict[float, Any] = {}
        super().__init__(*arguments, **options)

    def tick(self) -> Any:
        state = super().tick()
        self.published[state.timestamp] = state.signals
        return state


@pytest.fixture
def host() -> str:
    """An address of this machine that no other test run has."""
    pid = os.getpid()
    return f"127.{64 + pid // 65536 % 128}.{pid // 256 % 256}.{1 + pid % 254}"


@pytest.fixture
def serve(host: str) -> Iterator[Callable[[str], Server]]:
    """Serve a scenario at the robot's own ports."""
    running: list[Server] = []

    def start(series: str) -> Server:
        controller = Remembering(load_scenario("press_plate"), version(series))
        ports = {"dashboard": 0, "primary": 0, "secondary": 0}
        running.append(Server(controller, bind=host, ports=ports))
        running[-1].start()
        return running[-1]

    yield start
    for server in running:
        server.stop()


def gathered(source: Any, rows: int, seconds: float = 20.0) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    pieces, end = [], time.monotonic() + seconds
    while sum(len(piece.time) for piece in pieces) < rows and time.monotonic() < end:
        pieces += source.rows()
        time.sleep(0.01)
    names = pieces[0].columns
    return (
        np.concatenate([piece.time for piece in pieces]),
        {name: np.concatenate([piece.columns[name] for piece in pieces]) for name in names},
    )


@pytest.mark.parametrize("series", ["3.x", "5.x"])
def test_each_row_is_one_tick_as_it_was_published(serve, host: str, series: str) -> None:
    server = serve(series)
    source = connect(host, "rtde")
    stamps, columns = gathered(source, 60)
    source.close()
    server.stop()
    assert isinstance(source, RtdeSource)
    assert (np.diff(stamps) > 0).all()
    published = server.controller.published
    for k, stamp in enumerate(stamps.tolist()):
        signals = published[min(published, key=lambda known: abs(known - stamp))]
        for name, (_, width) in SIGNALS.items():
            expected = np.broadcast_to(np.asarray(signals.get(name, 0.0), dtype=float), (width,))
            np.testing.assert_array_equal(columns[name][k], expected, name)


def test_a_controller_that_starts_again_is_found_again(serve, host: str) -> None:
    server = serve("3.x")
    source = connect(host, "rtde")
    before, _ = gathered(source, 20)
    server.stop()
    serve("3.x")
    end, news = time.monotonic() + 20.0, []
    while len(news) < 2 and time.monotonic() < end:
        news += source.news()
        time.sleep(0.02)
    source.rows()
    after, _ = gathered(source, 5)
    source.close()
    assert source.connections == 2
    assert "lost" in news[0]
    assert "again" in news[1]
    assert before[0] >= 100.0
    assert after[0] >= 100.0


def test_a_controller_without_rtde_is_read_by_the_real_time_interface(serve, host: str) -> None:
    serve("1.8")
    source = connect(host)
    stamps, columns = gathered(source, 20)
    source.close()
    assert isinstance(source, RealtimeSource)
    np.testing.assert_allclose(np.diff(stamps), 0.008, atol=1e-9)
    assert columns["actual_q"].shape[1] == 6


def test_a_controller_that_never_answers_holds_nobody_up(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """ur_rtde's constructor would wait for ever, and with it the whole process."""
    monkeypatch.setattr(live, "_TIMEOUT", 0.5)
    with socket.create_server((host, live.RTDE_PORT)), pytest.raises(WireError, match="no RTDE package came"):
        connect(host, "rtde")


def test_nobody_there_is_said_for_both_interfaces(host: str) -> None:
    with pytest.raises(WireError, match=r"30004: no RTDE .*30003: no real-time interface"):
        connect(host)


def test_without_ur_rtde_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "has_ur_rtde", lambda: False)
    with pytest.raises(MissingExtraError, match=r"ur5-twin\[live\]"):
        connect("127.0.0.1", "rtde")
