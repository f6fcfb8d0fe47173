"""RTDE as a client sees it, byte by byte."""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ur5_twin.errors import WireError
from ur5_twin.wire.rtde import InputRecipe, OutputRecipe
from ur5_twin.wire.rtde_signals import DOUBLE, INPUTS, INT32, OUTPUTS, UINT8, VECTOR6D, output_type
from ur5_twin.wire.server import Server

Serve = Callable[..., Server]


class Rtde:
    """A client that knows the protocol's frames and nothing else."""

    def __init__(self, server: Server, protocol: int = 2) -> None:
        self.socket = socket.create_connection(server.addresses["rtde"], timeout=5.0)
        self.buffer = b""
        assert self.ask("V", struct.pack(">H", protocol)) == b"\x01"

    def __enter__(self) -> Rtde:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, kind: str, payload: bytes = b"") -> None:
        self.socket.sendall(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)

    def read(self) -> tuple[str, bytes]:
        while len(self.buffer) < 3 or len(self.buffer) < struct.unpack(">H", self.buffer[:2])[0]:
            data = self.socket.recv(65536)
            if not data:
                raise ConnectionError("closed")
            self.buffer += data
        size, kind = struct.unpack(">HB", self.buffer[:3])
        payload, self.buffer = self.buffer[3:size], self.buffer[size:]
        return chr(kind), payload

    def ask(self, kind: str, payload: bytes = b"") -> bytes:
        self.send(kind, payload)
        while True:
            got, answer = self.read()
            if got == kind:
                return answer

    def outputs(self, names: str, frequency: float = 0.0) -> bytes:
        return self.ask("O", struct.pack(">d", frequency) + names.encode())


def eventually(condition: Callable[[], object]) -> None:
    """Wait until something is so; how long it takes is not the matter."""
    for _ in range(6000):
        if condition():
            return
        time.sleep(0.005)
    raise AssertionError("it never came to be")


def test_version_2_streams_what_the_controller_publishes(controller, serve: Serve) -> None:
    with Rtde(serve(controller)) as client:
        assert struct.unpack(">4I", client.ask("v")) == (5, 25, 1, 0)
        assert client.outputs("timestamp,actual_q,joint_mode,output_int_register_3") == (
            b"\x01DOUBLE,VECTOR6D,VECTOR6INT32,INT32"
        )
        assert client.ask("S") == b"\x01"
        last = None
        for _ in range(20):
            kind, payload = client.read()
            assert kind == "U"
            number, stamp, *rest = struct.unpack(">Bd6d6ii", payload)
            assert number == 1
            np.testing.assert_array_equal(rest[:6], np.sin(np.arange(6) + stamp))
            assert rest[6:] == [253] * 6 + [-7]
            if last is not None:
                # Every tick, none left out.
                assert stamp - last == pytest.approx(0.002)
            last = stamp
        assert client.ask("P") == b"\x01"


def test_a_list_of_names_may_end_with_a_comma(controller, serve: Serve) -> None:
    with Rtde(serve(controller)) as client:
        # As ur_rtde does it.
        assert client.outputs("timestamp,actual_q,") == b"\x01DOUBLE,VECTOR6D"
        assert client.outputs("timestamp,,actual_q") == b"\x00DOUBLE,NOT_FOUND,VECTOR6D"


def test_version_1_has_one_recipe_and_no_number(controller, serve: Serve) -> None:
    with Rtde(serve(controller), protocol=1) as client:
        assert client.ask("O", b"actual_q") == b"VECTOR6D"
        assert client.ask("O", b"timestamp") == b"DOUBLE"
        assert client.ask("S") == b"\x01"
        kind, payload = client.read()
        assert kind == "U"
        assert struct.unpack(">d", payload)[0] > 100.0


def test_two_recipes_each_at_its_frequency(controller, serve: Serve) -> None:
    with Rtde(serve(controller)) as client:
        assert client.outputs("timestamp", 500.0)[:1] == b"\x01"
        assert client.outputs("timestamp", 125.0)[:1] == b"\x02"
        client.ask("S")
        counts = {1: 0, 2: 0}
        for _ in range(100):
            counts[client.read()[1][0]] += 1
    assert counts[1] == pytest.approx(4 * counts[2], abs=4)


@pytest.mark.parametrize(
    ("frequency", "expected"),
    [(125.0, 125), (100.0, 100), (10.0, 10), (62.5, 62), (0.0, 125), (-3.0, 125), (1e9, 125), (float("nan"), 125)],
)
def test_packages_go_out_as_often_as_asked(frequency: float, expected: int) -> None:
    recipe = OutputRecipe(1, [("timestamp", DOUBLE)], frequency, 125.0)
    assert sum(recipe.due(tick) for tick in range(1, 126)) == expected


def test_what_the_cell_does_not_know_is_zero_of_its_type(controller, serve: Serve) -> None:
    with Rtde(serve(controller)) as client:
        assert client.outputs("tool_temperature,elbow_position,io_current,tool_mode") == (
            b"\x01DOUBLE,VECTOR3D,DOUBLE,UINT32"
        )
        client.ask("S")
        assert client.read() == ("U", b"\x01" + bytes(8 + 24 + 8 + 4))


def test_unknown_names_are_not_found_and_the_recipe_is_none(controller, serve: Serve) -> None:
    with Rtde(serve(controller)) as client:
        assert client.outputs("timestamp,actual_qqq") == b"\x00DOUBLE,NOT_FOUND"
        assert client.ask("S") == b"\x00"
        assert client.ask("I", b"input_int_register_3,speed_of_light") == b"\x00INT32,NOT_FOUND"
        # The good one's owner is nobody.
        assert client.ask("I", b"input_int_register_3") == b"\x01INT32"


def test_an_input_belongs_to_the_first_until_it_leaves(controller, serve: Serve) -> None:
    server = serve(controller)
    with Rtde(server) as second:
        with Rtde(server) as first:
            assert first.ask("I", b"input_int_register_24,input_double_register_3") == b"\x01INT32,DOUBLE"
            # One client may have it in several recipes.
            assert first.ask("I", b"input_int_register_24") == b"\x02INT32"
            assert second.ask("I", b"input_int_register_25,input_int_register_24") == b"\x00INT32,IN_USE"
        eventually(lambda: second.ask("I", b"input_int_register_24")[1:] == b"INT32")


def test_inputs_reach_the_controller_in_order(controller, serve: Serve) -> None:
    with Rtde(serve(controller)) as client:
        client.ask("I", b"standard_digital_output,standard_digital_output_mask,input_double_register_3")
        client.ask("I", b"input_int_register_24,external_force_torque")
        client.send("U", struct.pack(">BBBd", 1, 5, 7, 0.25))
        client.send("U", struct.pack(">Bi6d", 2, -3, *range(6)))
        eventually(lambda: len(controller.written) == 5)
    names = [name for name, _ in controller.written]
    assert names[0] == "standard_digital_output_mask"
    assert dict(controller.written[:4]) == {
        "standard_digital_output_mask": 7,
        "standard_digital_output": 5,
        "input_double_register_3": 0.25,
        "input_int_register_24": -3,
    }
    np.testing.assert_array_equal(controller.written[4][1], np.arange(6.0))


def test_a_tick_that_comes_while_inputs_are_posted_loses_none(controller, serve: Serve, monkeypatch) -> None:
    post = controller.post

    def post_and_tick(action: Callable[[], object]) -> object:
        future = post(action)
        # As if the tick thread got the interpreter just before post returns.
        with contextlib.suppress(TimeoutError):
            future.exception(timeout=5.0)
        return future

    monkeypatch.setattr(controller, "post", post_and_tick)
    with Rtde(serve(controller)) as client:
        client.ask("I", b"input_int_register_24")
        for value in range(3):
            client.send("U", struct.pack(">Bi", 1, value))
            eventually(lambda value=value: len(controller.written) == value + 1)
    assert [value for _, value in controller.written] == [0, 1, 2]


def test_inputs_go_on_after_the_controller_had_too_much_to_do(controller, serve: Serve, monkeypatch) -> None:
    post = controller.post

    def busy(action: Callable[[], object]) -> object:
        raise WireError("too many actions wait")

    with Rtde(serve(controller)) as client:
        client.ask("I", b"input_int_register_24")
        monkeypatch.setattr(controller, "post", busy)
        client.send("U", struct.pack(">Bi", 1, 1))
        assert b"too many actions wait" in client.read()[1]
        monkeypatch.setattr(controller, "post", post)
        client.send("U", struct.pack(">Bi", 1, 2))
        eventually(lambda: controller.written)
    assert controller.written == [("input_int_register_24", 2)]


def test_short_and_long_input_packages(controller, serve: Serve) -> None:
    with Rtde(serve(controller)) as client:
        client.ask("I", b"input_int_register_0,external_force_torque")
        # ur_rtde's setExternalForceTorque is four bytes short.
        client.send("U", struct.pack(">Bi6d", 1, 1, *range(6))[:-4])
        client.send("U", struct.pack(">Bi6d", 1, 2, *range(6)) + b"more than asked for")
        client.send("U")
        client.send("U", b"\x09")
        eventually(lambda: len(controller.written) == 3)
        assert client.read()[0] == "M"
    assert [name for name, _ in controller.written] == [
        "input_int_register_0",
        "input_int_register_0",
        "external_force_torque",
    ]


def test_half_sent_and_joined_packages(controller, serve: Serve) -> None:
    with Rtde(serve(controller)) as client:
        for byte in struct.pack(">HB", 3, ord("v")):
            client.socket.sendall(bytes([byte]))
        assert client.read() == ("v", struct.pack(">4I", 5, 25, 1, 0))
        client.socket.sendall(struct.pack(">HB", 3, ord("v")) * 3)
        assert [client.read()[0] for _ in range(3)] == ["v"] * 3


def test_a_header_that_cannot_be_ends_the_connection_and_nothing_else(controller, serve: Serve) -> None:
    server = serve(controller)
    with Rtde(server) as good, Rtde(server) as bad:
        bad.socket.sendall(struct.pack(">HB", 1, ord("V")))
        bad.send("v")
        with pytest.raises(ConnectionError):
            bad.read()
        assert good.ask("v")
    assert server.statistics.clients_cut == 1


def test_unknown_types_get_a_text_message(controller, serve: Serve) -> None:
    with Rtde(serve(controller)) as client:
        client.send("?", b"what")
        kind, payload = client.read()
        assert kind == "M"
        assert b"63" in payload[1 : 1 + payload[0]]
        assert client.ask("v")


def text_of(payload: bytes) -> tuple[str, str, int]:
    """Text, source and level of a message of version 2."""
    words, rest = payload[1 : 1 + payload[0]], payload[1 + payload[0] :]
    assert len(rest) == rest[0] + 2
    return words.decode(), rest[1:-1].decode(), rest[-1]


def test_what_programs_say_goes_to_all_who_listen(controller, serve: Serve) -> None:
    controller.say("text", "before anybody listened")
    server = serve(controller)
    with Rtde(server) as client, Rtde(server, protocol=1) as old, Rtde(server) as silent:
        client.outputs("timestamp", 10.0)
        client.ask("S")
        old.ask("O", b"timestamp")
        old.ask("S")
        for kind, text in (("text", "hällo"), ("popup", "mind the arm"), ("error", "é" * 200)):
            controller.say(kind, text)

        def texts(one: Rtde) -> list[bytes]:
            found = []
            while len(found) < 3:
                kind, payload = one.read()
                found += [payload] if kind == "M" else []
            return found

        assert [text_of(payload) for payload in texts(client)] == [
            ("hällo", "URControl", 3),
            ("mind the arm", "URControl", 2),
            ("é" * 127, "URControl", 1),
        ]
        assert texts(old)[0] == b"\x03" + "hällo".encode()
        # Who only sets up its recipes hears answers and nothing else.
        silent.send("v")
        assert silent.read()[0] == "v"


def test_texts_do_not_cut_off_a_client_that_only_writes(controller, serve: Serve) -> None:
    server = serve(controller)
    with Rtde(server) as client:
        client.ask("I", b"input_int_register_24")
        client.ask("S")
        for _ in range(40):
            for _ in range(100):
                controller.say("text", "x" * 255)
            ticks = server.statistics.ticks
            eventually(lambda ticks=ticks: server.statistics.ticks > ticks + 2)
        client.send("U", struct.pack(">Bi", 1, 7))
        eventually(lambda: controller.written)
        # A megabyte was said; what waits for the client in this process is a text at most.
        port = next(port for port in server._ports if port.name == "rtde")
        assert max(one.unsent for one in port.clients) < 300
    assert server.statistics.clients_cut == 0


def test_a_client_that_does_not_read_costs_the_others_nothing(controller, serve: Serve) -> None:
    server = serve(controller, realtime=False)
    with Rtde(server) as deaf, Rtde(server) as reader:
        everything = ",".join(name for name in OUTPUTS if output_type(name, controller.version) is not None)
        assert deaf.outputs(everything)[:1] == b"\x01"
        deaf.ask("S")
        reader.outputs("timestamp")
        reader.ask("S")
        last = 0.0
        # Until its packages are dropped, and on.
        while server.statistics.packages_dropped < 100:
            stamp = struct.unpack(">Bd", reader.read()[1])[1]
            assert stamp > last
            last = stamp
        # What did arrive, or still lies in the buffers, is whole packages.
        deaf.socket.settimeout(1.0)
        for _ in range(100):
            kind, payload = deaf.read()
            assert kind == "U"
            assert len(payload) > 2000


def test_versions_differ_in_what_they_have(swinging, serve: Serve) -> None:
    with Rtde(serve(swinging("3.4"))) as client:
        assert client.outputs("payload,timestamp") == b"\x00NOT_FOUND,DOUBLE"
    with Rtde(serve(swinging("3.15.8"))) as client:
        assert client.outputs("payload,ft_raw_wrench") == b"\x00DOUBLE,NOT_FOUND"


@pytest.mark.parametrize(
    ("series", "low", "high"),
    [("3.3", False, False), ("3.4", True, False), ("3.9", True, True), ("5.2", True, False), ("5.3", True, True)],
)
def test_versions_differ_in_what_may_be_written(swinging, serve: Serve, series: str, low: bool, high: bool) -> None:
    always = "speed_slider_mask,standard_digital_output,external_force_torque,input_bit_registers0_to_31"
    halves = [
        ("input_int_register_0,input_int_register_23,input_double_register_0", low),
        ("input_int_register_24,input_double_register_47,input_bit_register_64,input_bit_register_127", high),
    ]
    with Rtde(serve(swinging(series))) as client:
        assert client.ask("I", always.encode())[1:] == b"UINT32,UINT8,VECTOR6D,UINT32"
        for names, there in halves:
            for name in names.split(","):
                assert (client.ask("I", name.encode()) == b"\x00NOT_FOUND") is not there, name
                # What is written is published too.
                assert (client.outputs(name) == b"\x00NOT_FOUND") is not there, name


def test_values_that_a_type_cannot_hold_become_the_nearest() -> None:
    fields = [("a", INT32), ("b", UINT8), ("c", VECTOR6D), ("d", INT32)]
    recipe = OutputRecipe(None, fields, 125.0, 125.0)
    package = recipe.package({"a": 1e12, "b": -4, "c": np.arange(3.0), "d": float("nan")})
    assert struct.unpack(">HBiB6di", package)[2:] == (2**31 - 1, 0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 0)


@given(st.lists(st.sampled_from(sorted(INPUTS)), min_size=1, max_size=20, unique=True), st.binary(max_size=300))
def test_any_bytes_are_read_as_input(names: list[str], data: bytes) -> None:
    found = InputRecipe([(name, INPUTS[name]) for name in names]).values(data)
    assert {name for name, _ in found} <= set(names)
