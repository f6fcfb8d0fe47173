"""Programs that connect: a server in the test, the controller's ticks between what it says."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Iterator

import numpy as np
import pytest

from ur5_twin.scenario import load_scenario
from ur5_twin.wire.controller import VirtualController
from ur5_twin.wire.version import version

#: What the ROS 2 driver sends: numbers over this.
SCALE = 1_000_000


@pytest.fixture
def controller() -> VirtualController:
    return VirtualController(load_scenario("free_motion"), version("3.x"), run=False)


@pytest.fixture
def listening() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(5)
        yield server


def connected(controller: VirtualController, listening: socket.socket, script: str) -> socket.socket:
    """The program's connection, once it has opened it."""
    controller.run_script(script.replace("PORT", str(listening.getsockname()[1])))
    controller.tick()
    peer, _ = listening.accept()
    peer.settimeout(5)
    return peer


def test_a_stream_of_set_points_moves_the_arm(controller: VirtualController, listening: socket.socket) -> None:
    """The loop of the ROS 2 driver's program: set points come in, the arm goes after them, silence ends it."""
    script = """
    def program():
      socket_open("127.0.0.1", PORT, "reverse")
      socket_send_int(7, "reverse")
      going = True
      while going:
        data = socket_read_binary_integer(7, "reverse", 0.1)
        if data[0] > 0:
          q = [data[2], data[3], data[4], data[5], data[6], data[7]] / 1000000
          servoj(q, 0, 0, 0.008, 0.05, 500)
        else:
          going = False
          textmsg("silence ", data[0])
        end
      end
      stopj(4.0)
    end
    """
    peer = connected(controller, listening, script)
    with peer:
        controller.tick()
        assert struct.unpack(">i", peer.recv(4)) == (7,)
        start = controller.motion.target[0].copy()
        goal = start + 0.1
        for k in range(300):
            q = start + min(k / 150, 1.0) * (goal - start)
            peer.sendall(struct.pack(">7i", 100, *np.round(q * SCALE).astype(int)))
            controller.tick()
            assert controller.playing
    for _ in range(100):
        controller.tick()
    assert [message.text for message in controller.messages] == ["silence 0"]
    assert not controller.playing
    np.testing.assert_allclose(controller.motion.target[0], goal, atol=1e-5)


def test_numbers_come_in_pieces_and_in_time_or_not_at_all(
    controller: VirtualController, listening: socket.socket
) -> None:
    script = 'socket_open("127.0.0.1", PORT)\nwhile True:\n textmsg(socket_read_binary_integer(2, timeout=0.16))\nend'
    with connected(controller, listening, script) as peer:
        peer.sendall(struct.pack(">ii", -5, 6)[:5])
        for _ in range(10):
            controller.tick()
        assert not controller.messages
        peer.sendall(struct.pack(">ii", -5, 6)[5:])
        controller.tick()
        assert controller.messages[-1].text == "[2, -5, 6]"
        for _ in range(30):
            controller.tick()
        assert controller.messages[-1].text == "[0, -1, -1]"


def test_strings_and_lines(controller: VirtualController, listening: socket.socket) -> None:
    script = """
    socket_open("127.0.0.1", PORT)
    socket_send_line("ready")
    socket_send_byte(65)
    textmsg(socket_read_line())
    textmsg(socket_read_string(prefix="<", suffix=">"))
    textmsg(socket_read_string())
    """
    with connected(controller, listening, script) as peer:
        controller.tick()
        assert peer.recv(100) == b"ready\nA"
        for text in (b"one\r\n", b"..<tw", b"o>", b"three"):
            peer.sendall(text)
            for _ in range(3):
                controller.tick()
    assert [message.text for message in controller.messages] == ["one", "two", "three"]


def test_what_a_program_opened_ends_with_it(controller: VirtualController, listening: socket.socket) -> None:
    with connected(controller, listening, 'socket_open("127.0.0.1", PORT)\nwhile True:\n sync()\nend') as peer:
        controller.stop()
        assert peer.recv(1) == b""


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ('socket_open("192.0.2.1", 50001)', "another machine"),
        ('socket_open("example.org", 50001)', "no IP address"),
        ('socket_open("127.0.0.1", 70000)', "0 to 65535"),
        ("socket_read_binary_integer(1000)", "0 to 30"),
        ("socket_send_int(1e20)", "32 bits"),
    ],
)
def test_what_cannot_be_is_said(controller: VirtualController, script: str, message: str) -> None:
    controller.run_script(script)
    controller.tick()
    assert message in controller.messages[-1].text


def test_nobody_listens(controller: VirtualController, listening: socket.socket) -> None:
    port = listening.getsockname()[1]
    listening.close()
    controller.run_script(
        f'textmsg(socket_open("127.0.0.1", {port}))\ntextmsg(socket_read_line())\ntextmsg(socket_send_int(1))'
    )
    for _ in range(10):
        controller.tick()
    assert [message.text for message in controller.messages] == ["False", "", "False"]


def test_a_flood_is_not_kept(controller: VirtualController, listening: socket.socket) -> None:
    """Who sends without end into a program that waits for something else fills no memory, and no tick."""
    script = 'socket_open("127.0.0.1", PORT)\ntextmsg("got ", socket_read_line(timeout=0))\nwhile True:\n sync()\nend'
    with connected(controller, listening, script) as peer:
        peer.setblocking(False)
        for _ in range(200):
            with contextlib.suppress(BlockingIOError):
                peer.send(b"x" * 65536)
            controller.tick()
            if controller.messages:
                break
        assert [message.text for message in controller.messages] == ["got "]
