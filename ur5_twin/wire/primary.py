"""Ports 30001 and 30002 (30011 and 30012 read only): the state ten times a second, what programs say, scripts in."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ur5_twin.arm.parameters import load_model
from ur5_twin.wire import primary_packages as packages
from ur5_twin.wire.messages import Message, News
from ur5_twin.wire.realtime import ScriptClient
from ur5_twin.wire.state import State
from ur5_twin.wire.streams import TcpPort

if TYPE_CHECKING:
    from ur5_twin.wire.controller import VirtualController

#: States a second.
_RATE = 10.0


class PrimaryClient(ScriptClient):
    """A reader of the robot's state, who may send URScript."""

    port: PrimaryPort

    def opened(self) -> None:
        state = self.port.state
        self.send_package(packages.version_message(self.port.controller.version, state.timestamp))
        self.send_package(self.port.package(state))


class PrimaryPort(TcpPort[PrimaryClient]):
    """The primary or the secondary interface.

    Args:
        controller: the controller.
        bind: address to listen at.
        number: TCP port.
        secondary: it tells the robot's state but not what programs say.
        read_only: whether what clients send is thrown away.
    """

    def __init__(
        self,
        controller: VirtualController,
        bind: str = "127.0.0.1",
        number: int = 30001,
        *,
        secondary: bool = False,
        read_only: bool = False,
    ) -> None:
        super().__init__(controller, bind, number)
        self.name = ("secondary" if secondary else "primary") + ("_readonly" if read_only else "")
        self._read_only = read_only
        self._arm = load_model("controller")
        self._news = None if secondary else News(controller)

    def new_client(self) -> PrimaryClient:
        return PrimaryClient(self, takes_scripts=not self._read_only)

    def package(self, state: State) -> bytes:
        """The package of a tick."""
        return packages.robot_state(self.controller.version, state.timestamp, state.signals, self._arm)

    def publish(self, state: State) -> None:
        super().publish(state)
        for message in [] if self._news is None else self._news.fresh():
            said = self._message(message)
            for client in list(self.clients):
                client.send_package(said)
        beat = _RATE * self.controller.version.period
        if not self.clients or math.floor(state.tick * beat + 1e-9) == math.floor((state.tick - 1) * beat + 1e-9):
            return
        package = self.package(state)
        for client in list(self.clients):
            client.send_package(package)

    def _message(self, message: Message) -> bytes:
        match message.kind:
            case "popup":
                version = self.controller.version
                return packages.popup_message(version, message.text, message.timestamp, message.number)
            case "error":
                return packages.exception_message(message.text, message.timestamp)
        return packages.text_message(message.text, message.timestamp)
