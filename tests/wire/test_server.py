"""The server: ports that come and go, ticks that keep time."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable

import pytest

from ur5_twin.errors import SimulationError, WireError
from ur5_twin.wire.server import Server

Serve = Callable[..., Server]


def test_a_port_in_use_is_named_and_nothing_is_left_open(controller, serve: Serve) -> None:
    server = serve(controller)
    taken = server.addresses["rtde"][1]
    threads = threading.active_count()
    with pytest.raises(WireError, match=rf"127\.0\.0\.1:{taken} \(rtde\) is in use.*--ports rtde=0$"):
        serve(controller, ports=dict.fromkeys(server.addresses, 0) | {"rtde": taken})
    assert threading.active_count() == threads


def test_unknown_ports_and_impossible_numbers(controller) -> None:
    with pytest.raises(WireError, match=r"unknown port 'rdte'; did you mean 'rtde'"):
        Server(controller, ports={"rdte": 1})
    with pytest.raises(WireError, match="70000"):
        Server(controller, ports={"rtde": 70000})


def test_an_address_that_is_not_this_machines(controller, serve: Serve) -> None:
    with pytest.raises(WireError, match=r"192\.0\.2\.1' is no address of this machine"):
        serve(controller, bind="192.0.2.1")


def test_more_clients_than_there_is_room_for(controller, serve: Serve) -> None:
    address = serve(controller).addresses["rtde"]
    clients = [socket.create_connection(address, timeout=5.0) for _ in range(65)]
    try:
        # The first are served, the last is sent away.
        clients[0].sendall(b"\x00\x05V\x00\x02")
        assert clients[0].recv(100) == b"\x00\x04V\x01"
        with contextlib.suppress(ConnectionError):
            assert clients[-1].recv(100) == b""
    finally:
        for client in clients:
            client.close()


def test_a_simulation_that_fails_leaves_the_ports_open(controller, serve: Serve, monkeypatch) -> None:
    def fail() -> None:
        raise SimulationError("the arm flew away")

    monkeypatch.setattr(controller, "tick", fail)
    server = serve(controller)
    assert server.wait(5.0)
    assert server.failure == "the arm flew away"
    with socket.create_connection(server.addresses["rtde"], timeout=5.0) as client:
        client.sendall(b"\x00\x05V\x00\x02")
        assert client.recv(100) == b"\x00\x04V\x01"


@pytest.mark.parametrize("realtime", [True, False])
def test_a_port_that_fails_does_not_silence_the_others(controller, serve: Serve, realtime: bool) -> None:
    class Faulty:
        name, address, connected = "faulty", None, None

        async def start(self) -> None: ...

        def publish(self, state) -> None:
            raise ZeroDivisionError("a fault")

        async def close(self) -> None: ...

    server = serve(controller, devices=[Faulty()], realtime=realtime)
    with socket.create_connection(server.addresses["realtime_readonly"], timeout=30.0) as client:
        received = 0
        # More packets than may wait for the ports.
        while received < 100 * controller.version.realtime_size:
            received += len(client.recv(1 << 16))
    assert any("faulty publishes no more: ZeroDivisionError" in one.text for one in controller.messages)


def test_it_can_start_again(controller, serve: Serve) -> None:
    server = serve(controller)
    server.stop()
    before = server.statistics.ticks
    server.start()
    with pytest.raises(WireError, match="runs already"):
        server.start()
    while server.statistics.ticks == before:
        time.sleep(0.002)
    server.stop()


def test_statistics_count_the_clients(controller, serve: Serve) -> None:
    server = serve(controller)
    assert set(server.statistics.clients) == set(server.addresses)
    with (
        socket.create_connection(server.addresses["rtde"], timeout=5.0) as client,
        socket.create_connection(server.addresses["dashboard"], timeout=5.0) as other,
    ):
        client.sendall(b"\x00\x05V\x00\x02")
        assert client.recv(100)
        assert other.recv(100)
        found = {name: count for name, count in server.statistics.clients.items() if count}
        assert found == {"dashboard": 1, "rtde": 1}


def test_statistics_count_the_ticks(controller, serve: Serve) -> None:
    server = serve(controller, realtime=False)
    while server.statistics.ticks < 100:
        time.sleep(0.002)
    server.stop()
    statistics = server.statistics
    assert statistics.ticks == len(statistics.interval)
    assert statistics.busy > 0
