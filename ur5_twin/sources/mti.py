"""An Xsens MTi of the first generation as a source: frames over a serial port."""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING

import numpy as np

from ur5_twin.errors import MissingExtraError, WireError
from ur5_twin.sources.device import Rows
from ur5_twin.sources.link import SILENCE, Link, LinkLost
from ur5_twin.wire import xbus
from ur5_twin.wire.xbus import BAUD, Configuration, Frame, Frames, Layout, Message

if TYPE_CHECKING:
    from serial import Serial

#: How long an answer may take and how often is asked, s and times; from the start of measuring to a first row, s.
_ANSWER, _ATTEMPTS, _TIMEOUT = 0.5, 4, 3.0
#: How often a receiver that gets nothing looks whether it is to stop, s.
_GLANCE = 0.1
_WRAP = 1 << 16
_WANTED = Layout()


class MTiSource(Link[Rows]):
    """The calibrated data of one MTi: imu_acc in m/s^2, imu_gyro in rad/s, imu_mag in the device's unit.

    Time is the device's count of samples times its period. Where the device does not send calibrated data with a
    counter as floats it is set to, and keeps that. After a connection is made again the time goes on by the host's.

    Args:
        path: of the serial port, /dev/ttyUSB0.
        baud: of the port.
        rate: samples a second to set; None leaves the device's own.

    Attributes:
        lost: samples that the device counted and that never came.
        configuration: what the device said of itself; None before the connection.
    """

    device = "imu"

    def __init__(self, path: str, *, baud: int = BAUD, rate: float | None = None) -> None:
        super().__init__(path)
        self.baud, self.rate = baud, rate
        self.lost = 0
        self.configuration: Configuration | None = None
        self._serial: Serial | None = None
        self._frames = Frames()
        self._heard = 0.0
        self._counter: int | None = None
        self._samples = 0
        self._passed_over = 0
        self._others = 0

    def describe(self) -> str:
        """The stream in words, once connected."""
        known = self.configuration
        return f"MTi at {self.host}" + ("" if known is None else f", {1.0 / known.interval:g} samples/s")

    def _open(self) -> None:
        try:
            from serial import Serial, SerialException
        except ImportError:
            raise MissingExtraError("A serial port", "live") from None
        try:
            self._serial = Serial(self.host, self.baud, timeout=_GLANCE, write_timeout=_ANSWER, exclusive=True)
            # What lay in the system's buffer is of another time.
            self._serial.reset_input_buffer()
            self._frames = Frames()
            self._configure()
            self._ask(Message.GO_TO_MEASUREMENT)
            before, deadline = self._heard, time.monotonic() + _TIMEOUT
            self._begin()
            while self._heard == before:
                if time.monotonic() > deadline:
                    raise WireError(f"{self.host}: the MTi answers, but sent no data within {_TIMEOUT:g} s")
                self._check_stop()
                self._take()
        except (SerialException, OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise WireError(f"{self.host}: no MTi, the serial port cannot be used ({why})") from None

    def _configure(self) -> None:
        self._ask(Message.GO_TO_CONFIG)
        known = Configuration.parse(self._ask(Message.REQ_CONFIGURATION))
        wanted = known.period if self.rate is None else round(xbus.TICKS / self.rate)
        settings = [
            (Message.SET_OUTPUT_MODE, known.layout.mode, _WANTED.mode, 2),
            (Message.SET_OUTPUT_SETTINGS, known.layout.settings, _WANTED.settings, 4),
            (Message.SET_OUTPUT_SKIP_FACTOR, known.skip, 0, 2),
            (Message.SET_PERIOD, known.period, wanted, 2),
        ]
        for message, now, value, size in settings:
            if now != value:
                self._ask(message, value.to_bytes(size, "big"))
        known = Configuration.parse(self._ask(Message.REQ_CONFIGURATION))
        if known.layout != _WANTED:
            raise WireError(
                f"{self.host}: the MTi does not take the output that is needed: asked for mode {_WANTED.mode:#06x} and "
                f"settings {_WANTED.settings:#010x}, it has {known.layout.mode:#06x} and {known.layout.settings:#010x}"
            )
        self.configuration = known

    def _ask(self, message: Message, data: bytes = b"") -> bytes:
        """Send a message until it is acknowledged; the data of the acknowledgement."""
        assert self._serial is not None
        for _ in range(_ATTEMPTS):
            self._serial.write(xbus.pack(message, data))
            deadline = time.monotonic() + _ANSWER
            while time.monotonic() < deadline:
                self._check_stop()
                for frame in self._read():
                    if frame.message == message + 1:
                        return frame.data
                    if frame.message == Message.ERROR:
                        code = frame.data[0] if frame.data else 0
                        raise WireError(f"{self.host}: the MTi refuses {message.name} (error {code:#04x})")
        raise WireError(
            f"{self.host}: no answer of an MTi to {message.name} at {self.baud} baud; is this its port, and its baud "
            "rate?"
        )

    def _check_stop(self) -> None:
        if self._stopping.is_set():
            raise WireError("stopped")

    def _begin(self) -> None:
        """The counter may begin anew: time goes on by what the host's clock says."""
        assert self.configuration is not None
        self._counter = None
        if self._heard:
            self._samples += max(1, round((time.monotonic() - self._heard) / self.configuration.interval))

    def _read(self) -> list[Frame]:
        assert self._serial is not None
        return self._frames.feed(self._serial.read(max(1, self._serial.in_waiting)))

    def _receive(self) -> None:
        from serial import SerialException

        try:
            taken = self._take()
        except (SerialException, OSError, TypeError) as error:
            # pyserial trips over its own None where the port vanishes in the middle of a read.
            raise LinkLost(str(error)) from None
        if not taken and time.monotonic() - self._heard > SILENCE:
            raise LinkLost(f"silent for {SILENCE:g} s")

    def _take(self) -> bool:
        """Take in what has come, waiting for it for a while; whether there was any row."""
        assert self.configuration is not None
        found: list[dict[str, np.ndarray]] = []
        samples: list[int] = []
        for frame in self._read():
            parsed = _WANTED.parse(frame.data) if frame.message == Message.DATA else None
            if parsed is None or parsed[1] is None:
                self._others += 1
                continue
            samples.append(self._unwrapped(parsed[1]))
            found.append(parsed[0])
        self._tell_of_the_rest()
        if not found:
            return False
        self._heard = time.monotonic()
        columns = {name: np.array([vectors[name] for vectors in found]) for name in _WANTED.columns}
        stamps = np.array(samples) * self.configuration.interval
        self._put(Rows(stamps, np.full(len(stamps), self._heard), columns))
        return True

    def _unwrapped(self, counter: int) -> int:
        """The device's count beyond its 16 bits."""
        if self._counter is not None:
            step = (counter - self._counter) % _WRAP
            self.lost += max(0, step - 1)
            self._samples += step
        self._counter = counter
        return self._samples

    def _tell_of_the_rest(self) -> None:
        if self._frames.skipped > self._passed_over:
            self._say(f"{self._frames.skipped - self._passed_over} bytes between frames are none: passed over")
        self._passed_over = self._frames.skipped
        if self._others:
            self._say(f"{self._others} messages are no data as it was asked for: passed over")
            self._others = 0

    def _decoded(self, pieces: list[Rows]) -> list[Rows]:
        return pieces

    def _shut(self) -> None:
        if self._serial is not None:
            with contextlib.suppress(OSError):
                self._serial.close()
            self._serial = None
