"""A running robot as a source: RTDE by ur_rtde, or the real-time interface. It only listens; nothing moves a robot."""

from __future__ import annotations

import os
import select
import socket
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from typing import IO, Any, Literal, TypeVar

import numpy as np

from ur5_twin.errors import MissingExtraError, WireError
from ur5_twin.sources.device import Rows
from ur5_twin.sources.link import Link, LinkLost
from ur5_twin.sources.realtime import PORT, RealtimeSource
from ur5_twin.sources.rtde_reader import SIGNALS, WIDTH

#: RTDE's port; ur_rtde knows no other.
RTDE_PORT = 30004
_PROBE = 2.0
#: From the start of the reader's process to its first row, s.
_TIMEOUT = 8.0
#: How often a receiver that gets nothing looks whether it is to stop, s.
_GLANCE = 0.1
_ROW_BYTES = 8 * WIDTH
#: Rows that may wait in the pipe while this process is busy, bytes: two seconds at 500 Hz.
_PIPE = 1 << 20

Interface = Literal["auto", "rtde", "realtime"]
S = TypeVar("S", bound=Link[Any])


class RtdeSource(Link[bytes]):
    """RTDE by ur_rtde's receive interface, each tick of the controller once.

    ur_rtde keeps the newest package only: of two that come together one is lost, and shows as a missing stamp.

    Args:
        host: address or name of the robot.
        frequency: Hz; None for the controller's own, 125 or 500.

    Raises:
        MissingExtraError: ur_rtde is not installed.
    """

    def __init__(self, host: str, frequency: float | None = None) -> None:
        if not has_ur_rtde():
            raise MissingExtraError("RTDE", "live")
        super().__init__(host)
        self.frequency = frequency
        self._reader: subprocess.Popen[bytes] | None = None
        self._said: IO[bytes] | None = None
        self._rest = b""

    def describe(self) -> str:
        """The stream in words, once connected."""
        asked = "" if self.frequency is None else f" at {self.frequency:g} Hz"
        return f"RTDE of {self.host}:{RTDE_PORT}{asked}"

    def _open(self) -> None:
        try:
            # ur_rtde would wait for a host that is not there, and not say what is wrong with one that is.
            socket.create_connection((self.host, RTDE_PORT), timeout=_PROBE).close()
        except OSError as error:
            raise WireError(f"{self.host}:{RTDE_PORT}: no RTDE ({error.strerror or error})") from None
        command = [sys.executable, "-m", "ur5_twin.sources.rtde_reader", self.host, str(self.frequency or -1.0)]
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed by _shut
        self._reader = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._said)
        assert self._reader.stdout is not None
        _enlarge(self._reader.stdout.fileno())
        self._rest = b""
        deadline = time.monotonic() + _TIMEOUT
        while not self._pieces_of(_GLANCE):
            if self._reader.poll() is not None:
                raise WireError(f"{self.host}:{RTDE_PORT}: {self._reason()}")
            if time.monotonic() > deadline:
                raise WireError(f"{self.host}:{RTDE_PORT}: connected, but no RTDE package came within {_TIMEOUT:g} s")
            if self._stopping.is_set():
                raise WireError("stopped")

    def _receive(self) -> None:
        assert self._reader is not None
        if not self._pieces_of(_GLANCE) and self._reader.poll() is not None:
            raise LinkLost(self._reason())

    def _pieces_of(self, timeout: float) -> bool:
        """Take in what the reader has written, waiting for it for a while; whether there was any."""
        assert self._reader is not None
        assert self._reader.stdout is not None
        pipe = self._reader.stdout.fileno()
        if not select.select([pipe], [], [], timeout)[0]:
            return False
        data = self._rest + os.read(pipe, _PIPE)
        whole = len(data) - len(data) % _ROW_BYTES
        self._rest = data[whole:]
        if not whole:
            return False
        self._put(data[:whole])
        return True

    def _decoded(self, pieces: list[bytes]) -> list[Rows]:
        values = np.frombuffer(b"".join(pieces)).reshape(-1, WIDTH)
        columns, first = {}, 2
        for name, (_, width) in SIGNALS.items():
            columns[name] = values[:, first : first + width]
            first += width
        return [Rows(values[:, 1], values[:, 0], columns)]

    def _reason(self) -> str:
        """The last thing the reader said."""
        if self._said is None:
            return "the reader has ended"
        self._said.seek(0)
        lines = self._said.read().decode(errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "the reader has ended")

    def _shut(self) -> None:
        if self._reader is not None:
            # It holds nothing that could be lost: rows are written as they come.
            self._reader.kill()
            self._reader.wait()
            for pipe in (self._reader.stdin, self._reader.stdout):
                if pipe is not None:
                    pipe.close()
            self._reader = None
        if self._said is not None:
            self._said.close()
            self._said = None


def connect(
    host: str, interface: Interface = "auto", *, port: int | None = None, frequency: float | None = None
) -> RtdeSource | RealtimeSource:
    """Connect to a robot and begin to receive.

    Args:
        host: address or name.
        interface: ``rtde``, ``realtime`` (30003), or ``auto``: RTDE if the controller has it and ur_rtde is installed.
        port: of the real-time interface, if it is not 30003.
        frequency: Hz of RTDE; None for the controller's own.

    Raises:
        WireError: nobody answers as a robot does.
        MissingExtraError: RTDE was asked for by name and ur_rtde is not installed.
    """
    if interface == "rtde":
        return _started(RtdeSource(host, frequency))
    if interface == "realtime":
        return _started(RealtimeSource(host, PORT if port is None else port))
    reasons = []
    if has_ur_rtde():
        try:
            return _started(RtdeSource(host, frequency))
        except WireError as error:
            reasons.append(str(error))
    else:
        reasons.append("RTDE needs the extra 'live': pip install 'ur5-twin[live]'")
    try:
        return _started(RealtimeSource(host, PORT if port is None else port))
    except WireError as error:
        raise WireError("; ".join([*reasons, str(error)])) from None


def has_ur_rtde() -> bool:
    """Whether ur_rtde is installed."""
    return find_spec("rtde_receive") is not None


def _started(source: S) -> S:
    source.start()
    return source


def _enlarge(pipe: int) -> None:
    """Let more rows wait in a pipe, where the system lets us."""
    try:
        import fcntl

        fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE)
    except (ImportError, AttributeError, OSError):
        pass
