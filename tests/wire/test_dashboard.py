"""The dashboard's lines."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ur5_twin.wire.dashboard import command_of
from ur5_twin.wire.server import Server
from ur5_twin.wire.version import version

Serve = Callable[..., Server]


class Dashboard:
    def __init__(self, server: Server) -> None:
        self.socket = socket.create_connection(server.addresses["dashboard"], timeout=5.0)
        self.file = self.socket.makefile("r", encoding="utf-8", newline="\n")
        self.banner = self.file.readline()

    def ask(self, line: str) -> str:
        self.socket.sendall(line.encode() + b"\n")
        return self.file.readline().rstrip("\n")

    def close(self) -> None:
        self.file.close()
        self.socket.close()


@pytest.fixture
def dashboard(controller, serve: Serve) -> Iterator[Dashboard]:
    client = Dashboard(serve(controller))
    yield client
    client.close()


def test_the_banner_comes_first(dashboard: Dashboard) -> None:
    assert dashboard.banner == "Connected: Universal Robots Dashboard Server\n"


@pytest.mark.parametrize(
    ("line", "reply"),
    [
        ("robotmode", "Robotmode: RUNNING"),
        ("safetymode", "Safetymode: NORMAL"),
        ("safetystatus", "Safetystatus: NORMAL"),
        ("running", "Program running: true"),
        ("programState", "PLAYING swing.urp"),
        ("isProgramSaved", "true swing.urp"),
        ("get loaded program", "Loaded program: /programs/swing.urp"),
        ("PolyscopeVersion", "URSoftware 5.25.1.0 (virtual controller of ur5-twin)"),
        ("version", "5.25.1.0"),
        ("get robot model", "UR5"),
        ("is in remote control", "true"),
        ("power on", "Powering on"),
        ("power off", "Powering off"),
        ("brake release", "Brake releasing"),
        ("  brake   release \r", "Brake releasing"),
        ("play", "Starting program"),
        ("pause", "Pausing program"),
        ("stop", "Stopped"),
        ("load swing.urp", "Loading program: swing.urp"),
        ("load wave.urp", "File not found: wave.urp"),
        ("load installation default.installation", "Loading installation: default.installation"),
        ("close safety popup", "closing safety popup"),
        ("restart safety", "Restarting safety"),
        ("popup mind the arm", "showing popup"),
        ("close popup", "closing popup"),
        ("addToLog a word", "Added log message"),
        ("saveLog", "Log saved to disk"),
        ("get operational mode", "NONE"),
        ("set operational mode manual", "Operational mode MANUAL is set"),
        ("set operational mode sideways", "Failed setting operational mode: sideways"),
        ("clear operational mode", "No longer controlling the operational mode. Current operational mode: NONE."),
        ("make coffee", 'could not understand: "make coffee"'),
        ("robotmodes", 'could not understand: "robotmodes"'),
    ],
)
def test_replies(dashboard: Dashboard, line: str, reply: str) -> None:
    assert dashboard.ask(line) == reply


def test_a_serial_number_is_one(dashboard: Dashboard) -> None:
    assert dashboard.ask("get serial number").isdigit()


def test_what_is_asked_next_sees_what_was_done(dashboard: Dashboard) -> None:
    for _ in range(5):
        assert dashboard.ask("power off") == "Powering off"
        assert dashboard.ask("robotmode") == "Robotmode: POWER_OFF"
        assert dashboard.ask("play") == "Failed to execute: play"
        assert dashboard.ask("power on") == "Powering on"
        assert dashboard.ask("robotmode") == "Robotmode: IDLE"
        dashboard.ask("brake release")
        assert dashboard.ask("play") == "Starting program"
        assert dashboard.ask("running") == "Program running: true"
        assert dashboard.ask("stop") == "Stopped"
        assert dashboard.ask("programState") == "STOPPED swing.urp"


def test_the_operational_mode_is_the_controllers(controller, dashboard: Dashboard) -> None:
    dashboard.ask("set operational mode automatic")
    assert controller.operational_mode == dashboard.ask("get operational mode") == "AUTOMATIC"
    dashboard.ask("clear operational mode")
    assert controller.operational_mode == dashboard.ask("get operational mode") == "NONE"


def test_a_popup_is_a_message(controller, dashboard: Dashboard) -> None:
    dashboard.ask("popup mind the arm")
    assert [(said.kind, said.text) for said in controller.messages] == [("popup", "mind the arm")]


def test_what_the_controller_refuses(dashboard: Dashboard) -> None:
    assert dashboard.ask("unlock protective stop").startswith("Cannot unlock protective stop until 5s")


def test_commands_are_answered_in_turn(controller, dashboard: Dashboard) -> None:
    dashboard.socket.sendall(b"power off\nrobotmode\npower on\nrobotmode\n" * 100)
    replies = [dashboard.file.readline() for _ in range(400)]
    turn = ["Powering off\n", "Robotmode: POWER_OFF\n", "Powering on\n", "Robotmode: IDLE\n"]
    assert replies == turn * 100


def test_quit_ends_it(dashboard: Dashboard) -> None:
    assert dashboard.ask("quit") == "Disconnected"
    assert dashboard.file.readline() == ""


def test_a_line_without_an_end_is_cut_off(controller, serve: Serve) -> None:
    server = serve(controller)
    client, other = Dashboard(server), Dashboard(server)
    with contextlib.suppress(ConnectionError):
        client.socket.sendall(b"x" * 1_000_000)
    with contextlib.suppress(ConnectionError):
        assert client.file.readline() == ""
    assert other.ask("robotmode") == "Robotmode: RUNNING"
    client.close()
    other.close()


def test_who_asks_and_never_reads_is_read_no_further(controller, serve: Serve) -> None:
    server = serve(controller, realtime=False)
    deaf, other = Dashboard(server), Dashboard(server)
    deaf.socket.settimeout(0.5)
    # More answers than any buffer holds: at last the client cannot send on.
    with pytest.raises(TimeoutError):
        deaf.socket.sendall(b"nonsense\n" * 10_000_000)
    assert other.ask("robotmode") == "Robotmode: RUNNING"
    deaf.close()
    other.close()


def test_old_versions_know_less(swinging, serve: Serve) -> None:
    client = Dashboard(serve(swinging("1.8")))
    assert client.ask("running") == "Robot running: True"
    assert client.ask("power on") == 'could not understand: "power on"'
    assert client.ask("stop") == "Stopped"
    client.close()


@given(st.text(max_size=300))
def test_any_line_is_a_command_or_none(line: str) -> None:
    found = command_of(line, version("5.x"))
    assert found is None or " ".join(line.split()).startswith(found[0])
