"""The ports of one controller, and the thread that ticks."""

from __future__ import annotations

import asyncio
import contextlib
import sys
import threading
import time
from collections import deque
from collections.abc import Coroutine, Iterable, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np

from ur5_twin.errors import TwinError, WireError, unknown
from ur5_twin.wire.dashboard import DashboardPort
from ur5_twin.wire.primary import PrimaryPort
from ur5_twin.wire.realtime import RealtimePort
from ur5_twin.wire.rtde import RtdePort
from ur5_twin.wire.state import State
from ur5_twin.wire.streams import Port, TcpPort
from ur5_twin.wire.version import Version

if TYPE_CHECKING:
    from ur5_twin.wire.controller import VirtualController

T = TypeVar("T")

#: States that may wait for the ports before the tick thread leaves one out (in real time) or waits (otherwise).
_MOST_WAITING = 64
#: The same when the simulation runs as fast as it can.
_MOST_WAITING_FAST = 4
#: Ticks of which the intervals are kept.
_KEPT = 30_000
#: A tick thread that wakes up gets the interpreter within this, s; Python's own 5 ms are more than two ticks.
_SWITCH = 0.0002
#: Closing takes no longer than this, s.
_CLOSING = 5.0

#: Ports by name, with the robot's number, in the order they are shown.
NUMBERS = {
    "dashboard": 29999,
    "primary": 30001,
    "secondary": 30002,
    "realtime": 30003,
    "rtde": 30004,
    "primary_readonly": 30011,
    "secondary_readonly": 30012,
    "realtime_readonly": 30013,
}


@dataclass(frozen=True)
class Statistics:
    """How the server has kept up.

    Attributes:
        ticks: since it started.
        behind: ticks that came more than a period late; the deadlines after such a one start anew from it.
        not_published: ticks that the ports were too busy to send.
        interval: (n,) s between the last ticks.
        busy: share of a period that a tick takes.
        packages_dropped: packages that slow readers missed.
        clients_cut: clients that were disconnected.
        clients: port's name -> how many clients it has now; ports that cannot know are left out.
    """

    ticks: int
    behind: int
    not_published: int
    interval: np.ndarray
    busy: float
    packages_dropped: int
    clients_cut: int
    clients: dict[str, int]


class Server:
    """A controller behind its ports.

    One thread ticks, the other runs all ports in an asyncio loop. A context manager: it starts on entry, and leaves no
    thread and no socket behind.

    Args:
        controller: the controller; from the start on only the server's thread may tick it.
        bind: address to listen at.
        ports: name of a port -> TCP port, where it is not to be the robot's own; 0 takes a free one.
        devices: further ports that are to run beside the controller's, such as sensors.
        late_packages: whether the real-time interface's packages come as late and as split as on the thesis' robot.
        realtime: a tick each period; False: as fast as the simulation goes, though never faster than the ports.
    """

    def __init__(
        self,
        controller: VirtualController,
        *,
        bind: str = "127.0.0.1",
        ports: Mapping[str, int] | None = None,
        devices: Iterable[Port] = (),
        late_packages: bool = False,
        realtime: bool = True,
    ) -> None:
        self.controller = controller
        self._realtime = realtime
        self._ports = [*_build(controller, bind, ports or {}, late_packages), *devices]
        #: Those that still publish.
        self._published = list(self._ports)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._io: threading.Thread | None = None
        self._ticker: threading.Thread | None = None
        self._stopping = threading.Event()
        self._room = threading.Condition()
        self._waiting = 0
        self._ended = threading.Event()
        self._failure: str | None = None
        self._ticks = self._behind = self._left_out = 0
        self._busy = 0.0
        self._intervals: deque[float] = deque(maxlen=_KEPT)
        self._switch = sys.getswitchinterval()

    @property
    def addresses(self) -> dict[str, Any]:
        """Port's name -> (host, TCP port) that it listens at."""
        return {port.name: port.address for port in self._ports}

    @property
    def failure(self) -> str | None:
        """Why the simulation has stopped, if it has; the ports stay open and publish nothing new."""
        return self._failure

    @property
    def statistics(self) -> Statistics:
        """How it has kept up so far."""
        tcp = [port for port in self._ports if isinstance(port, TcpPort)]
        return Statistics(
            ticks=self._ticks,
            behind=self._behind,
            not_published=self._left_out,
            interval=np.array(list(self._intervals)),
            busy=self._busy / max(self._ticks, 1) / self.controller.version.period,
            packages_dropped=sum(port.packages_dropped for port in tcp),
            clients_cut=sum(port.clients_cut for port in tcp),
            clients={port.name: found for port in self._ports if (found := port.connected) is not None},
        )

    def start(self) -> None:
        """Open the ports and begin to tick.

        Raises:
            WireError: a port cannot be had; none is left open then.
        """
        if self._io is not None:
            raise WireError("the server runs already")
        self._stopping.clear()
        self._ended.clear()
        self._loop = asyncio.new_event_loop()
        self._io = threading.Thread(target=self._run_loop, args=(self._loop,), name="ur5-twin ports", daemon=True)
        self._io.start()
        try:
            self._in_loop(self._open())
        except BaseException:
            self._stop_io()
            raise
        self._switch = sys.getswitchinterval()
        sys.setswitchinterval(min(self._switch, _SWITCH))
        self._ticker = threading.Thread(target=self._run_ticks, name="ur5-twin ticks", daemon=True)
        self._ticker.start()

    def stop(self) -> None:
        """Stop ticking, close the ports and both threads."""
        self._stopping.set()
        with self._room:
            self._room.notify_all()
        if self._ticker is not None:
            self._ticker.join()
            self._ticker = None
            sys.setswitchinterval(self._switch)
        if self._io is not None:
            self._stop_io()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the ticks end by themselves (see ``failure``).

        Args:
            timeout: s; None waits for ever.

        Returns:
            Whether they have ended.
        """
        return self._ended.wait(timeout)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.stop()

    # The I/O thread.

    @staticmethod
    def _run_loop(loop: asyncio.AbstractEventLoop) -> None:
        asyncio.set_event_loop(loop)
        try:
            loop.run_forever()
        finally:
            left = asyncio.all_tasks(loop)
            for task in left:
                task.cancel()
            loop.run_until_complete(asyncio.gather(*left, return_exceptions=True))
            loop.run_until_complete(loop.shutdown_asyncgens())
            loop.run_until_complete(loop.shutdown_default_executor())
            asyncio.set_event_loop(None)
            loop.close()

    def _in_loop(self, work: Coroutine[Any, Any, T]) -> T:
        assert self._loop is not None
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()

    async def _open(self) -> None:
        opened: list[Port] = []
        try:
            for port in self._ports:
                await port.start()
                opened.append(port)
        except BaseException:
            for port in opened:
                await port.close()
            raise

    async def _close(self) -> None:
        for port in self._ports:
            with contextlib.suppress(OSError, asyncio.TimeoutError):
                await asyncio.wait_for(port.close(), _CLOSING)

    def _stop_io(self) -> None:
        assert self._loop is not None
        assert self._io is not None
        if self._ticker is None and self._io.is_alive():
            self._in_loop(self._close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._io.join()
        self._io = self._loop = None
        self._waiting = 0

    def _publish(self, state: State) -> None:
        try:
            for port in list(self._published):
                try:
                    port.publish(state)
                except Exception as error:  # whatever it is: one port's fault must not silence the others
                    self._published.remove(port)
                    said = f"port {port.name} publishes no more: {type(error).__name__}: {error}"
                    self.controller.post(lambda said=said: self.controller.say("error", said))
        finally:
            with self._room:
                self._waiting -= 1
                self._room.notify()

    # The tick thread.

    def _run_ticks(self) -> None:
        try:
            self._tick_on()
        except TwinError as error:
            self._failure = str(error)
        except Exception as error:
            self._failure = f"{type(error).__name__}: {error}"
            raise
        finally:
            self._ended.set()

    def _tick_on(self) -> None:
        period = self.controller.version.period
        deadline = last = time.perf_counter()
        while not self._stopping.is_set():
            if self._realtime:
                deadline += period
                left = deadline - time.perf_counter()
                if left > 0:
                    time.sleep(left)
                elif left < -period:
                    # What is lost is lost: a controller that raced to make up for it would tick out of time.
                    self._behind += 1
                    deadline -= left
            begun = time.perf_counter()
            state = self.controller.tick()
            self._busy += time.perf_counter() - begun
            self._ticks += 1
            self._intervals.append(begun - last)
            last = begun
            self._hand_over(state)
            if self.controller.failure is not None:
                self._failure = self.controller.failure
                return

    def _hand_over(self, state: State) -> None:
        """Give a tick's state to the ports."""
        assert self._loop is not None
        with self._room:
            if self._realtime and self._waiting >= _MOST_WAITING:
                self._left_out += 1
                return
            while not self._realtime and self._waiting >= _MOST_WAITING_FAST and not self._stopping.is_set():
                self._room.wait()
            self._waiting += 1
        self._loop.call_soon_threadsafe(self._publish, state)


def _build(controller: VirtualController, bind: str, numbers: Mapping[str, int], late: bool) -> list[Port]:
    """The ports that a version of the controller has."""
    for name, number in numbers.items():
        if name not in NUMBERS:
            raise WireError(unknown("port", name, NUMBERS))
        if not 0 <= number <= 0xFFFF:
            raise WireError(f"{name}={number}: a TCP port is between 0 (a free one) and 65535")
    chosen = NUMBERS | dict(numbers)
    return [_port(controller, name, bind, chosen[name], late) for name in port_names(controller.version)]


def port_names(version: Version) -> list[str]:
    """The ports that a version of the controller has."""
    return [name for name in NUMBERS if name != "rtde" or version.has_rtde]


def _port(controller: VirtualController, name: str, bind: str, number: int, late: bool) -> Port:
    kind, _, suffix = name.partition("_")
    only = suffix == "readonly"
    match kind:
        case "dashboard":
            return DashboardPort(controller, bind, number)
        case "primary" | "secondary":
            return PrimaryPort(controller, bind, number, secondary=kind == "secondary", read_only=only)
        case "rtde":
            return RtdePort(controller, bind, number)
        case "realtime":
            return RealtimePort(controller, bind, number, read_only=only, late_packages=late)
    raise AssertionError(name)
