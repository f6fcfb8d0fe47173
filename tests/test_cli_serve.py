"""``ur5-twin serve`` as a user runs it."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest

from ur5_twin.terminal import serve_words
from ur5_twin.wire import realtime_layout
from ur5_twin.wire.server import Statistics

Run = Callable[..., tuple[int, str, str]]


def started(*arguments: str) -> tuple[subprocess.Popen[str], dict[str, int]]:
    """A server in a process of its own, and its ports by name."""
    process = subprocess.Popen(
        [sys.executable, "-m", "ur5_twin.cli", "serve", "--free-ports", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    ports: dict[str, int] = {}
    assert process.stdout is not None
    for line in process.stdout:
        found = re.match(r"  (\w+) +127\.0\.0\.1:(\d+)", line)
        if found:
            ports[found[1]] = int(found[2])
        if line.startswith("Ctrl-C"):
            break
    return process, ports


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_robot_until_it_is_stopped(number: signal.Signals) -> None:
    process, ports = started("free_motion", "--version", "1.6", "--late-packages")
    try:
        # A robot of that age has no RTDE.
        robot = ["dashboard", "primary", "realtime", "secondary"]
        robot += [f"{name}_readonly" for name in robot[1:]]
        # Its tool carries the force sensor.
        assert sorted(ports) == sorted([*robot, "net_ft"])
        with socket.create_connection(("127.0.0.1", ports["realtime"]), timeout=10.0) as client:
            data = b""
            while len(data) < 756:
                data += client.recv(756 - len(data))
            assert np.abs(np.asarray(realtime_layout.decode(data)["actual_q"])).max() > 0.1
            process.send_signal(number)
            out, _ = process.communicate(timeout=10.0)
        assert process.returncode == 0
        assert re.search(r"\d+ ticks, \d+ of them late", out)
    finally:
        process.kill()


def test_an_idle_robot_plays_when_it_is_told_to() -> None:
    process, ports = started("free_motion", "--idle")
    try:
        with socket.create_connection(("127.0.0.1", ports["dashboard"]), timeout=10.0) as client:
            lines = client.makefile("r", newline="\n")
            replies = [lines.readline()]
            for command in ("programState", "play", "programState"):
                client.sendall(f"{command}\n".encode())
                replies.append(lines.readline())
            lines.close()
        assert replies[1:] == ["STOPPED free_motion.urp\n", "Starting program\n", "PLAYING free_motion.urp\n"]
    finally:
        process.kill()
        process.communicate()


def test_as_long_as_asked(run: Run) -> None:
    code, out, _ = run("serve", "--free-ports", "--version", "5.x", "--fast", "--duration", "0.4")
    assert code == 0
    ticks = re.search(r"(\d+) ticks", out)
    assert ticks is not None
    assert int(ticks[1]) >= 200


def test_nothing_named_is_an_arm_alone(run: Run) -> None:
    code, out, _ = run("serve", "--free-ports", "--duration", "0.1")
    assert code == 0
    assert out.startswith("An arm alone: a UR5 with software 3.15.8, 125 Hz, in real time")


def test_elsewhere_than_at_home_is_warned_of(run: Run) -> None:
    code, _, err = run("serve", "--free-ports", "--duration", "0", "--bind", "0.0.0.0")
    assert code == 0
    assert "warning: whoever reaches 0.0.0.0" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--version", "2.0"), "there is no version 2.0"),
        (("--ports", "rtde"), "'rtde' is not NAME=NUMBER"),
        (("--ports", "rtde=-1"), "'rtde=-1' is not NAME=NUMBER"),
        (("--ports", "rdte=1"), "did you mean 'rtde'"),
        (("--ports", "rtde=99999"), "between 0 (a free one) and 65535"),
        (("--bind", "192.0.2.1", "--free-ports"), "is no address of this machine"),
        (("no_such_scenario",), "no_such_scenario"),
    ],
)
def test_what_cannot_be_is_said_in_a_line(run: Run, arguments: tuple[str, ...], message: str) -> None:
    code, _, err = run("serve", *arguments)
    assert code == 2
    assert message in err
    assert len(err.splitlines()) == 1


def test_a_port_in_use(run: Run) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        code, _, err = run("serve", "--free-ports", "--ports", f"rtde={number}")
    assert code == 2
    assert f"127.0.0.1:{number} (rtde) is in use" in err


def test_a_sensors_port_in_use(run: Run) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        number = taken.getsockname()[1]
        code, _, err = run("serve", "free_motion", "--free-ports", "--ports", f"net_ft={number}")
    assert code == 2
    assert f"127.0.0.1:{number} (net_ft) is in use" in err
    assert "--ports net_ft=0,net_ft_page=0" in err


def test_a_terminal_is_told_how_it_goes() -> None:
    master, slave = os.openpty()
    command = [sys.executable, "-m", "ur5_twin.cli", "serve", "--free-ports"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=slave, env=os.environ | {"COLUMNS": "200"}
    ) as process:
        os.close(slave)
        try:
            shown = b""
            while b"ticks/s" not in shown:
                shown += os.read(master, 4096)
            process.send_signal(signal.SIGINT)
            # Whoever leaves a terminal unread is stopped by it.
            with contextlib.suppress(OSError):
                while os.read(master, 4096):
                    pass
            out, _ = process.communicate(timeout=10.0)
        finally:
            process.kill()
            os.close(master)
    assert re.search(rb"program stopped, \d+ ticks/s, behind \d+, clients: none", shown)
    assert b"ticks/s" not in out


def test_who_is_no_terminal_is_not(run: Run) -> None:
    code, out, err = run("serve", "--free-ports", "--duration", "2.5")
    assert code == 0
    assert err == ""
    assert "ticks/s" not in out


def test_what_a_status_line_says() -> None:
    clients = {"dashboard": 0, "rtde": 2, "net_ft": 1}
    found = Statistics(100, 3, 1, np.zeros(0), 0.5, 4, 0, clients)
    assert serve_words(found, 124.9, "playing") == (
        "playing, 125 ticks/s, behind 3, packages left out 5, clients: rtde 2 net_ft 1"
    )
