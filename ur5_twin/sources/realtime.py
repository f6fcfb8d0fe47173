"""The real-time interface (TCP 30003, read-only 30013) as a source: for controllers without RTDE, and without ur_rtde.

TCP is a stream: a packet may come in pieces, several may come at once. ``Reassembler`` makes packets of it again.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Sequence
from itertools import groupby

import numpy as np

from ur5_twin.errors import WireError
from ur5_twin.sources.device import Rows
from ur5_twin.sources.link import SILENCE, Link, LinkLost
from ur5_twin.wire.realtime_layout import HEADER, SIZES, fields, modes_of

PORT = 30003
#: The newest layout.
_NEWEST = max(SIZES)
#: Bytes in a row that are no packet before a stream is given up: dozens of packets of the longest layout.
_MOST_GARBAGE = 64 * 1024
#: Layouts that do not exist yet append to the newest one, as all have; more than this is no packet, bytes.
_LONGEST = 4096
#: What is read at once, bytes.
_CHUNK = 64 * 1024
#: How long connecting and waiting for a first packet may take, s.
_TIMEOUT = 3.0
#: How often a receiver that gets nothing looks whether it is to stop, s.
_GLANCE = 0.1


class Reassembler:
    """Packets out of a byte stream.

    Where something else than a packet's length stands in front, bytes are passed over until the length of this stream's
    packets comes again with another one behind it.

    Attributes:
        size: bytes of this stream's packets; None before the first.
        skipped: bytes passed over so far.

    Raises:
        WireError: by ``feed``, if what comes is not the real-time interface.
    """

    def __init__(self) -> None:
        self.size: int | None = None
        self.skipped = 0
        self._buffer = bytearray()
        self._astray = 0

    def feed(self, data: bytes) -> list[bytes]:
        """The packets that are whole now that ``data`` has come."""
        self._buffer += data
        found = []
        while len(self._buffer) >= HEADER:
            size = struct.unpack_from(">I", self._buffer)[0]
            if not (size == self.size if self.size is not None else _may_be_a_packet(size)):
                if not self._find():
                    break
                continue
            if len(self._buffer) < size:
                break
            if self._astray or size not in SIZES:
                # The length alone may be chance, two of them in their places are not.
                if len(self._buffer) < size + HEADER:
                    break
                if struct.unpack_from(">I", self._buffer, size)[0] != size:
                    self._skip(1)
                    continue
            self.size, self._astray = size, 0
            found.append(bytes(self._buffer[:size]))
            del self._buffer[:size]
        return found

    def _find(self) -> bool:
        """Pass over bytes up to the next place where a packet may begin; False if more must come first."""
        sizes = SIZES if self.size is None else (self.size,)
        places = [self._buffer.find(struct.pack(">I", size), 1) for size in sizes]
        found = [place for place in places if place > 0]
        # The last bytes may be the beginning of a length.
        self._skip(min(found) if found else max(len(self._buffer) - HEADER + 1, 0))
        return bool(found)

    def _skip(self, n: int) -> None:
        head = bytes(self._buffer[:HEADER])
        del self._buffer[:n]
        self.skipped += n
        self._astray += n
        if self._astray > _MOST_GARBAGE:
            raise WireError(
                f"{self._astray} bytes without a packet of the real-time interface, the last are {head.hex(' ')} ...; "
                f"ports {PORT} and 30013 send packets of {min(SIZES)} to {_NEWEST} bytes"
            )


def _may_be_a_packet(size: int) -> bool:
    return size in SIZES or (_NEWEST < size <= _LONGEST and (size - HEADER) % 8 == 0)


def decode(packets: Sequence[bytes], arrival: Sequence[float]) -> Rows:
    """Rows out of packets of one size, under RTDE's names, in RTDE's units; modes are those of the later versions.

    Args:
        packets: whole, length included.
        arrival: s, of each.
    """
    size = len(packets[0])
    doubles = np.frombuffer(b"".join(packet[HEADER:] for packet in packets), dtype=">f8").astype(np.float64)
    values = doubles.reshape(len(packets), (size - HEADER) // 8)
    columns = {}
    # Of packets that are newer than what is known, the known part.
    for field in fields(min(size, _NEWEST)):
        first = (field.offset - HEADER) // 8
        columns[field.name] = values[:, first : first + field.width]
    if "robot_mode" in columns and "safety_mode" not in columns:
        modes = [modes_of(int(mode)) for mode in np.nan_to_num(columns["robot_mode"][:, 0])]
        columns["robot_mode"], columns["safety_mode"] = np.array(modes, dtype=float).T[:, :, None]
    time_ = columns.pop("timestamp")[:, 0]
    return Rows(time_, np.array(arrival, dtype=float), columns)


class RealtimeSource(Link[tuple[float, bytes]]):
    """The real-time interface of one controller; nothing is ever sent to it.

    Args:
        host: address or name of the robot.
        port: 30003, 30013, or where a virtual controller has it.
    """

    def __init__(self, host: str, port: int = PORT) -> None:
        super().__init__(host)
        self.port = port
        self._socket: socket.socket | None = None
        self._stream = Reassembler()
        self._skipped = 0
        self._heard = 0.0

    def describe(self) -> str:
        """The stream in words, once connected."""
        return f"real-time interface of {self.host}:{self.port}, packets of {self._stream.size} bytes"

    @property
    def skipped(self) -> int:
        """Bytes passed over so far that were no packet."""
        return self._skipped + self._stream.skipped

    def _open(self) -> None:
        self._skipped += self._stream.skipped
        self._stream = Reassembler()
        try:
            self._socket = socket.create_connection((self.host, self.port), timeout=_TIMEOUT)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            raise WireError(f"{self.host}:{self.port}: no real-time interface ({error.strerror or error})") from None
        self._socket.settimeout(_GLANCE)
        self._heard = time.monotonic()
        deadline = self._heard + _TIMEOUT
        while self._stream.size is None:
            if time.monotonic() > deadline:
                raise WireError(f"{self.host}:{self.port}: connected, but no packet came within {_TIMEOUT:g} s")
            if self._stopping.is_set():
                raise WireError("stopped")
            try:
                self._receive()
            except LinkLost as lost:
                raise WireError(f"{self.host}:{self.port}: {lost}") from None

    def _receive(self) -> None:
        assert self._socket is not None
        try:
            data = self._socket.recv(_CHUNK)
        except TimeoutError:
            if time.monotonic() - self._heard > SILENCE:
                raise LinkLost(f"silent for {SILENCE:g} s") from None
            return
        except OSError as error:
            raise LinkLost(error.strerror or str(error)) from None
        self._heard = time.monotonic()
        if not data:
            raise LinkLost("closed by the robot")
        before = self._stream.skipped
        try:
            packets = self._stream.feed(data)
        except WireError as error:
            raise LinkLost(str(error)) from None
        if self._stream.skipped > before:
            self._say(f"{self._stream.skipped - before} bytes between packets are none: passed over")
        for packet in packets:
            self._put((self._heard, packet))

    def _decoded(self, pieces: list[tuple[float, bytes]]) -> list[Rows]:
        # After a reconnect they may have another size.
        runs = [list(run) for _, run in groupby(pieces, lambda piece: len(piece[1]))]
        return [decode([packet for _, packet in run], [arrival for arrival, _ in run]) for run in runs]

    def _shut(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
