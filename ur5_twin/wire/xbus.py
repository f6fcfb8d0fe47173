"""What goes over the wire of an Xsens MTi of the first generation: frames, and what is in them.

Knows no device; the port (``wire.mti``) and the client (``sources.mti``) use it, one at each end, so that they cannot
disagree. A frame is FA, FF, message, length, data, checksum; with length FF two more bytes hold the length. All bytes
after FA sum to 0 modulo 256.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from ur5_twin.errors import WireError

PREAMBLE, BUS = 0xFA, 0xFF
_EXTENDED = 0xFF
#: Longest data of a frame, bytes: what is longer is no frame.
LONGEST = 2048
#: The sampling period is told in units of so many a second.
TICKS = 115_200
#: Baud rate that the device has unless it was told otherwise.
BAUD = 115_200
#: Output mode: calibrated data. Output settings: a sample counter, and which sensors are left out.
CALIBRATED = 0x0002
COUNTER, NO_ACC, NO_GYRO, NO_MAG = 0x0001, 0x0010, 0x0020, 0x0040
#: Values as fixed-point numbers, which nothing here writes or reads.
_FIXED_POINT = 0x0300
_CONFIGURATION = struct.Struct(">IHHHHI8s8s32x32xHIHHI8x")
_COUNTER_WRAP = 1 << 16


class Message(IntEnum):
    """Kinds of messages; a device acknowledges one with the next number."""

    REQ_DEVICE_ID = 0x00
    SET_PERIOD = 0x04
    REQ_DATA_LENGTH = 0x0A
    REQ_CONFIGURATION = 0x0C
    GO_TO_MEASUREMENT = 0x10
    REQ_FIRMWARE = 0x12
    GO_TO_CONFIG = 0x30
    DATA = 0x32
    WAKE_UP = 0x3E
    RESET = 0x40
    ERROR = 0x42
    SET_OUTPUT_MODE = 0xD0
    SET_OUTPUT_SETTINGS = 0xD2
    SET_OUTPUT_SKIP_FACTOR = 0xD4


class ErrorCode(IntEnum):
    """What a device answers to what it cannot do."""

    PERIOD = 0x03
    MESSAGE = 0x04
    PARAMETER = 0x21


class Frame(NamedTuple):
    """A message and its data."""

    message: int
    data: bytes


def pack(message: int, data: bytes = b"") -> bytes:
    """A frame.

    Raises:
        ValueError: more data than a frame may hold.
    """
    if len(data) > LONGEST:
        raise ValueError(f"{len(data)} bytes of data, a frame holds up to {LONGEST}")
    length = bytes([len(data)]) if len(data) < _EXTENDED else struct.pack(">BH", _EXTENDED, len(data))
    body = bytes([BUS, message]) + length + data
    return bytes([PREAMBLE]) + body + bytes([-sum(body) & 0xFF])


class Frames:
    """Frames out of a byte stream, whatever is between them.

    Where a checksum is wrong, the search goes on one byte behind the preamble: a frame that begins inside of what
    looked like one is found. No more than one frame's bytes wait.

    Attributes:
        skipped: bytes passed over so far.
    """

    def __init__(self) -> None:
        self.skipped = 0
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Frame]:
        """The frames that are whole now that ``data`` has come."""
        self._buffer += data
        found, at = [], 0
        while True:
            start = self._buffer.find(PREAMBLE, at)
            if start < 0:
                self.skipped += len(self._buffer) - at
                at = len(self._buffer)
                break
            self.skipped += start - at
            at = start
            end, frame = self._frame(at)
            if end is None:
                break
            if frame is None:
                self.skipped += 1
                at += 1
                continue
            found.append(frame)
            at = end
        del self._buffer[:at]
        return found

    def _frame(self, at: int) -> tuple[int | None, Frame | None]:
        """Where what begins at a place ends, None if that has not come yet; and the frame, None if it is none."""
        buffer = self._buffer
        if len(buffer) < at + 2:
            return None, None
        if buffer[at + 1] != BUS:
            return at, None
        if len(buffer) < at + 4:
            return None, None
        length, front = buffer[at + 3], 4
        if length == _EXTENDED:
            if len(buffer) < at + 6:
                return None, None
            length, front = int.from_bytes(buffer[at + 4 : at + 6], "big"), 6
        if length > LONGEST:
            return at, None
        end = at + front + length + 1
        if len(buffer) < end:
            return None, None
        if sum(buffer[at + 1 : end]) & 0xFF:
            return at, None
        return end, Frame(buffer[at + 2], bytes(buffer[at + front : end - 1]))


@dataclass(frozen=True)
class Layout:
    """What a data message holds.

    Attributes:
        mode: of the output.
        settings: of the output.
    """

    mode: int = CALIBRATED
    settings: int = COUNTER

    @property
    def columns(self) -> tuple[str, ...]:
        """The vectors in it, in order."""
        if not self.mode & CALIBRATED:
            return ()
        left_out = {"imu_acc": NO_ACC, "imu_gyro": NO_GYRO, "imu_mag": NO_MAG}
        return tuple(name for name, bit in left_out.items() if not self.settings & bit)

    @property
    def counts(self) -> bool:
        """Whether a sample counter ends it."""
        return self.settings & 0x3 == COUNTER

    @property
    def length(self) -> int:
        """Bytes of its data."""
        return 12 * len(self.columns) + 2 * self.counts

    @property
    def understood(self) -> bool:
        """Whether nothing else is in it."""
        return self.mode in (0, CALIBRATED) and not self.settings & _FIXED_POINT and self.settings & 0x3 != 2

    def pack(self, vectors: dict[str, np.ndarray], counter: int) -> bytes:
        """The data of a message: vectors of three, and the counter's 16 bits."""
        values = [float(v) for name in self.columns for v in vectors[name]]
        tail = struct.pack(">H", counter % _COUNTER_WRAP) if self.counts else b""
        return struct.pack(f">{len(values)}f", *values) + tail

    def parse(self, data: bytes) -> tuple[dict[str, np.ndarray], int | None] | None:
        """Vectors and counter of a message's data; None if its length is another."""
        if len(data) != self.length:
            return None
        n = 3 * len(self.columns)
        values = np.array(struct.unpack_from(f">{n}f", data))
        counter = struct.unpack_from(">H", data, 4 * n)[0] if self.counts else None
        return {name: values[3 * i : 3 * i + 3] for i, name in enumerate(self.columns)}, counter


@dataclass(frozen=True)
class Configuration:
    """What a device tells of itself.

    Attributes:
        device: its number.
        period: between two samples of the device, in 1/115200 s.
        skip: samples that are left out between two that are sent.
        layout: of the data messages.
    """

    device: int
    period: int
    skip: int
    layout: Layout

    @property
    def interval(self) -> float:
        """Between two data messages, s."""
        return self.period * (self.skip + 1) / TICKS

    def pack(self) -> bytes:
        """As data of a message."""
        layout = self.layout
        return _CONFIGURATION.pack(
            self.device, self.period, self.skip, 0, 0, 0, b"", b"", 1, self.device, layout.length, layout.mode,
            layout.settings,
        )  # fmt: skip

    @staticmethod
    def parse(data: bytes) -> Configuration:
        """From the data of a message.

        Raises:
            WireError: it is not as long as it should be, or says what cannot be.
        """
        if len(data) != _CONFIGURATION.size:
            raise WireError(f"a configuration of {len(data)} bytes; an MTi's has {_CONFIGURATION.size}")
        master, period, skip, *_, mode, settings = _CONFIGURATION.unpack(data)
        if not period:
            raise WireError("a configuration with a sampling period of 0")
        return Configuration(master, period, skip, Layout(mode, settings))
