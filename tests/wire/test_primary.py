"""The primary and secondary interfaces, taken apart as clients do."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable

import numpy as np
import pytest

from ur5_twin.arm.parameters import load_model
from ur5_twin.wire import primary_packages as packages
from ur5_twin.wire.server import Server
from ur5_twin.wire.version import version

Serve = Callable[..., Server]


def read(client: socket.socket) -> tuple[int, bytes]:
    """A package: its type and what follows."""

    def exactly(size: int) -> bytes:
        data = b""
        while len(data) < size:
            piece = client.recv(size - len(data))
            assert piece, "closed"
            data += piece
        return data

    size, kind = struct.unpack(">IB", exactly(5))
    return kind, exactly(size - 5)


def parts(state: bytes) -> dict[int, bytes]:
    """Sub-package's type -> its fields."""
    found = {}
    while state:
        size, kind = struct.unpack_from(">IB", state)
        found[kind], state = state[5:size], state[size:]
    return found


def eventually(condition: Callable[[], object]) -> None:
    for _ in range(6000):
        if condition():
            return
        time.sleep(0.005)
    raise AssertionError("it never came to be")


@pytest.mark.parametrize(
    ("series", "sizes"),
    [
        ("1.6", {0: 29, 1: 251, 2: 37, 3: 64, 4: 53}),
        ("1.8", {0: 29, 1: 251, 2: 37, 3: 64, 4: 53, 6: 445}),
        ("3.0", {0: 38, 1: 251, 2: 37, 3: 68, 4: 53, 6: 445}),
        ("3.2", {0: 46, 3: 72, 4: 101, 6: 445}),
        ("3.15", {0: 46, 1: 251, 2: 37, 3: 74, 4: 101, 5: 225, 6: 445, 7: 61}),
        ("5.25", {0: 47, 1: 251, 2: 37, 3: 75, 4: 101, 5: 225, 6: 445, 7: 61}),
    ],
)
def test_sub_packages_have_the_sizes_that_clients_expect(series: str, sizes: dict[int, int]) -> None:
    state = packages.robot_state(version(series), 100.0, {}, load_model("controller"))
    size, kind = struct.unpack_from(">IB", state)
    assert (size, kind) == (len(state), 16)
    found = {kind: len(fields) + 5 for kind, fields in parts(state[5:]).items()}
    assert sizes.items() <= found.items()


def test_the_state_says_what_the_controller_does(controller, serve: Serve) -> None:
    server = serve(controller)
    with socket.create_connection(server.addresses["primary"], timeout=5.0) as client:
        kind, message = read(client)
        assert kind == 20
        assert message[8:10] == struct.pack(">bB", -2, 3)
        assert message[11:20] == b"URControl"
        assert struct.unpack_from(">BBii", message, 20) == (5, 25, 1, 0)
        stamps = []
        for _ in range(4):
            kind, state = read(client)
            assert kind == 16
            found = parts(state)
            stamp = struct.unpack_from(">Q", found[0])[0] * 1e-6
            stamps.append(stamp)
            rows = [struct.unpack_from(">3d4fB", found[1], 41 * joint) for joint in range(6)]
            np.testing.assert_allclose([row[0] for row in rows], np.sin(np.arange(6) + stamp), atol=1e-6)
            assert [row[-1] for row in rows] == [253] * 6
            # Connected, enabled, power on, no stop, the program plays, the robot runs.
            assert struct.unpack_from(">7?B", found[0], 8) == (True, True, True, False, False, True, False, 7)
            assert struct.unpack_from(">6d", found[4]) == pytest.approx(0.1 * np.cos(np.arange(6) + stamp), abs=1e-6)
    np.testing.assert_allclose(np.diff(stamps)[1:], 0.1)


def test_the_configuration_is_the_arms() -> None:
    arm = load_model("controller")
    found = parts(packages.robot_state(version("5.x"), 100.0, {}, arm)[5:])[6]
    values = struct.unpack(">53d4i", found)
    np.testing.assert_allclose(values[1:12:2], arm.limits.q)
    np.testing.assert_allclose(values[29:35], arm.dh.a)
    np.testing.assert_allclose(values[35:41], arm.dh.d)
    assert values[-2] == 1


@pytest.mark.parametrize("suffix", ["", "_readonly"])
def test_messages_go_to_the_primary_interface_only(controller, serve: Serve, suffix: str) -> None:
    controller.say("text", "before anybody listened")
    server = serve(controller)
    with (
        socket.create_connection(server.addresses[f"primary{suffix}"], timeout=5.0) as primary,
        socket.create_connection(server.addresses[f"secondary{suffix}"], timeout=5.0) as secondary,
    ):
        for client in (primary, secondary):
            assert [read(client)[0] for _ in range(2)] == [20, 16]
        for kind, text in (("text", "hällo"), ("popup", "mind the arm"), ("error", "line 3: no such function")):
            controller.say(kind, text)
        said = []
        while len(said) < 3:
            kind, message = read(primary)
            if kind == 20:
                said.append((message[9], message))
        assert [kind for kind, _ in said] == [0, 2, 10]
        assert said[0][1][10:].decode() == "hällo"
        assert said[1][1].endswith(b"Popupmind the arm")
        assert said[2][1].endswith(b"line 3: no such function")
        assert [read(secondary)[0] for _ in range(3)] == [16] * 3


@pytest.mark.parametrize("port", ["primary", "secondary"])
def test_scripts_come_in(controller, serve: Serve, port: str) -> None:
    with socket.create_connection(serve(controller).addresses[port], timeout=5.0) as client:
        client.sendall(b"def hello():\n  textmsg(1)\nend\n")
        eventually(lambda: controller.scripts == ["def hello():\n  textmsg(1)\nend\n"])


@pytest.mark.parametrize("port", ["primary_readonly", "secondary_readonly"])
def test_read_only_means_it(controller, serve: Serve, port: str) -> None:
    with socket.create_connection(serve(controller).addresses[port], timeout=5.0) as client:
        client.sendall(b"stopj(2)\n")
        # Version, then states: more than a tenth of a second after the line.
        assert [read(client)[0] for _ in range(4)] == [20, 16, 16, 16]
    assert not controller.scripts


def test_numbers_that_are_none_do_not_stop_it() -> None:
    nonsense = {
        "actual_q": np.full(6, np.nan),
        "robot_mode": float("nan"),
        "joint_mode": np.full(6, -1),
        "robot_status_bits": 2.0**40,
        "actual_digital_input_bits": 2.0**63,
        "safety_mode": -5,
    }
    for series in ("1.6", "3.x", "5.x"):
        state = packages.robot_state(version(series), -3.0, nonsense, load_model("controller"))
        assert len(state) == struct.unpack_from(">I", state)[0]
