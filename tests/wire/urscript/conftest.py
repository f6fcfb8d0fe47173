"""Running small programs, and the program that a real client uploads."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator, Mapping
from typing import Any

import pytest

from ur5_twin.wire.urscript import Interpreter, library, parse, shown


def _sync() -> Generator[None, None, None]:
    yield


class Ran:
    """A program that was run for some ticks, and what it printed."""

    def __init__(self, text: str, built_ins: Mapping[str, Callable[..., Any]] | None = None) -> None:
        self.printed: list[str] = []
        self.interpreter = Interpreter(
            parse(text), {**library(), "textmsg": self.textmsg, "sync": _sync, **(built_ins or {})}
        )

    def textmsg(self, s1: Any, s2: Any = "") -> None:
        self.printed.append(shown(s1) + shown(s2))

    def steps(self, ticks: int) -> Ran:
        for _ in range(ticks):
            self.interpreter.step()
        return self


@pytest.fixture
def start() -> type[Ran]:
    """Start a program; it runs with ``steps``."""
    return Ran


@pytest.fixture
def run() -> Callable[..., list[str]]:
    """Run a program to its end and get what it printed; an error in it is raised."""

    def run(text: str, built_ins: Mapping[str, Callable[..., Any]] | None = None) -> list[str]:
        ran = Ran(text, built_ins).steps(1000)
        assert not ran.interpreter.running, f"still running in line {ran.interpreter.line}"
        if ran.interpreter.error is not None:
            raise ran.interpreter.error
        return ran.printed

    return run


@pytest.fixture
def value(run: Callable[..., list[str]]) -> Callable[[str], Any]:
    """The value of an expression."""

    def value(expression: str) -> Any:
        found: list[Any] = []
        run(f"keep({expression}\n)", {"keep": found.append})
        return found[0]

    return value


def _uploaded() -> str:
    """What ur_rtde's control interface sends to port 30003: from a process that is ended once it has."""
    address = f"127.{os.getpid() % 200 + 20}.{os.getpid() // 200 % 250}.{time.time_ns() % 250 + 1}"
    script = bytearray()
    received = threading.Event()
    sockets: list[socket.socket] = []

    def serve(port: int, client: Callable[[socket.socket], None]) -> None:
        server = socket.create_server((address, port))
        sockets.append(server)

        def accept() -> None:
            with contextlib.suppress(OSError):
                while True:
                    connection, _ = server.accept()
                    sockets.append(connection)
                    threading.Thread(target=talk, args=(connection,), daemon=True).start()

        def talk(connection: socket.socket) -> None:
            with contextlib.suppress(OSError, EOFError):
                client(connection)

        threading.Thread(target=accept, daemon=True).start()

    serve(29999, _dashboard)
    serve(30004, _rtde)

    def upload(connection: socket.socket) -> None:
        while data := connection.recv(65536):
            script.extend(data)
            connection.settimeout(0.3)  # it sends the program in one go and keeps the connection
            if script.endswith(b"end\n"):
                received.set()

    serve(30003, upload)
    code = f"import rtde_control; rtde_control.RTDEControlInterface({address!r})"
    client = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        done = received.wait(timeout=20.0)
    finally:
        client.kill()
        output = client.communicate()[0]
        for each in sockets:
            each.close()
    assert done, f"ur_rtde sent no program: {output}"
    return script.decode()


def _dashboard(connection: socket.socket) -> None:
    answers = {b"PolyscopeVersion": "URSoftware 5.25.1.0", b"get serial number": "20195500001", b"stop": "Stopped"}
    connection.sendall(b"Connected: Universal Robots Dashboard Server\n")
    while request := connection.recv(1000):
        connection.sendall(answers.get(request.strip(), "true").encode() + b"\n")


def _rtde(connection: socket.socket) -> None:
    stream = connection.makefile("rb")
    recipes = 0

    def send(kind: str, payload: bytes) -> None:
        connection.sendall(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)

    def data(names: list[str]) -> None:
        with contextlib.suppress(OSError):
            for tick in range(5000):
                values = (
                    struct.pack(">d", 100.0 + tick * 0.002)
                    if _type(name) == "DOUBLE"
                    else struct.pack(">I", int("status" in name or "state" in name))
                    for name in names
                )
                send("U", b"\x01" + b"".join(values))
                time.sleep(0.002)

    names: list[str] = []
    while header := stream.read(3):
        size, kind = struct.unpack(">HB", header)
        payload = stream.read(size - 3)
        if kind == ord("V"):
            send("V", b"\x01")
        elif kind == ord("v"):
            send("v", struct.pack(">4I", 5, 25, 1, 0))
        elif kind == ord("O"):
            names = [name for name in payload[8:].decode().split(",") if name]
            send("O", b"\x01" + ",".join(map(_type, names)).encode())
        elif kind == ord("I"):
            recipes += 1
            send("I", bytes([recipes]) + ",".join(map(_type, payload.decode().split(","))).encode())
        elif kind == ord("S"):
            send("S", b"\x01")
            threading.Thread(target=data, args=(names,), daemon=True).start()


def _type(name: str) -> str:
    if "int_register" in name:
        return "INT32"
    if name == "external_force_torque":
        return "VECTOR6D"
    return "DOUBLE" if "double_register" in name or name in ("timestamp", "speed_slider_fraction") else "UINT32"


@pytest.fixture(scope="session")
def client_program() -> str:
    """The program that ur_rtde uploads to a robot with PolyScope 5.25, got from the library itself."""
    pytest.importorskip("rtde_control", reason="the program comes from ur_rtde: pip install 'ur5-twin[live]'")
    return _uploaded()
