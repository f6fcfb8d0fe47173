"""The robot over its real-time interface (30003): a stream of bytes that has to be put together again."""

from __future__ import annotations

import contextlib
import select
import socket
import time

import numpy as np

from ur5_twin.errors import WireError
from ur5_twin.sources.device import Row
from ur5_twin.wire.realtime_layout import HEADER, decode, fields, size_of

PORT = 30003
#: Columns of a log, in a packet's order; not in every version's.
WANTED = (
    "target_q",
    "target_qd",
    "target_qdd",
    "target_current",
    "target_moment",
    "actual_q",
    "actual_qd",
    "actual_current",
    "actual_TCP_pose",
    "actual_TCP_speed",
    "actual_TCP_force",
    "actual_tool_accelerometer",
)
#: Waiting for a connection, for the first packet, and for bytes, s.
_CONNECT, _FIRST, _WAIT = 3.0, 3.0, 0.005
_CHUNK = 1 << 16


class RealtimeSource:
    """A robot whose controller publishes on port 30003, of any version; it only reads.

    Packages come late, split and several at once (thesis section 4.4.1): the stream is put together by the size that
    each package begins with. Nothing is sent.

    Args:
        host: name or address.
        port: 30003, or 30013, or wherever it listens.

    Attributes:
        name, columns, lost: as of ``device.Device``; TCP loses nothing, ``lost`` stays 0.
        size: bytes of a package, which tells the version.
    """

    name = "robot"

    def __init__(self, host: str, port: int = PORT) -> None:
        self.host, self.port = host, port
        self.columns: dict[str, int] = {}
        self.lost = 0
        self.size = 0
        self._socket: socket.socket | None = None
        self._bytes = bytearray()
        self._first: list[Row] = []

    def start(self) -> None:
        """Connect, and wait for the first package, which tells the version."""
        self.close()
        try:
            self._socket = socket.create_connection((self.host, self.port), _CONNECT)
        except OSError as error:
            raise WireError(
                f"{self.host}, port {self.port}: no connection ({error.strerror or error}); is the robot on, and this "
                "its address?"
            ) from None
        self._socket.setblocking(False)
        self._bytes.clear()
        until = time.monotonic() + _FIRST
        while not (rows := self.rows()):
            if time.monotonic() > until:
                self.close()
                raise WireError(f"{self.host}, port {self.port}: connected, but nothing comes: no real-time interface")
        self._first = rows

    def rows(self) -> list[Row]:
        """What has come since the last call (``device.Device``).

        Raises:
            WireError: the connection is lost, or what comes is no real-time interface.
        """
        if self._socket is None:
            raise WireError(f"{self.host}: not connected")
        if self._first:
            first, self._first = self._first, []
            return first
        try:
            if select.select([self._socket], [], [], _WAIT)[0]:
                received = self._socket.recv(_CHUNK)
                if not received:
                    raise ConnectionResetError("the robot closed the connection")
                self._bytes += received
        except OSError as error:
            self.close()
            raise WireError(f"{self.host}: the connection is lost ({error.strerror or error})") from None
        now = time.time()
        found: list[Row] = []
        while len(self._bytes) >= HEADER:
            try:
                size = size_of(bytes(self._bytes[:HEADER]))
            except WireError as error:
                self.close()
                raise WireError(f"{self.host}, port {self.port}: no real-time interface: {error}") from None
            if len(self._bytes) < size:
                break
            found.append(self._row(bytes(self._bytes[:size]), now))
            del self._bytes[:size]
        return found

    def close(self) -> None:
        """Disconnect."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
            self._socket = None

    def _row(self, packet: bytes, now: float) -> Row:
        if len(packet) != self.size:
            self.size = len(packet)
            widths = {field.name: field.width for field in fields(self.size)}
            self.columns = {name: widths[name] for name in WANTED if name in widths}
        values = decode(packet)
        columns = {name: np.asarray(values[name], dtype=float) for name in self.columns}
        return Row(float(np.asarray(values["timestamp"])), now, columns)
