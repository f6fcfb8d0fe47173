"""An ATI Net F/T of the cell: RDT over UDP, and the page over HTTP that says what its counts are worth."""

from __future__ import annotations

import asyncio
import socket
import sys
import time
from dataclasses import dataclass, replace

import numpy as np

from ur5_twin.errors import WireError
from ur5_twin.wire import rdt
from ur5_twin.wire.rdt import Calibration, Command
from ur5_twin.wire.state import State
from ur5_twin.wire.streams import refusal

#: Clients at a time. A datagram names its sender itself, so more than these could be made up at no cost.
MOST_CLIENTS = 8
#: A client that asked for records without end and was not heard of for this long makes room for a new one, s. Clients
#: do not repeat their request, so without a new one it is served on.
_FORGOTTEN = 60.0
#: Linux: tell who did not take a datagram.
_IP_RECVERR, _MSG_ERRQUEUE = 11, 0x2000
#: Records in a datagram of a client that asked for buffered ones.
_BUFFERED = 8
#: Connections to the page at a time, the longest request in bytes, and how long it may take, s.
_MOST_READERS, _LONGEST_REQUEST, _PATIENCE = 8, 8192, 2.0
_INT32 = 2**31 - 1
_DEVICE = "ft"

Address = tuple[str, int]


@dataclass
class _Client:
    """Who wants records.

    Attributes:
        left: records that are still to be sent; None without end.
        buffered: whether records travel in groups.
        heard: time of its last request (``time.monotonic``), s.
        sequence: of the last record sent.
        waiting: records of a group that is not full.
    """

    left: int | None
    buffered: bool
    heard: float
    sequence: int = 0
    waiting: bytes = b""


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, port: NetFTPort) -> None:
        self._port = port

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self._port.received(data, addr)

    def error_received(self, exc: Exception) -> None:
        self._port.forget_the_gone()


class NetFTPort:
    """RDT of one sensor, and its page.

    What asks for nothing well-formed gets no answer at all, and nobody gets more records than the sensor takes
    samples. A record carries a reading of the cell's force sensor as it is, bias included, less the bias that a client
    last set. Readings that come while nobody asks are not kept. The sensor has no monitor conditions, so there is no
    latch to reset.

    Args:
        bind: address to listen at.
        number: UDP port; 0 takes a free one.
        http: TCP port of the page; 0 takes a free one, None serves none.
        calibration: what counts are worth; its rate is that of the readings, once it is known.
        full_scale: (6,) beyond it a reading is marked as saturated, N and Nm; None marks only what no count can hold.
    """

    name = "net_ft"

    def __init__(
        self,
        bind: str = "127.0.0.1",
        number: int = rdt.RDT_PORT,
        *,
        http: int | None = rdt.HTTP_PORT,
        calibration: Calibration | None = None,
        full_scale: np.ndarray | None = None,
    ) -> None:
        self._bind, self._number, self._http = bind, number, http
        self._calibration = calibration or Calibration(name="ur5-twin")
        self._full_scale = full_scale
        self._clients: dict[Address, _Client] = {}
        self._readers = 0
        self._transport: asyncio.DatagramTransport | None = None
        self._server: asyncio.Server | None = None
        self._bias = np.zeros(6)
        self._newest: np.ndarray | None = None
        self._socket: socket.socket | None = None
        self._first = self._last = 0.0
        self._count = 0
        self.refused = 0

    @property
    def address(self) -> tuple[str, int] | tuple[str, int, int]:
        """(host, UDP port) that it listens at, and the page's TCP port if it has one."""
        return (self._bind, self._number) if self._http is None else (self._bind, self._number, self._http)

    @property
    def page_address(self) -> Address | None:
        """(host, TCP port) of the page; None if it has none."""
        return None if self._http is None else (self._bind, self._http)

    @property
    def connected(self) -> int:
        """How many are sent records."""
        return len(self._clients)

    async def start(self) -> None:
        """Begin to listen.

        Raises:
            WireError: a port cannot be had.
        """
        loop = asyncio.get_running_loop()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            if sys.platform == "linux":
                self._socket.setsockopt(socket.IPPROTO_IP, _IP_RECVERR, 1)
            self._socket.bind((self._bind, self._number))
            self._transport, _ = await loop.create_datagram_endpoint(lambda: _Datagrams(self), sock=self._socket)
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise WireError(refusal(self.name, self._bind, self._number, error, more=",net_ft_page=0")) from None
        self._number = self._transport.get_extra_info("sockname")[1]
        if self._http is None:
            return
        try:
            self._server = await asyncio.start_server(self._serve_page, self._bind, self._http, limit=_LONGEST_REQUEST)
        except (OSError, OverflowError) as error:
            self._transport.close()
            self._transport = None
            raise WireError(refusal("net_ft_page", self._bind, self._http, error)) from None
        self._http = self._server.sockets[0].getsockname()[1]

    def publish(self, state: State) -> None:
        """Send what the sensor read during a tick."""
        readings = state.readings.get(_DEVICE)
        if readings is None or not len(readings["time"]):
            return
        wrench, time_ = np.asarray(readings["ft_wrench"]), np.asarray(readings["time"])
        if self._newest is None:
            self._first = float(time_[0])
        self._count += len(wrench)
        self._newest, self._last = wrench[-1], float(time_[-1])
        if not self._clients or self._transport is None:
            return
        self.forget_the_gone()
        # The sensor samples at its internal rate all the time; a reading is the sample next to its time.
        elapsed = time_ - self._first
        samples = np.rint(elapsed * self._calibration.internal_rate).astype(np.int64) + 1
        counts, status = self._counted(wrench)
        for sample, row, bits in zip(samples.tolist(), counts.tolist(), status.tolist(), strict=True):
            for address, client in list(self._clients.items()):
                self._send(address, client, sample, row, bits)

    async def close(self) -> None:
        """Stop listening and forget all clients."""
        self._clients.clear()
        if self._transport is not None:
            self._transport.close()
            self._transport = self._socket = None
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()
            self._server = None

    def received(self, data: bytes, address: Address) -> None:
        """A datagram has come."""
        parsed = rdt.parse_request(data)
        if parsed is None:
            return
        command, samples = parsed
        match command:
            case Command.STOP:
                self._clients.pop(address, None)
            case Command.REAL_TIME | Command.BUFFERED | Command.MULTI_UNIT:
                self._begin(address, samples or None, buffered=command is Command.BUFFERED)
            case Command.BIAS:
                if self._newest is not None:
                    self._bias = self._newest

    def forget_the_gone(self) -> None:
        """Send no more to addresses at which nobody listens any more, as far as the system tells."""
        if self._socket is None or sys.platform != "linux":
            return
        # An error that stayed here would wake the loop for ever.
        for _ in range(64):
            try:
                _, _, _, address = self._socket.recvmsg(64, 512, _MSG_ERRQUEUE)
            except OSError:
                return
            self._clients.pop(address, None)

    def _begin(self, address: Address, samples: int | None, *, buffered: bool) -> None:
        now = time.monotonic()
        if address not in self._clients and len(self._clients) >= MOST_CLIENTS:
            stalest = min(self._clients, key=lambda known: self._clients[known].heard)
            if now - self._clients[stalest].heard < _FORGOTTEN:
                self.refused += 1
                return
            del self._clients[stalest]
        self._clients[address] = _Client(samples, buffered, now)

    def _send(self, address: Address, client: _Client, sample: int, counts: list[int], status: int) -> None:
        assert self._socket is not None
        client.sequence += 1
        record = rdt.pack_record(client.sequence, sample, status, counts)
        if client.left is not None:
            client.left -= 1
        last = client.left == 0
        if client.buffered:
            record = client.waiting + record
            if len(record) < _BUFFERED * rdt.RECORD_BYTES and not last:
                client.waiting = record
                return
            client.waiting = b""
        if last:
            self._clients.pop(address, None)
        try:
            self._socket.sendto(record, address)
        except BlockingIOError:
            # What the system does not take at once is lost, as on the wire.
            pass
        except OSError:
            self.forget_the_gone()

    def _counted(self, wrench: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 6) counts, and status bits, of readings (n, 6)."""
        counts = np.nan_to_num((wrench - self._bias) / self._calibration.per_count)
        beyond = np.any(np.abs(counts) > _INT32, axis=1)
        if self._full_scale is not None:
            beyond |= np.any(np.abs(wrench) >= self._full_scale, axis=1)
        status = np.where(beyond, rdt.ERROR | rdt.SATURATED, 0)
        return np.rint(np.clip(counts, -_INT32, _INT32)).astype(np.int64), status

    async def _serve_page(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One request, one answer."""
        if self._readers >= _MOST_READERS:
            writer.transport.abort()
            return
        self._readers += 1
        try:
            async with asyncio.timeout(_PATIENCE):
                head = await reader.readuntil(b"\r\n\r\n")
                writer.write(self._answer(head))
                await writer.drain()
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass
        finally:
            self._readers -= 1
            writer.close()

    def _answer(self, head: bytes) -> bytes:
        words = head.split(b"\r\n", 1)[0].split()
        status, body = "400 Bad Request", b""
        if len(words) == 3 and words[2].startswith(b"HTTP/"):
            if words[0] not in (b"GET", b"HEAD"):
                status = "405 Method Not Allowed"
            elif words[1].split(b"?", 1)[0] != rdt.PAGE.encode():
                status = "404 Not Found"
            else:
                status, body = "200 OK", self._current().page()
        lines = (
            f"HTTP/1.1 {status}\r\nContent-Type: text/xml\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
        )
        return lines.encode() + (b"" if words[:1] == [b"HEAD"] else body)

    def _current(self) -> Calibration:
        """The calibration with the rate at which readings come."""
        span = self._last - self._first
        rate = self._calibration.rate if span <= 0.0 else round((self._count - 1) / span, 3)
        return replace(self._calibration, rate=rate)
