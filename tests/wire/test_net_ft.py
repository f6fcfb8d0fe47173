"""The Net F/T of the cell against its own client, PyPI's NetFT, and datagrams that mean no good."""

from __future__ import annotations

import http.client
import random
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import Any

import NetFT
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ur5_twin.errors import WireError
from ur5_twin.sources.net_ft import NetFTSource
from ur5_twin.wire import rdt
from ur5_twin.wire.net_ft import MOST_CLIENTS, NetFTPort
from ur5_twin.wire.rdt import Calibration, Command

RATE = 250.0


@pytest.fixture
def serve(bench: Callable[..., Any]) -> Callable[..., Any]:
    """A sensor at free ports."""
    return lambda **options: Served(bench(NetFTPort(number=0, http=0, **options)))


class Served:
    """A sensor that is given its readings by hand."""

    def __init__(self, bench: Any) -> None:
        self.port, self.settle, self._bench = bench.port, bench.settle, bench
        self._sent = 0

    def publish(self, wrench: np.ndarray) -> None:
        """Readings (n, 6), in one tick."""
        stamps = 0.5 + (self._sent + np.arange(len(wrench))) / RATE
        self._sent += len(wrench)
        self._bench.publish(ft={"time": stamps, "ft_wrench": wrench})


def plain(address: tuple[str, int]) -> socket.socket:
    client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    client.connect(address)
    client.settimeout(2.0)
    return client


def ramp(first: int, n: int) -> np.ndarray:
    return np.arange(first, first + n)[:, None] * 0.25 + np.arange(6.0)


def wait_for(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_netft_of_pypi_reads_the_cell(serve: Callable[..., Any]) -> None:
    served = serve()
    client = NetFT.Sensor("127.0.0.1")
    client.sock.connect(served.port.address[:2])
    client.sock.settimeout(2.0)
    client.getMeasurements(3)
    served.settle()
    served.publish(ramp(0, 5))
    got = [client.receive() for _ in range(3)]
    np.testing.assert_array_equal(np.array(got) / 1e6, ramp(0, 3))
    assert served.port.connected == 0
    client.startStreaming(handler=False)
    served.settle()
    served.publish(ramp(5, 2))
    np.testing.assert_array_equal(np.array([client.receive(), client.receive()]) / 1e6, ramp(5, 2))
    client.stopStreaming()
    served.settle()
    assert served.port.connected == 0
    client.sock.close()


def test_our_client_reads_what_the_cell_reads(serve: Callable[..., Any]) -> None:
    served = serve(calibration=Calibration(1e5, 2e3, "lbf", "lbf-in", name="SI-130-10"))
    served.publish(ramp(0, 50))
    source = NetFTSource("127.0.0.1", served.port.address[1], page=served.port.page_address[1])
    feeder = threading.Thread(
        target=lambda: [time.sleep(0.01) or served.publish(ramp(50 + 2 * k, 2)) for k in range(20)]
    )
    feeder.start()
    source.start()
    feeder.join()
    rows: list[Any] = []
    wait_for(lambda: rows.extend(source.rows()) or sum(map(len, (r.time for r in rows))) > 10)
    source.close()
    rows += source.rows()
    assert source.calibration is not None
    assert (source.calibration.name, round(source.calibration.rate)) == ("SI-130-10", RATE)
    stamps = np.concatenate([r.time for r in rows])
    wrench = np.concatenate([r.columns["ft_wrench"] for r in rows])
    first = round((wrench[0, 0]) / 0.25)
    # Half a count, in N and Nm.
    half = 0.5 * source.calibration.per_count + 1e-12
    assert (np.abs(wrench - ramp(first, len(wrench))) <= half).all()
    # To half a sample of the sensor's.
    np.testing.assert_allclose(np.diff(stamps), 1 / RATE, atol=1.0 / rdt.INTERNAL_RATE)
    assert (source.lost, source.disordered, source.faulty) == (0, 0, 0)
    served.settle()
    assert served.port.connected == 0


def test_records_lost_on_the_way_and_disordered_ones_are_counted() -> None:
    sensor = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sensor.bind(("127.0.0.1", 0))
    source = NetFTSource("127.0.0.1", sensor.getsockname()[1], calibration=Calibration())

    def play() -> None:
        sensor.settimeout(5.0)
        asked: list[int] = []
        while Command.REAL_TIME not in asked:
            data, address = sensor.recvfrom(100)
            parsed = rdt.parse_request(data)
            assert parsed is not None
            asked.append(parsed[0])
        high = 2**32 - 1
        for sequence, count, status in [(1, high - 27, 0), (2, high, 0), (5, 83, 0x80020000), (4, 55, 0), (6, 111, 0)]:
            sensor.sendto(rdt.pack_record(sequence, count, status, [sequence] * 6), address)
        sensor.sendto(b"no record", address)

    player = threading.Thread(target=play)
    player.start()
    source.start()
    player.join()
    rows: list[Any] = []
    wait_for(lambda: rows.extend(source.rows()) or sum(len(r.time) for r in rows) == 4)
    source.close()
    sensor.close()
    # The count goes on over its 32 bits.
    stamps = np.concatenate([r.time for r in rows])
    np.testing.assert_allclose(np.diff(stamps) * rdt.INTERNAL_RATE, [27, 84, 28], atol=1e-5)
    assert (source.lost, source.disordered, source.faulty) == (2, 1, 1)
    assert source.news()[:2] == ["the sensor says: saturated", "the sensor's readings are sound again (status 0)"]


def test_the_bias_is_taken_from_the_newest_reading(serve: Callable[..., Any]) -> None:
    served = serve()
    served.publish(ramp(0, 4))
    with plain(served.port.address[:2]) as client:
        client.send(rdt.request(Command.BIAS))
        client.send(rdt.request(Command.RESET_LATCH))
        client.send(rdt.request(Command.REAL_TIME, 1))
        served.settle()
        served.publish(ramp(4, 1))
        records = rdt.parse_records(client.recv(1000))
    assert records is not None
    np.testing.assert_array_equal(records.counts, np.full((1, 6), 250_000))


def test_buffered_records_come_in_groups(serve: Callable[..., Any]) -> None:
    served = serve()
    with plain(served.port.address[:2]) as client:
        client.send(rdt.request(Command.BUFFERED, 11))
        served.settle()
        served.publish(ramp(0, 20))
        sizes = [len(client.recv(4096)) // rdt.RECORD_BYTES for _ in range(2)]
    assert sizes == [8, 3]


def test_what_no_count_can_hold_is_marked(serve: Callable[..., Any]) -> None:
    served = serve(full_scale=np.array([130.0, 130.0, 400.0, 10.0, 10.0, 10.0]))
    rows = np.zeros((4, 6))
    rows[1, 0], rows[2, 5], rows[3, 1] = 1e9, -10.0, np.nan
    with plain(served.port.address[:2]) as client:
        client.send(rdt.request(Command.MULTI_UNIT, 4))
        served.settle()
        served.publish(rows)
        records = [rdt.parse_records(client.recv(1000)) for _ in range(4)]
    status = [int(record.status[0]) for record in records if record is not None]
    assert status == [0, rdt.ERROR | rdt.SATURATED, rdt.ERROR | rdt.SATURATED, 0]
    assert records[1] is not None
    assert records[1].counts[0, 0] == 2**31 - 1


@settings(deadline=None, max_examples=40)
@given(
    data=st.lists(
        st.one_of(
            st.binary(max_size=40),
            st.builds(struct.pack, st.just(">HHI"), *[st.integers(0, 0xFFFF)] * 2, st.integers(0, 2**32 - 1)),
        )
    )
)
def test_datagrams_that_mean_no_good_are_not_answered(data: list[bytes]) -> None:
    port = NetFTPort()
    for k, datagram in enumerate(data):
        port.received(datagram, ("127.0.0.1", 1 + k))
    asked = sum((p := rdt.parse_request(d)) is not None and p[0] in (2, 3, 4) for d in data)
    assert port.connected == min(asked, MOST_CLIENTS)


def test_made_up_senders_do_not_crowd_out_and_do_not_grow(serve: Callable[..., Any]) -> None:
    served = serve()
    with plain(served.port.address[:2]) as client:
        client.send(rdt.request(Command.REAL_TIME))
        served.settle()
        # Sockets that stay open: nobody refuses what they are sent.
        crowd = [plain(served.port.address[:2]) for _ in range(3 * MOST_CLIENTS)]
        for one in crowd:
            one.send(rdt.request(Command.REAL_TIME))
        served.settle()
        assert served.port.connected == MOST_CLIENTS
        served.publish(ramp(0, 1))
        assert rdt.parse_records(client.recv(1000)) is not None
        for one in crowd:
            one.close()


def test_clients_that_vanish_are_forgotten(serve: Callable[..., Any]) -> None:
    served = serve()
    for _ in range(50):
        with plain(served.port.address[:2]) as client:
            client.send(rdt.request(Command.REAL_TIME))
            wait_for(lambda: served.port.connected == 1)
        # Once a record finds nobody there.
        wait_for(lambda: served.publish(ramp(0, 1)) or served.port.connected == 0)
    assert served.port.refused == 0


def test_the_page(serve: Callable[..., Any]) -> None:
    served = serve()

    def get(path: str, method: str = "GET") -> tuple[int, bytes]:
        connection = http.client.HTTPConnection(*served.port.page_address, timeout=2.0)
        connection.request(method, path)
        answer = connection.getresponse()
        found = answer.status, answer.read()
        connection.close()
        return found

    status, page = get("/netftapi2.xml?index=0")
    assert status == 200
    assert Calibration.of_page(page) == Calibration(name="ur5-twin")
    assert get("/other")[0] == 404
    assert get("/netftapi2.xml", "POST")[0] == 405
    noise = random.Random(0)
    for _ in range(20):
        with socket.create_connection(served.port.page_address) as rude:
            rude.send(noise.randbytes(100))
    with socket.create_connection(served.port.page_address) as long:
        long.settimeout(2.0)
        try:
            long.sendall(b"GET /" + b"x" * 100_000)
            assert long.recv(10) == b""
        except ConnectionError:
            pass
    assert get("/netftapi2.xml")[0] == 200


@pytest.mark.parametrize(
    ("page", "what"),
    [
        (b"<netft><cfgcpf>1</cfgcpf></netft>", "lacks cfgcpt"),
        (b"hello", "no XML"),
        (b"<netft><cfgcpf>x</cfgcpf><cfgcpt>1</cfgcpt></netft>", "cfgcpf is 'x', no number"),
        (b"<netft><cfgcpf>-1</cfgcpf><cfgcpt>1</cfgcpt></netft>", "counts_per_force is -1.0; it must be positive"),
        (b"<netft><cfgcpf>1</cfgcpf><cfgcpt>1</cfgcpt><scfgfu>stone</scfgfu></netft>", "unknown unit of force 'stone'"),
        (b'<!DOCTYPE a [<!ENTITY b "c">]><netft/>', "document type"),
        (b" " * (rdt.LONGEST_PAGE + 1), "too long"),
    ],
)
def test_a_page_that_is_none(page: bytes, what: str) -> None:
    with pytest.raises(WireError, match=what):
        Calibration.of_page(page)


@settings(deadline=None, max_examples=50)
@given(
    st.builds(
        Calibration,
        *[st.floats(1e-3, 1e9)] * 2,
        st.sampled_from(["N", "kN", "lbf"]),
        st.sampled_from(["Nm", "N-mm", "lbf-in"]),
    )
)
def test_a_calibration_survives_its_page(calibration: Calibration) -> None:
    np.testing.assert_allclose(Calibration.of_page(calibration.page()).per_count, calibration.per_count, rtol=1e-14)


def test_nobody_there_is_said(serve: Callable[..., Any], bench: Callable[..., Any]) -> None:
    served = serve()
    free = socket.socket()
    free.bind(("127.0.0.1", 0))
    closed = free.getsockname()[1]
    free.close()
    with pytest.raises(WireError, match=r"netftapi2\.xml: what the sensor's counts are worth cannot be read"):
        NetFTSource("127.0.0.1", 1, page=closed).start()
    with pytest.raises(WireError, match="no Net F/T"):
        NetFTSource("127.0.0.1", closed, page=served.port.page_address[1]).start()
    with pytest.raises(WireError, match=r"\(net_ft\) is in use.*--ports net_ft=0,net_ft_page=0"):
        bench(NetFTPort(number=served.port.address[1], http=0))
    with pytest.raises(WireError, match=r"\(net_ft_page\) is in use.*--ports net_ft_page=0"):
        bench(NetFTPort(number=0, http=served.port.address[2]))
