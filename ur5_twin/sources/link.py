"""A connection that is made again when it is lost, and what came over it."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from typing import Generic, TypeVar

from ur5_twin.errors import WireError
from ur5_twin.sources.device import Rows

#: Waits between attempts to connect again, s; the last one for ever.
_BACK_OFF = (0.2, 0.5, 1.0, 2.0, 5.0)
#: Seconds that a robot may be silent before the connection counts as lost.
SILENCE = 2.0
#: Pieces that wait to be asked for, a package each or more; older ones are dropped, so that a reader who never asks
#: costs no memory.
_MOST_PIECES = 100_000
#: Sentences that wait to be asked for.
_MOST_NEWS = 1000


T = TypeVar("T")


class LinkLost(Exception):
    """A connection that had been made is no more; the text says how that showed."""


class Link(ABC, Generic[T]):
    """A device's stream: connects, receives in a thread of its own, and connects again with growing waits.

    Args:
        host: address or name of the robot, or where else the device is.

    Attributes:
        connected: whether the stream runs now.
        connections: how often it has been made.
    """

    device = "robot"

    def __init__(self, host: str) -> None:
        self.host = host
        self.connected = False
        self.connections = 0
        self._pieces: deque[T] = deque(maxlen=_MOST_PIECES)
        self._news: deque[str] = deque(maxlen=_MOST_NEWS)
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    @abstractmethod
    def describe(self) -> str:
        """The stream in words, once connected."""

    @abstractmethod
    def _open(self) -> None:
        """Connect; raises WireError."""

    @abstractmethod
    def _receive(self) -> None:
        """Put what comes by ``_put``, and come back often enough to be stopped; raises LinkLost."""

    @abstractmethod
    def _decoded(self, pieces: list[T]) -> list[Rows]:
        """What was put, one or more pieces, as rows."""

    @abstractmethod
    def _shut(self) -> None:
        """Drop the connection, in whatever state it is."""

    def start(self) -> None:
        """Connect, and begin to receive.

        Raises:
            WireError: there is nobody, or nobody who answers as a robot does.
        """
        try:
            self._open()
        except BaseException:
            self._shut()
            raise
        self._made()
        self._thread = threading.Thread(target=self._run, name=f"ur5-twin {self.device}", daemon=True)
        self._thread.start()

    def rows(self) -> list[Rows]:
        """What has come since the last call (``device.Device``)."""
        pieces = [self._pieces.popleft() for _ in range(len(self._pieces))]
        return self._decoded(pieces) if pieces else []

    def news(self) -> list[str]:
        """What has happened to the connection since the last call, in sentences."""
        return [self._news.popleft() for _ in range(len(self._news))]

    def close(self) -> None:
        """Disconnect; what has come until then can still be asked for."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self._shut()
        self.connected = False

    def _put(self, piece: T) -> None:
        self._pieces.append(piece)

    def _say(self, what: str) -> None:
        self._news.append(what)

    def _made(self) -> None:
        self.connections += 1
        self.connected = True

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                while not self._stopping.is_set():
                    self._receive()
            except LinkLost as lost:
                self.connected = False
                self._shut()
                self._say(f"connection to {self.host} lost: {lost}")
                self._again()

    def _again(self) -> None:
        """Connect again, however long that takes."""
        lost, attempt = time.monotonic(), 0
        while not self._stopping.wait(_BACK_OFF[min(attempt, len(_BACK_OFF) - 1)]):
            attempt += 1
            try:
                self._open()
            except WireError:
                self._shut()
                continue
            self._made()
            self._say(f"connected to {self.host} again after {time.monotonic() - lost:.1f} s")
            return
