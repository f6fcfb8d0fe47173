"""An Xsens MTi of the cell, behind a pseudo-terminal: what a program opens as the device's serial port."""

from __future__ import annotations

import asyncio
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from ur5_twin.errors import WireError
from ur5_twin.wire import xbus
from ur5_twin.wire.state import State
from ur5_twin.wire.xbus import Configuration, ErrorCode, Frames, Layout, Message

_DEVICE = "imu"
_NUMBER = 0x00300CE1
_FIRMWARE = bytes((2, 8, 1))
#: Periods that the device can sample with, 1/115200 s: 512 down to 10 Hz.
_SHORTEST, _LONGEST = 225, 11520
#: A device whose readings stop for longer than this goes on with the next one, s: nothing is made up for the gap.
_GAP = 1.0
#: What is read at once, bytes.
_CHUNK = 4096


class MTiPort:
    """The device: it measures from the start on, and can be told to go to its configuration and back.

    A message goes out each period of the device's own clock, with the cell's reading nearest to that time; so a client
    may set any period that the device has. The counter counts samples, those left out by the skip factor too. If
    nobody reads, what waits is thrown away when the terminal is full, as a serial line would lose it.

    Args:
        rate: samples a second until a client sets another.
    """

    name = "mti"
    #: Who has a terminal open cannot be told.
    connected = None

    def __init__(self, rate: float = 100.0) -> None:
        period = round(xbus.TICKS / rate) if rate > 0.0 else 0
        if not _SHORTEST <= period <= _LONGEST:
            raise WireError(
                f"MTi: {rate:g} samples/s; it takes {xbus.TICKS / _LONGEST:g} to {xbus.TICKS / _SHORTEST:g}"
            )
        self.configuration = Configuration(_NUMBER, period, 0, Layout())
        self.measuring = True
        self.overruns = 0
        self._master: int | None = None
        self._slave: int | None = None
        self._path = ""
        self._frames = Frames()
        self._unsent = b""
        self._held: dict[str, np.ndarray] | None = None
        self._first = self._held_at = 0.0
        self._sample = 0

    @property
    def address(self) -> str:
        """Path of the serial port to open; empty before the start."""
        return self._path

    async def start(self) -> None:
        """Make the pseudo-terminal.

        Raises:
            WireError: this system has none.
        """
        try:
            import pty
            import tty

            self._master, self._slave = pty.openpty()
        except (ImportError, OSError) as error:
            raise WireError(f"mti: no pseudo-terminal to be had ({error})") from None
        # The other end stays open here too, or the terminal would hang up whenever a client leaves.
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._path = os.ttyname(self._slave)
        asyncio.get_running_loop().add_reader(self._master, self._read)

    def publish(self, state: State) -> None:
        """Send what is due by the readings of a tick."""
        readings = state.readings.get(_DEVICE)
        if readings is None:
            return
        for k, time in enumerate(readings["time"].tolist()):
            reading = {name: readings[name][k] for name in self.configuration.layout.columns}
            if self._held is None:
                self._first = time
            else:
                # Up to the middle between two readings the former is nearer.
                self._send_until(0.5 * (self._held_at + time) - self._first)
            self._held, self._held_at = reading, time

    async def close(self) -> None:
        """Take the pseudo-terminal away."""
        if self._master is not None and self._slave is not None:
            asyncio.get_running_loop().remove_reader(self._master)
            os.close(self._master)
            os.close(self._slave)
            self._master = self._slave = None

    def _send_until(self, time: float) -> None:
        """Send the held reading at each period up to a time of the device's clock, s since its first reading."""
        assert self._held is not None
        period = self.configuration.period / xbus.TICKS
        if time - self._sample * period > _GAP:
            self._sample = math.floor(time / period)
        while self._sample * period < time:
            if self.measuring and self._sample % (self.configuration.skip + 1) == 0:
                self._write(xbus.pack(Message.DATA, self.configuration.layout.pack(self._held, self._sample)))
            self._sample += 1

    def _read(self) -> None:
        assert self._master is not None
        try:
            data = os.read(self._master, _CHUNK)
        except OSError:
            return
        for frame in self._frames.feed(data):
            self._answer(frame.message, frame.data)

    def _answer(self, message: int, data: bytes) -> None:
        if message == Message.GO_TO_CONFIG:
            self.measuring = False
            self._acknowledge(message)
        elif self.measuring:
            # A device that measures hears nothing else.
            return
        elif message in (Message.GO_TO_MEASUREMENT, Message.RESET):
            self._acknowledge(message)
            self.measuring = True
        elif message in _TOLD:
            self._acknowledge(message, _TOLD[message](self.configuration))
        elif message in _SET:
            self._set(message, data)
        elif message != Message.WAKE_UP + 1:
            self._write(xbus.pack(Message.ERROR, bytes([ErrorCode.MESSAGE])))

    def _set(self, message: int, data: bytes) -> None:
        """Set something, or without data tell what it is."""
        configuration = self.configuration
        if not data:
            self._acknowledge(message, _SET[message](configuration).to_bytes(2, "big"))
            return
        value = int.from_bytes(data, "big")
        mode, settings = configuration.layout.mode, configuration.layout.settings
        error = ErrorCode.PARAMETER
        match message:
            case Message.SET_PERIOD:
                made, error = replace(configuration, period=value), ErrorCode.PERIOD
                sound = _SHORTEST <= value <= _LONGEST
            case Message.SET_OUTPUT_SKIP_FACTOR:
                made = replace(configuration, skip=value)
                sound = value < 0xFFFF
            case Message.SET_OUTPUT_MODE:
                made = replace(configuration, layout=Layout(value, settings))
                sound = made.layout.understood
            case _:
                made = replace(configuration, layout=Layout(mode, value))
                sound = made.layout.understood
        if not sound or len(data) not in (2, 4):
            self._write(xbus.pack(Message.ERROR, bytes([error])))
            return
        if made.period != configuration.period:
            # The counter goes on, and so does the clock.
            self._first += self._sample * (configuration.period - made.period) / xbus.TICKS
        # The held reading has the columns of before.
        if made.layout.columns != configuration.layout.columns:
            self._held = None
            self._sample = 0
        self.configuration = made
        self._acknowledge(message)

    def _acknowledge(self, message: int, data: bytes = b"") -> None:
        self._write(xbus.pack(message + 1, data))

    def _write(self, data: bytes) -> None:
        assert self._master is not None
        assert self._slave is not None
        data = self._unsent + data
        try:
            self._unsent = data[os.write(self._master, data) :]
        except BlockingIOError:
            import termios

            self.overruns += 1
            self._unsent = b""
            termios.tcflush(self._slave, termios.TCIFLUSH)
        except OSError:
            self._unsent = b""


#: What a device tells when asked, and what it can be told: message -> its value.
_TOLD: Mapping[int, Callable[[Configuration], bytes]] = {
    Message.REQ_DEVICE_ID: lambda known: known.device.to_bytes(4, "big"),
    Message.REQ_DATA_LENGTH: lambda known: known.layout.length.to_bytes(2, "big"),
    Message.REQ_CONFIGURATION: lambda known: known.pack(),
    Message.REQ_FIRMWARE: lambda _known: _FIRMWARE,
}
_SET: Mapping[int, Callable[[Configuration], int]] = {
    Message.SET_PERIOD: lambda known: known.period,
    Message.SET_OUTPUT_SKIP_FACTOR: lambda known: known.skip,
    Message.SET_OUTPUT_MODE: lambda known: known.layout.mode,
    Message.SET_OUTPUT_SETTINGS: lambda known: known.layout.settings,
}
