"""Ports 30003 and 30013: the real-time interface, a packet each tick whether anybody reads it or not."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING

from ur5_twin.wire import realtime_layout
from ur5_twin.wire.scripts import ScriptReader, upload
from ur5_twin.wire.state import State
from ur5_twin.wire.streams import Client, CutOff, TcpPort

if TYPE_CHECKING:
    from ur5_twin.wire.controller import VirtualController

#: Every third package is late; the one it comes with is split: its last bytes follow after so many seconds (as
#: ``ur5_twin.sensing.transport`` has it for a log).
_EVERY = 3
_SPLIT = 0.001
_SPLIT_BYTES = 62


class ScriptClient(Client):
    """A client of a port that takes URScript; many send a program and never read."""

    # ur_rtde and many small programs send scripts here and never read: a robot bears with them, and so does this.
    cut_when_stuck = False

    def __init__(self, port: TcpPort, takes_scripts: bool) -> None:
        super().__init__(port)
        self._scripts = ScriptReader() if takes_scripts else None

    def received(self, data: bytes) -> None:
        if self._scripts is not None:
            for script in self._scripts.feed(data):
                upload(self.port.controller, script)

    def ended(self, *, by_client: bool) -> None:
        rest = self._scripts.rest() if self._scripts is not None and by_client else None
        if rest is not None:
            # Nobody is left to be cut off.
            with contextlib.suppress(CutOff):
                upload(self.port.controller, rest)


class RealtimeClient(ScriptClient):
    """A reader of packets.

    Args:
        port: the port.
        takes_scripts: whether it may send URScript.
    """

    def __init__(self, port: RealtimePort, takes_scripts: bool) -> None:
        super().__init__(port, takes_scripts)
        self._late = b""
        self._tail = b""
        self._timer: asyncio.TimerHandle | None = None

    def packet(self, packet: bytes, *, late: bool) -> None:
        """Send a packet: at once, or if it is ``late`` with the next one, which is then split."""
        self._send_tail()
        if late and not self._late:
            self._late = packet
        elif self._late:
            held, self._late = self._late, b""
            if self.send_package(held + packet[:-_SPLIT_BYTES]):
                self._tail = packet[-_SPLIT_BYTES:]
                self._timer = asyncio.get_running_loop().call_later(_SPLIT, self._send_tail)
        else:
            self.send_package(packet)

    def ended(self, *, by_client: bool) -> None:
        if self._timer is not None:
            self._timer.cancel()
        super().ended(by_client=by_client)

    def _send_tail(self) -> None:
        """The rest of a split packet: never dropped, since its beginning is on its way."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._tail:
            self.reply(self._tail)
            self._tail = b""


class RealtimePort(TcpPort[RealtimeClient]):
    """The real-time interface, also known as the Matlab interface.

    Args:
        controller: the controller.
        bind: address to listen at.
        number: TCP port.
        read_only: whether what clients send is thrown away.
        late_packages: while the arm moves every third package comes late, with the next one, which is split in two
            (thesis section 4.4.1).
    """

    def __init__(
        self,
        controller: VirtualController,
        bind: str = "127.0.0.1",
        number: int = 30003,
        *,
        read_only: bool = False,
        late_packages: bool = False,
    ) -> None:
        super().__init__(controller, bind, number)
        self.name = "realtime_readonly" if read_only else "realtime"
        self._read_only = read_only
        self._late_packages = late_packages

    def new_client(self) -> RealtimeClient:
        return RealtimeClient(self, takes_scripts=not self._read_only)

    def publish(self, state: State) -> None:
        super().publish(state)
        if not self.clients:
            return
        packet = realtime_layout.encode(self.controller.version.realtime_size, state.signals)
        late = self._late_packages and state.moving and state.tick % _EVERY == _EVERY - 1
        for client in list(self.clients):
            client.packet(packet, late=late)
