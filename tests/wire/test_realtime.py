"""The real-time interface: packets of every version, late packages, scripts."""

from __future__ import annotations

import itertools
import socket
import struct
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ur5_twin.errors import WireError
from ur5_twin.wire import realtime_layout
from ur5_twin.wire.rtde_signals import OUTPUTS
from ur5_twin.wire.scripts import ScriptReader
from ur5_twin.wire.server import Server
from ur5_twin.wire.streams import CutOff
from ur5_twin.wire.version import version

Serve = Callable[..., Server]

PROGRAM = """def wave():
  # if this comment counted, it would not end
  textmsg("def or while in a string")
  thread Watcher():
    while True:
      sync()
    end
  end
  if True: x = 1 end
  end_force_mode()
  for_all = 2
  movej([0, 0, 0, 0, 0, 0])
end
"""


def read(client: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        piece = client.recv(size - len(data))
        assert piece, "closed"
        data += piece
    return data


def eventually(condition: Callable[[], object]) -> None:
    for _ in range(6000):
        if condition():
            return
        time.sleep(0.005)
    raise AssertionError("it never came to be")


def some_signals() -> dict:
    rng = np.random.default_rng(3)
    signals: dict = {}
    for field in {
        field.name: field for size in realtime_layout.SIZES for field in realtime_layout.fields(size)
    }.values():
        whole = OUTPUTS[field.name].code != "d"
        value = rng.integers(0, 100, field.width) if whole else rng.normal(size=field.width)
        signals[field.name] = value if field.width > 1 else value[0].item()
    return signals | {"robot_mode": 7, "safety_mode": 1}


@pytest.mark.parametrize("size", sorted(realtime_layout.SIZES))
def test_what_is_encoded_is_decoded(size: int) -> None:
    signals = some_signals()
    packet = realtime_layout.encode(size, signals)
    assert len(packet) == size == struct.unpack(">I", packet[:4])[0]
    found = realtime_layout.decode(packet)
    for field in realtime_layout.fields(size):
        np.testing.assert_array_equal(found[field.name], signals[field.name], err_msg=field.name)


@pytest.mark.parametrize("size", sorted(realtime_layout.SIZES))
def test_no_two_fields_overlap(size: int) -> None:
    taken = sorted((field.offset, field.offset + 8 * field.width) for field in realtime_layout.fields(size))
    assert taken[0][0] == realtime_layout.HEADER
    assert taken[-1][1] <= size
    assert all(end <= start for (_, end), (start, _) in itertools.pairwise(taken))


@pytest.mark.parametrize(
    "series", ["1.6", "1.7", "1.8", "3.1", "3.4", "3.9", "3.13", "3.15", "5.3", "5.8", "5.9", "5.10"]
)
def test_every_versions_size_has_a_layout(series: str) -> None:
    assert realtime_layout.fields(version(series).realtime_size)


def test_the_pose_is_where_each_series_has_it() -> None:
    signals = {"actual_TCP_pose": np.arange(6.0), "target_TCP_pose": np.arange(6.0) + 10}
    old, new = realtime_layout.encode(756, signals), realtime_layout.encode(1220, signals)
    assert struct.unpack_from(">6d", old, 588) == tuple(range(6))
    assert struct.unpack_from(">6d", new, 588) == tuple(range(10, 16))
    assert struct.unpack_from(">6d", new, 444) == tuple(range(6))


@pytest.mark.parametrize(("robot", "safety", "old"), [(7, 1, 0), (5, 1, 2), (3, 1, 7), (7, 3, 4), (3, 7, 5), (6, 1, 1)])
def test_modes_of_the_first_series(robot: int, safety: int, old: int) -> None:
    packet = realtime_layout.encode(812, {"robot_mode": robot, "safety_mode": safety})
    assert struct.unpack_from(">d", packet, 756)[0] == old
    found = realtime_layout.decode(packet)
    assert (found["robot_mode"], found["safety_mode"]) == (robot, safety)


def test_what_is_no_packet() -> None:
    with pytest.raises(WireError, match=r"no version's real-time packet has 757 bytes.*1220 \(5\.10 and later\)"):
        realtime_layout.decode(struct.pack(">I", 757) + bytes(753))
    with pytest.raises(WireError, match="756 bytes with 100"):
        realtime_layout.decode(struct.pack(">I", 756) + bytes(96))


@pytest.mark.parametrize("series", ["1.6", "1.8", "3.4", "5.25.1"])
@pytest.mark.parametrize("port", ["realtime", "realtime_readonly"])
def test_a_packet_each_tick(swinging, serve: Serve, series: str, port: str) -> None:
    controller = swinging(series)
    size = controller.version.realtime_size
    with socket.create_connection(serve(controller).addresses[port], timeout=5.0) as client:
        stamps = []
        for _ in range(10):
            found = realtime_layout.decode(read(client, size))
            np.testing.assert_array_equal(found["actual_q"], np.sin(np.arange(6) + found["timestamp"]))
            stamps.append(found["timestamp"])
    np.testing.assert_allclose(np.diff(stamps), controller.version.period)


def test_late_packages_arrive_joined_and_split(swinging, serve: Serve) -> None:
    server = serve(swinging("1.6"), late_packages=True)
    with socket.create_connection(server.addresses["realtime"], timeout=5.0) as client:
        pieces = [client.recv(65536) for _ in range(90)]
    data = b"".join(pieces)
    # As figure 4.4 has them; a reader that is slow may find pieces joined.
    lengths = [len(piece) for piece in pieces]
    assert lengths.count(756 + 694) > 10
    assert lengths.count(62) > 10
    stamps = [
        realtime_layout.decode(data[place : place + 756])["timestamp"] for place in range(0, len(data) - 755, 756)
    ]
    np.testing.assert_allclose(np.diff(stamps), 0.008)


def test_at_rest_no_package_is_late(swinging, serve: Serve) -> None:
    server = serve(swinging("1.6", moving=False), late_packages=True)
    with socket.create_connection(server.addresses["realtime"], timeout=5.0) as client:
        assert all(len(client.recv(65536)) % 756 == 0 for _ in range(20))


def test_scripts_reach_the_controller(controller, serve: Serve) -> None:
    with socket.create_connection(serve(controller).addresses["realtime"], timeout=5.0) as client:
        client.sendall(b"\n# a comment\nset_digital_out(0, True)\nstopj(2)\r\n")
        eventually(lambda: len(controller.scripts) == 2)
        for line in PROGRAM.splitlines(keepends=True):
            client.sendall(line.encode())
        eventually(lambda: len(controller.scripts) == 3)
        client.sendall(b"movej([0,0,0,0,0,0])")
    eventually(lambda: len(controller.scripts) == 4)
    assert controller.scripts == ["set_digital_out(0, True)\n", "stopj(2)\n", PROGRAM, "movej([0,0,0,0,0,0])\n"]


def test_a_script_that_is_sent_and_left_without_reading_is_not_lost(controller, serve: Serve) -> None:
    server = serve(controller)
    held, go_on = threading.Event(), threading.Event()

    def hold() -> None:
        held.set()
        go_on.wait(10.0)

    with socket.create_connection(server.addresses["realtime"], timeout=5.0) as client:
        read(client, controller.version.realtime_size)
        # While the ports stand still, packages to a client pile up that resets its connection meanwhile.
        assert server._loop is not None
        server._loop.call_soon_threadsafe(hold)
        assert held.wait(5.0)
        client.sendall(b"stopj(2)\nstopl(3)")
    before = server.statistics.ticks
    eventually(lambda: server.statistics.ticks > before + 2)
    go_on.set()
    eventually(lambda: len(controller.scripts) == 2)
    assert controller.scripts == ["stopj(2)\n", "stopl(3)\n"]


def test_read_only_means_it(controller, serve: Serve) -> None:
    server = serve(controller)
    with socket.create_connection(server.addresses["realtime_readonly"], timeout=5.0) as client:
        client.sendall(b"stopj(2)\n")
        read(client, 3 * controller.version.realtime_size)
    assert not controller.scripts


def test_who_never_reads_stays_and_can_still_send(controller, serve: Serve) -> None:
    server = serve(controller, realtime=False)
    with socket.create_connection(server.addresses["realtime"], timeout=5.0) as client:
        eventually(lambda: server.statistics.packages_dropped > 50)
        client.sendall(b"stopj(2)\n")
        eventually(lambda: controller.scripts)
        # What has piled up is whole packets.
        for _ in range(50):
            realtime_layout.decode(read(client, controller.version.realtime_size))
    assert server.statistics.clients_cut == 0


def test_a_line_without_an_end_is_cut_off(controller, serve: Serve) -> None:
    server = serve(controller)
    with socket.create_connection(server.addresses["realtime"], timeout=5.0) as client:
        try:
            for _ in range(100):
                client.sendall(b"x" * 65536)
        except ConnectionError:
            pass
        eventually(lambda: server.statistics.clients_cut == 1)
    assert not controller.scripts


def test_who_sends_more_scripts_than_can_be_taken_is_cut_off(controller, serve: Serve, monkeypatch) -> None:
    server = serve(controller)

    def busy(action: Callable[[], object]) -> object:
        raise WireError("1000 requests wait already")

    monkeypatch.setattr(controller, "post", busy)
    with socket.create_connection(server.addresses["realtime"], timeout=5.0) as client:
        client.sendall(b"stopj(2)\n" * 100)
        eventually(lambda: server.statistics.clients_cut == 1)
    with socket.create_connection(server.addresses["realtime"], timeout=5.0) as client:
        client.sendall(b"stopj(2)")
    eventually(lambda: not any(server.statistics.clients.values()))
    with socket.create_connection(server.addresses["realtime"], timeout=5.0) as client:
        assert read(client, controller.version.realtime_size)
    assert server.statistics.clients_cut == 1


@pytest.mark.parametrize(
    "body",
    [
        " switch x:\n  case 1:\n   x = 2\n  end\n  default:\n   x = 3\n  end\n end\n",
        " textmsg('the end')\n",
        " textmsg('if')\n if x == 1: x = 2 end # if\n",
        " for = 3\n",
    ],
)
def test_a_program_ends_where_its_blocks_do(body: str) -> None:
    program = f"def f():\n x = 1\n{body} x = 4\nend\n"
    assert ScriptReader().feed(f"{program}x = 5\n".encode()) == [program, "x = 5\n"]


def test_a_program_without_an_end_is_cut_off() -> None:
    reader = ScriptReader()
    half = b"def f():\n" + b"  x = 1\n" * 100_000
    assert reader.feed(half) == []
    with pytest.raises(CutOff, match="1048576"):
        reader.feed(half)


@given(st.lists(st.integers(0, len(PROGRAM)), max_size=8))
def test_a_program_may_come_in_any_pieces(cuts: list[int]) -> None:
    reader = ScriptReader()
    data = PROGRAM.encode()
    edges = [0, *sorted(cuts), len(data)]
    scripts = [script for a, b in itertools.pairwise(edges) for script in reader.feed(data[a:b])]
    assert scripts == [PROGRAM]
    assert reader.rest() is None


@given(st.binary(max_size=2000))
def test_no_bytes_stop_the_reader(data: bytes) -> None:
    reader = ScriptReader()
    for byte in data:
        reader.feed(bytes([byte]))
    reader.rest()
