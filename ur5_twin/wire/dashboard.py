"""Port 29999: the dashboard, a line in and a line out."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from ur5_twin.errors import WireError
from ur5_twin.wire.state import State
from ur5_twin.wire.streams import Client, Lines, TcpPort
from ur5_twin.wire.version import Version

if TYPE_CHECKING:
    from ur5_twin.wire.controller import VirtualController

log = logging.getLogger(__name__)

_LONGEST_LINE = 4096
#: Commands of one client that wait for their turn; while there are more, nothing is read from it.
_MOST_WAITING = 64
#: A tick comes out within this, s, unless the simulation has ended.
_PUBLISHED = 1.0

ROBOT_MODES = {
    -1: "NO_CONTROLLER",
    0: "DISCONNECTED",
    1: "CONFIRM_SAFETY",
    2: "BOOTING",
    3: "POWER_OFF",
    4: "POWER_ON",
    5: "IDLE",
    6: "BACKDRIVE",
    7: "RUNNING",
    8: "UPDATING_FIRMWARE",
}
#: Safety modes, and from 10 on what only the safety status knows.
SAFETY = {
    1: "NORMAL",
    2: "REDUCED",
    3: "PROTECTIVE_STOP",
    4: "RECOVERY",
    5: "SAFEGUARD_STOP",
    6: "SYSTEM_EMERGENCY_STOP",
    7: "ROBOT_EMERGENCY_STOP",
    8: "VIOLATION",
    9: "FAULT",
    10: "VALIDATE_JOINT_ID",
    11: "UNDEFINED_SAFETY_MODE",
    12: "AUTOMATIC_MODE_SAFEGUARD_STOP",
    13: "SYSTEM_THREE_POSITION_ENABLING_STOP",
}
_PROGRAM_STATES = {0: "STOPPED", 1: "STOPPED", 2: "PLAYING", 3: "PAUSED", 4: "PAUSED", 5: "PLAYING"}
#: What a robot of this kind calls itself. Clients take the number apart: the year comes first.
SERIAL_NUMBER = "20143500001"
ROBOT_MODEL = "UR5"

#: The first version with a command, of the CB series and of the e-Series; None: that series has not got it.
_Since = tuple[tuple[int, int] | None, tuple[int, int] | None]
_SINCE: dict[str, _Since] = {
    "load": ((1, 4), (5, 0)),
    "play": ((1, 4), (5, 0)),
    "stop": ((1, 4), (5, 0)),
    "pause": ((1, 4), (5, 0)),
    "quit": ((1, 4), (5, 0)),
    "shutdown": ((1, 4), (5, 0)),
    "running": ((1, 6), (5, 0)),
    "robotmode": ((1, 6), (5, 0)),
    "get loaded program": ((1, 6), (5, 0)),
    "popup": ((1, 6), (5, 0)),
    "close popup": ((1, 6), (5, 0)),
    "addToLog": ((1, 8), (5, 0)),
    "saveLog": ((1, 8), (5, 0)),
    "isProgramSaved": ((1, 8), (5, 0)),
    "programState": ((1, 8), (5, 0)),
    "PolyscopeVersion": ((1, 8), (5, 0)),
    "version": (None, (5, 0)),
    "power on": ((3, 0), (5, 0)),
    "power off": ((3, 0), (5, 0)),
    "brake release": ((3, 0), (5, 0)),
    "safetymode": ((3, 0), (5, 0)),
    "safetystatus": ((3, 11), (5, 4)),
    "unlock protective stop": ((3, 1), (5, 0)),
    "close safety popup": ((3, 1), (5, 0)),
    "load installation": ((3, 2), (5, 0)),
    "restart safety": ((3, 7), (5, 1)),
    "setUserRole": ((3, 1), None),
    "getUserRole": ((3, 1), None),
    "set operational mode": (None, (5, 0)),
    "get operational mode": (None, (5, 6)),
    "clear operational mode": (None, (5, 0)),
    "is in remote control": (None, (5, 6)),
    "get serial number": ((3, 12), (5, 6)),
    "get robot model": ((3, 12), (5, 6)),
}
#: Commands that are followed by what they are about.
_WITH_ARGUMENT = {"load", "load installation", "popup", "addToLog", "setUserRole", "set operational mode"}


def command_of(line: str, version: Version) -> tuple[str, str] | None:
    """The command in a line and what it is about; None if that version has no such command."""
    words = " ".join(line.split())
    # The longest first: "load installation" is not "load" of a program called "installation".
    for name in sorted(_SINCE, key=len, reverse=True):
        since = _SINCE[name][version.major >= 5]
        if since is None or (version.major, version.minor) < since:
            continue
        if words == name or (name in _WITH_ARGUMENT and words.startswith(f"{name} ")):
            return name, words[len(name) :].strip()
    return None


class DashboardClient(Client):
    """One client: its commands are carried out one after the other."""

    port: DashboardPort

    def __init__(self, port: DashboardPort) -> None:
        super().__init__(port)
        self._lines = Lines(_LONGEST_LINE)
        self._waiting: deque[str] = deque()
        self._task: asyncio.Task[None] | None = None

    def opened(self) -> None:
        self.say("Connected: Universal Robots Dashboard Server")

    def say(self, line: str) -> None:
        """Send a line."""
        self.reply(line.encode("utf-8", "replace") + b"\n")

    def received(self, data: bytes) -> None:
        self._waiting.extend(line.decode("utf-8", "replace") for line in self._lines.feed(data))
        if len(self._waiting) > _MOST_WAITING:
            self.hold_reading(True)
        if self._waiting and self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._answer())

    def ended(self, *, by_client: bool) -> None:
        if self._task is not None:
            self._task.cancel()

    async def _answer(self) -> None:
        try:
            while self._waiting and self.connected:
                line = self._waiting.popleft().strip()
                if line:
                    self.say(await self.port.answer(line))
                    if command_of(line, self.port.controller.version) == ("quit", ""):
                        self.finish()
                if len(self._waiting) == _MOST_WAITING:
                    self.hold_reading(False)
        finally:
            self._task = None


class DashboardPort(TcpPort[DashboardClient]):
    """The dashboard: power, brakes, programs, safety."""

    name = "dashboard"
    reads_while_full = False

    def __init__(self, controller: VirtualController, bind: str = "127.0.0.1", number: int = 29999) -> None:
        super().__init__(controller, bind, number)
        self._role = "PROGRAMMER"
        #: The only program there is: the scenario's own motion.
        self.program = f"/programs/{controller.scenario.name}.urp"
        self._published: asyncio.Future[None] | None = None

    def publish(self, state: State) -> None:
        super().publish(state)
        if self._published is not None:
            self._published.set_result(None)
            self._published = None

    def new_client(self) -> DashboardClient:
        return DashboardClient(self)

    async def answer(self, line: str) -> str:
        """Carry a command out and say what a robot would."""
        found = command_of(line, self.controller.version)
        if found is None:
            return f'could not understand: "{line[:200]}"'
        name, about = found
        try:
            return await self._do(name, about)
        except WireError as error:
            log.info("dashboard: %s: %s", line, error)
            return _FAILURES.get(name, f"Failed to execute: {name}").format(about=about)

    async def _do(self, name: str, about: str) -> str:
        robot = self.controller
        act = self._act
        match name:
            case "play":
                return await act(robot.play, "Starting program")
            case "stop":
                return await act(robot.stop, "Stopped")
            case "pause":
                return await act(robot.pause, "Pausing program")
            case "power on":
                return await act(robot.power_on, "Powering on")
            case "power off":
                return await act(robot.power_off, "Powering off")
            case "brake release":
                return await act(robot.brake_release, "Brake releasing")
            case "unlock protective stop":
                return await act(robot.unlock_protective_stop, "Protective stop releasing")
            case "popup":
                return await act(lambda: robot.say("popup", about), "showing popup")
            case "close popup":
                return await act(robot.close_popup, "closing popup")
            case "close safety popup":
                return await act(robot.close_popup, "closing safety popup")
            case "restart safety":
                return await act(robot.restart_safety, "Restarting safety")
            case "load":
                if about not in (self.program, PurePosixPath(self.program).name):
                    raise WireError(f"there is no program but {self.program}")
                return f"Loading program: {about}"
            case "shutdown":
                # The arm loses its power as with a robot; the ports are the operator's to close.
                return await act(robot.power_off, "Shutting down")
            case "set operational mode" if about.upper() not in ("MANUAL", "AUTOMATIC"):
                return f"Failed setting operational mode: {about}"
            case "set operational mode":
                return await act(lambda: self._set_mode(about.upper()), f"Operational mode {about.upper()} is set")
            case "clear operational mode":
                said = "No longer controlling the operational mode. Current operational mode: NONE."
                return await act(lambda: self._set_mode("NONE"), said)
            case "setUserRole":
                self._role = about.upper() or self._role
                return f"Setting user role: {about}"
        return self._tell(name, about)

    def _tell(self, name: str, about: str) -> str:
        """Answers that need nothing but the newest state."""
        version = self.controller.version
        program = PurePosixPath(self.program).name
        state = _PROGRAM_STATES.get(self._signal("runtime_state"), "STOPPED")
        answers: dict[str, Callable[[], str]] = {
            "running": lambda: (
                f"Program running: {str(state == 'PLAYING').lower()}"
                if version.major >= 3
                else f"Robot running: {state == 'PLAYING'}"
            ),
            "robotmode": lambda: f"Robotmode: {ROBOT_MODES.get(self._signal('robot_mode'), 'NO_CONTROLLER')}",
            "safetymode": lambda: f"Safetymode: {SAFETY.get(self._signal('safety_mode'), SAFETY[11])}",
            "safetystatus": lambda: f"Safetystatus: {SAFETY.get(self._signal('safety_status'), SAFETY[11])}",
            "get loaded program": lambda: f"Loaded program: {self.program}",
            "isProgramSaved": lambda: f"true {program}",
            "programState": lambda: f"{state} {program}",
            "PolyscopeVersion": lambda: f"URSoftware {version}.{version.build} (virtual controller of ur5-twin)",
            "version": lambda: f"{version}.{version.build}",
            "addToLog": lambda: "Added log message",
            "saveLog": lambda: "Log saved to disk",
            "load installation": lambda: f"Loading installation: {about}",
            "getUserRole": lambda: self._role,
            "get operational mode": lambda: self.controller.operational_mode,
            "is in remote control": lambda: "true",
            "get serial number": lambda: SERIAL_NUMBER,
            "get robot model": lambda: ROBOT_MODEL,
            "quit": lambda: "Disconnected",
        }
        if name == "addToLog":
            log.info("dashboard: %s: %s", name, about)
        return answers[name]()

    async def _act(self, action: Callable[[], str | None], done: str) -> str:
        """Have the controller do something; what it has to say of it, or else ``done``, is the answer."""
        said = await self.ask(action)
        # What is asked next is to see what this has done.
        published = self._published = self._published or asyncio.get_running_loop().create_future()
        await asyncio.wait([published], timeout=_PUBLISHED)
        return said or done

    def _set_mode(self, mode: str) -> None:
        self.controller.operational_mode = mode

    def _signal(self, name: str) -> int:
        value = self.state.signals.get(name, 0)
        return int(value)  # type: ignore[arg-type]


_FAILURES = {
    "load": "File not found: {about}",
    "unlock protective stop": (
        "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before "
        "unlocking"
    ),
}
