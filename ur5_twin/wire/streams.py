"""What the TCP ports share: bounded buffers, clients that read too slowly, clients that come and go.

All of it runs in one asyncio loop. A client's outgoing buffer is bounded: a *package* (one of an endless stream) is
dropped as a whole while the buffer is full, a *reply* is never dropped but then no more is read from the client. So
what a client costs is bounded, and nobody waits for it.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import socket
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, TypeVar

from ur5_twin.errors import WireError
from ur5_twin.wire.state import State

if TYPE_CHECKING:
    from ur5_twin.wire.controller import VirtualController

log = logging.getLogger(__name__)

T = TypeVar("T")
C = TypeVar("C", bound="Client")

#: Clients that a port takes at a time.
MOST_CLIENTS = 64
#: Bytes that wait for a client in this process before packages are dropped; it takes again below half of it.
_FULL = 128 * 1024
#: Bytes that the kernel keeps for a client beside that: without it Linux lets megabytes pile up, seconds of old data.
_KERNEL_BUFFER = 64 * 1024
#: A client that took nothing for this long while its buffer was full is cut, s.
_PATIENCE = 5.0
#: The controller's tick thread answers within this, s, or not at all.
_ANSWER = 5.0


class CutOff(Exception):
    """What a client sent cannot be followed any further: it is disconnected."""


class Port(Protocol):
    """What the server runs: a port of the controller. All methods are called in the I/O loop."""

    @property
    def name(self) -> str:
        """The name that ``--ports`` and ``Server.addresses`` use."""
        ...

    @property
    def address(self) -> Any:
        """Where it listens, once started."""
        ...

    @property
    def connected(self) -> int | None:
        """How many clients it has; None if it cannot know."""
        ...

    async def start(self) -> None:
        """Begin to listen.

        Raises:
            WireError: it cannot, and why.
        """
        ...

    def publish(self, state: State) -> None:
        """Send what is due at a tick; must not block."""
        ...

    async def close(self) -> None:
        """Stop listening and drop all clients."""
        ...


class Client(asyncio.Protocol):
    """One connection; a port's own class says what to do with what comes in.

    Args:
        port: the port that accepted it.
    """

    #: Whether a client that does not read is cut. Ports that people use only to send programs to leave it in peace.
    cut_when_stuck: ClassVar[bool] = True

    def __init__(self, port: TcpPort[Any]) -> None:
        self.port = port
        self.dropped = 0
        self._transport: asyncio.Transport | None = None
        self._full = False
        self._stuck: asyncio.TimerHandle | None = None
        self._unsent = 0
        self._dropped_by_us = False

    # What the ports' clients fill in.

    def opened(self) -> None:
        """The client is connected."""

    def received(self, data: bytes) -> None:
        """Something came in, cut anywhere.

        Raises:
            CutOff: the client has to go.
        """

    def ended(self, *, by_client: bool) -> None:
        """The connection is gone; ``by_client``: not because of us."""

    # What they use.

    @property
    def connected(self) -> bool:
        return self._transport is not None and not self._transport.is_closing()

    @property
    def unsent(self) -> int:
        """Bytes that wait for the client in this process; those that the kernel keeps for it do not count."""
        return 0 if self._transport is None else self._transport.get_write_buffer_size()

    def send_package(self, package: bytes) -> bool:
        """Send one of a stream of packages, or drop it if the client is behind.

        Returns:
            Whether it was sent.
        """
        if self._full or not self.connected:
            self.dropped += 1
            self.port.packages_dropped += 1
            return False
        assert self._transport is not None
        self._transport.write(package)
        return True

    def reply(self, data: bytes) -> None:
        """Send an answer; while too many wait, nothing more is read from the client."""
        if self.connected:
            assert self._transport is not None
            self._transport.write(data)

    def finish(self) -> None:
        """Close the connection once everything is sent."""
        if self._transport is not None:
            self._transport.close()

    def cut(self, why: str) -> None:
        """Drop the connection at once."""
        log.info("%s: a client is cut off: %s", self.port.name, why)
        self.port.clients_cut += 1
        self.drop()

    def drop(self) -> None:
        """Drop the connection at once, with what is still to be sent."""
        self._dropped_by_us = True
        if self._transport is not None:
            self._transport.abort()

    def hold_reading(self, held: bool) -> None:
        """Read no more from the client, or go on."""
        if not self.connected:
            return
        assert self._transport is not None
        if held:
            self._transport.pause_reading()
        elif not self._full:
            self._transport.resume_reading()

    # asyncio's side.

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        if not self.port.accept(self):
            transport.abort()
            self._transport = None
            return
        made = transport.get_extra_info("socket")
        if made is not None:
            made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            made.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            made.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL_BUFFER)
        transport.set_write_buffer_limits(high=_FULL, low=_FULL // 2)
        self.opened()

    def data_received(self, data: bytes) -> None:
        if not self.connected:
            return
        try:
            self.received(data)
        except CutOff as error:
            self.cut(str(error))

    def eof_received(self) -> bool:
        # A client that only shuts down its sending side gets nothing more either: the robot does the same.
        return False

    def connection_lost(self, exc: Exception | None) -> None:
        if self._stuck is not None:
            self._stuck.cancel()
            self._stuck = None
        if self._transport is None:
            return
        if not self._dropped_by_us and isinstance(exc, ConnectionError):
            self._take_the_rest()
        self._transport = None
        self.port.forget(self)
        # Who closes without having read all resets the connection; that is no less an end.
        self.ended(by_client=not self._dropped_by_us)

    def _take_the_rest(self) -> None:
        """Read what came in before the client reset the connection: a package that was sent to it in between fails
        first, and the loop then reads no more. Who sends a program and closes at once would lose it."""
        assert self._transport is not None
        made = self._transport.get_extra_info("socket")
        rest = bytearray()
        # The loop's own handle of a socket cannot be read from; it still is open here.
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(made.fileno())) as same:
            same.setblocking(False)
            while data := same.recv(_KERNEL_BUFFER):
                rest += data
        # Nobody is left to be cut off.
        with contextlib.suppress(CutOff):
            self.received(bytes(rest))

    def pause_writing(self) -> None:
        self._full = True
        self.hold_reading(not self.port.reads_while_full)
        self._watch()

    def resume_writing(self) -> None:
        self._full = False
        if self._stuck is not None:
            self._stuck.cancel()
            self._stuck = None
        if not self.port.reads_while_full:
            self.hold_reading(False)

    def _watch(self) -> None:
        """Look again in a while whether the client has taken anything."""
        if not self.cut_when_stuck or self._transport is None:
            return
        left = self.unsent
        if self._stuck is not None and left >= self._unsent:
            self._stuck = None
            self.cut(f"it read nothing for {_PATIENCE:g} s")
            return
        self._unsent = left
        self._stuck = asyncio.get_running_loop().call_later(_PATIENCE, self._watch)


class TcpPort(Generic[C]):
    """A listening socket and its clients.

    Args:
        controller: whose port it is.
        bind: address to listen at.
        number: TCP port; 0 takes a free one.
    """

    #: The name that ``--ports`` uses.
    name: str = "port"
    #: Whether a client is still read from while it does not take what is sent to it: what comes in asks for no answer.
    reads_while_full: ClassVar[bool] = True

    def __init__(self, controller: VirtualController, bind: str, number: int) -> None:
        self.controller = controller
        self.state: State = controller.state
        self.clients: set[C] = set()
        self.clients_cut = 0
        self.clients_refused = 0
        self.clients_served = 0
        self.packages_dropped = 0
        self._bind = bind
        self._number = number
        self._server: asyncio.Server | None = None

    @property
    def address(self) -> tuple[str, int]:
        """(host, port) that it listens at."""
        return self._bind, self._number

    @property
    def connected(self) -> int:
        """How many clients there are."""
        return len(self.clients)

    def new_client(self) -> C:
        """A client that is about to connect."""
        raise NotImplementedError

    async def start(self) -> None:
        """Begin to listen.

        Raises:
            WireError: the address cannot be had.
        """
        loop = asyncio.get_running_loop()
        try:
            self._server = await loop.create_server(self.new_client, self._bind, self._number)
        except (OSError, OverflowError) as error:
            raise WireError(refusal(self.name, self._bind, self._number, error)) from error
        self._number = self._server.sockets[0].getsockname()[1]

    def publish(self, state: State) -> None:
        """Send what is due at a tick."""
        self.state = state

    async def close(self) -> None:
        """Stop listening and drop all clients."""
        if self._server is None:
            return
        self._server.close()
        for client in list(self.clients):
            client.drop()
        # Their connection_lost is called in the loop's next turns.
        while self.clients:
            await asyncio.sleep(0)
        await self._server.wait_closed()
        self._server = None

    def accept(self, client: Client) -> bool:
        """Whether there is room for one more."""
        if len(self.clients) >= MOST_CLIENTS:
            self.clients_refused += 1
            log.info("%s: a client is refused: there are %d already", self.name, MOST_CLIENTS)
            return False
        self.clients.add(client)  # type: ignore[arg-type]
        self.clients_served += 1
        return True

    def forget(self, client: Client) -> None:
        self.clients.discard(client)  # type: ignore[arg-type]

    async def ask(self, action: Callable[[], T]) -> T:
        """Have the tick thread do something, and wait for it.

        Raises:
            WireError: too much is asked for at a time, the controller does not tick, or the action itself failed.
        """
        asked = asyncio.wrap_future(self.controller.post(action))
        # Not awaited itself: a client that leaves must not take back what the tick thread is about to do.
        asked.add_done_callback(lambda done: done.cancelled() or done.exception())
        await asyncio.wait([asked], timeout=_ANSWER)
        if not asked.done():
            raise WireError(f"the controller has not ticked for {_ANSWER:g} s")
        return asked.result()


def refusal(name: str, bind: str, number: int, error: Exception, *, more: str = "") -> str:
    """Why a port cannot be had, and what to do.

    Args:
        name: the port's, as ``--ports`` has it.
        bind: address.
        number: port.
        error: what the system says.
        more: further ports that another controller then holds too, as ``--ports`` would have them.
    """
    where = f"{bind}:{number}"
    code = error.errno if isinstance(error, OSError) else None
    if code == errno.EADDRINUSE:
        return (
            f"{where} ({name}) is in use: another controller, or a program that holds it; stop it, or take a free one "
            f"with --ports {name}=0{more}"
        )
    if code == errno.EACCES:
        return f"{where} ({name}) needs privileges: choose another with --ports {name}=NUMBER above 1023"
    if code == errno.EADDRNOTAVAIL or isinstance(error, socket.gaierror):
        return f"'{bind}' is no address of this machine: bind to 127.0.0.1, 0.0.0.0 or one that it has"
    return f"cannot listen at {where} ({name}): {error}"


class Lines:
    """Bytes that come in pieces -> whole lines.

    Args:
        longest: bytes of the longest line.
    """

    def __init__(self, longest: int) -> None:
        self._longest = longest
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that end in ``data``, without their ends.

        Raises:
            CutOff: a line is longer than allowed.
        """
        *whole, rest = data.split(b"\n")
        if whole:
            whole[0] = bytes(self._rest) + whole[0]
            self._rest = bytearray(rest)
        else:
            self._rest += rest
        if len(self._rest) > self._longest or any(len(line) > self._longest for line in whole):
            raise CutOff(f"a line of more than {self._longest} bytes")
        return [line.rstrip(b"\r") for line in whole]

    def rest(self) -> bytes:
        """What came after the last line's end."""
        return bytes(self._rest)
