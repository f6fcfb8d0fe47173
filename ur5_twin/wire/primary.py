"""Ports 30001 and 30002: the robot's state ten times a second, what programs say, and scripts in."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ur5_twin.arm.parameters import load_model
from ur5_twin.wire import primary_packages as packages
from ur5_twin.wire.realtime import ScriptClient
from ur5_twin.wire.state import State
from ur5_twin.wire.streams import TcpPort

if TYPE_CHECKING:
    from ur5_twin.wire.controller import Message, VirtualController

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
    """

    def __init__(
        self,
        controller: VirtualController,
        bind: str = "127.0.0.1",
        number: int = 30001,
        *,
        secondary: bool = False,
    ) -> None:
        super().__init__(controller, bind, number)
        self.name = "secondary" if secondary else "primary"
        self._secondary = secondary
        self._arm = load_model("controller")
        self._told = _newest(controller)

    def new_client(self) -> PrimaryClient:
        return PrimaryClient(self, takes_scripts=True)

    def package(self, state: State) -> bytes:
        """The package of a tick."""
        return packages.robot_state(self.controller.version, state.timestamp, state.signals, self._arm)

    def publish(self, state: State) -> None:
        super().publish(state)
        if not self._secondary:
            self._tell()
        beat = _RATE * self.controller.version.period
        if not self.clients or math.floor(state.tick * beat + 1e-9) == math.floor((state.tick - 1) * beat + 1e-9):
            return
        package = self.package(state)
        for client in list(self.clients):
            client.send_package(package)

    def _tell(self) -> None:
        """Forward what programs have said since the last tick."""
        newest = _newest(self.controller)
        if newest == self._told:
            return
        # A copy: the tick thread goes on writing.
        fresh = [message for message in list(self.controller.messages) if message.number > self._told]
        self._told = newest
        for client in list(self.clients):
            for message in fresh:
                client.send_package(self._message(message))

    def _message(self, message: Message) -> bytes:
        match message.kind:
            case "popup":
                version = self.controller.version
                return packages.popup_message(version, message.text, message.timestamp, message.number)
            case "error":
                return packages.exception_message(message.text, message.timestamp)
        return packages.text_message(message.text, message.timestamp)


def _newest(controller: VirtualController) -> int:
    """The number of the newest message; -1 before the first."""
    try:
        return controller.messages[-1].number
    except IndexError:
        return -1
