"""Connections that programs open, as the ROS 2 driver's does to hear what the arm is to do.

Nothing here waits outside of ticks: addresses are numbers, not names to be looked up, and what is not there yet is
looked for at the next tick. What a program opened is closed when it ends.
"""

from __future__ import annotations

import errno
import ipaddress
import select
import socket
from collections.abc import Callable, Generator
from typing import TYPE_CHECKING, Any

from ur5_twin.errors import ScriptError
from ur5_twin.wire.builtins.arguments import number
from ur5_twin.wire.urscript import shown

if TYPE_CHECKING:
    from ur5_twin.wire.controller import VirtualController

#: Connections at once; s that opening one may take; bytes of what has come in and not been read.
_MOST, _PATIENCE, _BUFFERED = 16, 2.0, 65_536
#: Whole numbers that one call reads, and characters of a string.
_NUMBERS, _CHARACTERS = 30, 1023
_FIRST = "socket_0"


class _Connection:
    def __init__(self, peer: socket.socket) -> None:
        self.peer, self.buffer, self.ended = peer, bytearray(), False

    def receive(self) -> None:
        """Take in what has come."""
        while len(self.buffer) < _BUFFERED and not self.ended:
            try:
                data = self.peer.recv(4096)
            except (BlockingIOError, InterruptedError):
                return
            except OSError:
                data = b""
            self.ended = not data
            self.buffer += data

    def send(self, data: bytes) -> bool:
        """Whether all of it went out: who does not read is cut off."""
        if self.ended:
            return False
        try:
            self.ended = self.peer.send(data) != len(data)
        except OSError:
            self.ended = True
        return not self.ended


class Sockets:
    def __init__(self, controller: VirtualController) -> None:
        self._controller = controller
        self._open: dict[str, _Connection] = {}

    def socket_open(self, address: Any, port: Any, socket_name: Any = _FIRST) -> Generator[None, None, bool]:
        """Connect; whether that was possible. Other machines only if the controller may (``reaches_out``)."""
        self.socket_close(socket_name)
        host, place = self._place(address, port)
        if len(self._open) >= _MOST:
            raise ScriptError(f"socket_open: more than {_MOST} sockets")
        peer = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
        try:
            peer.setblocking(False)
            code = peer.connect_ex((host, place))
            left = round(_PATIENCE / self._controller.version.period)
            while code in (errno.EINPROGRESS, errno.EWOULDBLOCK, errno.EALREADY) and left > 0:
                if select.select([], [peer], [], 0.0)[1]:
                    code = peer.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
                    break
                left -= 1
                yield
            if code != 0:
                return False
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._open[shown(socket_name)] = _Connection(peer)
            peer = None
            return True
        finally:
            if peer is not None:
                peer.close()

    def socket_close(self, socket_name: Any = _FIRST) -> None:
        """Close it, if it is open."""
        connection = self._open.pop(shown(socket_name), None)
        if connection is not None:
            connection.peer.close()

    def socket_read_binary_integer(
        self, number: Any, socket_name: Any = _FIRST, timeout: Any = 2
    ) -> Generator[None, None, list[int]]:
        """[n, and n whole numbers of 32 bits, the first byte the highest]; [0, -1, ...] when they do not come."""
        count = _count("socket_read_binary_integer: number", number, _NUMBERS)
        data = yield from self._read(socket_name, timeout, lambda buffer: 4 * count)
        if data is None:
            return [0, *[-1] * count]
        return [count, *(int.from_bytes(data[4 * k : 4 * k + 4], "big", signed=True) for k in range(count))]

    def socket_read_string(
        self,
        socket_name: Any = _FIRST,
        prefix: Any = "",
        suffix: Any = "",
        interpret_escape: Any = False,
        timeout: Any = 2,
    ) -> Generator[None, None, str]:
        """What comes, or what is between prefix and suffix; empty when it does not come."""
        first, last = shown(prefix).encode(), shown(suffix).encode()

        def complete(buffer: bytearray) -> int:
            if not last:
                return min(len(buffer), _CHARACTERS) or 1
            place = buffer.find(last, buffer.find(first) + len(first)) if first in buffer else -1
            return len(buffer) + 1 if place < 0 else place + len(last)

        data = yield from self._read(socket_name, timeout, complete)
        if data is None:
            return ""
        text = data[data.find(first) + len(first) : len(data) - len(last)]
        return text[:_CHARACTERS].decode("utf-8", "replace")

    def socket_read_line(self, socket_name: Any = _FIRST, timeout: Any = 2) -> Generator[None, None, str]:
        """A line without its end; empty when none comes."""
        line = yield from self.socket_read_string(socket_name, "", "\n", False, timeout)
        return line.removesuffix("\r")

    def socket_send_int(self, value: Any, socket_name: Any = _FIRST) -> bool:
        """A whole number of 32 bits, the highest byte first; whether it went out."""
        whole = number("socket_send_int: value", value)
        if whole != int(whole) or not -(2**31) <= whole < 2**31:
            raise ScriptError(f"socket_send_int: {shown(value)[:40]} is no whole number of 32 bits")
        return self._send(socket_name, int(whole).to_bytes(4, "big", signed=True))

    def socket_send_byte(self, value: Any, socket_name: Any = _FIRST) -> bool:
        """One byte, 0 to 255; whether it went out."""
        return self._send(socket_name, bytes([_count("socket_send_byte: value", value, 255)]))

    def socket_send_string(self, str: Any, socket_name: Any = _FIRST) -> bool:
        """Characters; whether they went out."""
        return self._send(socket_name, shown(str).encode())

    def socket_send_line(self, str: Any, socket_name: Any = _FIRST) -> bool:
        """Characters and the end of a line; whether they went out."""
        return self._send(socket_name, shown(str).encode() + b"\n")

    def close_all(self) -> None:
        """Close what is open, as at the end of the program."""
        for name in list(self._open):
            self.socket_close(name)

    def _place(self, address: Any, port: Any) -> tuple[str, int]:
        words = shown(address)
        try:
            host = ipaddress.ip_address("127.0.0.1" if words == "localhost" else words)
        except ValueError:
            raise ScriptError(f"socket_open: '{words[:60]}' is no IP address, and names are not looked up") from None
        if not (host.is_loopback or self._controller.reaches_out):
            raise ScriptError(f"socket_open: {host} is another machine; programs here may connect to this one alone")
        return str(host), max(1, _count("socket_open: port", port, 65_535))

    def _send(self, name: Any, data: bytes) -> bool:
        connection = self._open.get(shown(name))
        return connection is not None and connection.send(data)

    def _read(
        self, name: Any, timeout: Any, complete: Callable[[bytearray], int]
    ) -> Generator[None, None, bytes | None]:
        """As many bytes as ``complete`` says of what is there; None if they are not there in time, or never will be."""
        seconds = number("timeout", timeout)
        left = max(1, round(seconds / self._controller.version.period)) if seconds > 0.0 else -1
        connection = self._open.get(shown(name))
        while connection is not None:
            connection.receive()
            size = complete(connection.buffer)
            if size <= len(connection.buffer):
                data = bytes(connection.buffer[:size])
                del connection.buffer[:size]
                return data
            # A string without end would fill the buffer, and then never come.
            if connection.ended or len(connection.buffer) >= _BUFFERED or left == 0:
                return None
            left -= 1
            yield
            connection = self._open.get(shown(name))
        return None


def _count(what: str, value: Any, most: int) -> int:
    count = number(what, value)
    if count != int(count) or not 0 <= count <= most:
        raise ScriptError(f"{what} is {shown(value)[:40]}, it must be a whole number from 0 to {most}")
    return int(count)
