"""A controller without a robot: its joints swing, what is written to it is kept."""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np
import pytest

from ur5_twin.errors import WireError
from ur5_twin.wire.server import Server
from ur5_twin.wire.state import State, Value
from ur5_twin.wire.version import version

T = TypeVar("T")


@dataclass(frozen=True)
class Said:
    """As the controller's own messages."""

    kind: str
    text: str
    timestamp: float
    number: int


class SwingingController:
    """As ``VirtualController`` to the ports; its signals are sines of its tick."""

    def __init__(self, series: str = "5.x", moving: bool = True) -> None:
        self.version = version(series)
        self.failure: str | None = None
        self.messages: deque[Any] = deque(maxlen=100)
        self.written: list[tuple[str, Value]] = []
        self.scripts: list[str] = []
        self.asked: list[Any] = []
        self.moving = moving
        self.scenario = SimpleNamespace(name="swing")
        self.operational_mode = "NONE"
        self.extra: dict[str, Value] = {}
        self.paused = threading.Event()
        self._actions: deque[tuple[Callable[[], Any], Future[Any]]] = deque()
        self._tick = 0
        self.state = self._next()

    def _next(self) -> State:
        time = 100.0 + self._tick * self.version.period
        phase = np.arange(6) + time
        signals: dict[str, Value] = {
            "timestamp": time,
            "actual_q": np.sin(phase),
            "actual_qd": np.cos(phase),
            "target_q": np.sin(phase) + 1e-3,
            "actual_TCP_pose": 0.1 * np.cos(phase),
            "joint_mode": np.full(6, 253),
            "robot_mode": 7,
            "safety_mode": 1,
            "safety_status": 1,
            "safety_status_bits": 1,
            "robot_status_bits": 3,
            "runtime_state": 2,
            "speed_scaling": 1.0,
            "output_int_register_3": -7,
            **self.extra,
        }
        return State(self._tick, time, signals, self.moving)

    def tick(self) -> State:
        while self._actions:
            action, future = self._actions.popleft()
            try:
                future.set_result(action())
            except Exception as error:
                future.set_exception(error)
        self._tick += 1
        self.state = self._next()
        return self.state

    def post(self, action: Callable[[], T]) -> Future[T]:
        if len(self._actions) >= 1000:
            raise WireError("too many actions wait")
        future: Future[T] = Future()
        self._actions.append((action, future))
        return future

    def _do(self, what: str, **changes: Value) -> None:
        self.asked.append(what)
        self.extra.update(changes)

    def power_on(self) -> None:
        self._do("power on", robot_mode=5)

    def power_off(self) -> None:
        self._do("power off", robot_mode=3, runtime_state=1)

    def brake_release(self) -> None:
        self._do("brake release", robot_mode=7)

    def play(self) -> None:
        if self.extra.get("robot_mode", 7) != 7:
            raise WireError("the arm has no power")
        self._do("play", runtime_state=2)

    def pause(self) -> None:
        self._do("pause", runtime_state=4)

    def stop(self) -> None:
        self._do("stop", runtime_state=1)

    def unlock_protective_stop(self) -> None:
        raise WireError("five seconds have not gone by")

    def close_popup(self) -> None:
        self._do("close popup")

    def restart_safety(self) -> None:
        self._do("restart safety")

    def write_input(self, name: str, value: Value) -> None:
        self.written.append((name, value))

    def say(self, kind: str, text: str) -> None:
        self.messages.append(Said(kind, text, self.state.timestamp, len(self.messages)))

    def run_script(self, text: str) -> None:
        self.scripts.append(text)


@pytest.fixture
def controller() -> SwingingController:
    return SwingingController()


@pytest.fixture
def swinging() -> type[SwingingController]:
    """The class, for tests that need another version."""
    return SwingingController


@pytest.fixture
def serve() -> Iterator[Callable[..., Server]]:
    """Start a server at free ports of 127.0.0.1; it is stopped after the test, and must leave no thread behind."""
    running: list[Server] = []
    before = set(threading.enumerate())

    def start(controller: Any, **options: Any) -> Server:
        from ur5_twin.wire.server import port_names

        options.setdefault("ports", dict.fromkeys(port_names(controller.version), 0))
        server = Server(controller, **options)
        server.start()
        running.append(server)
        return server

    yield start
    for server in running:
        server.stop()
    left = [thread for thread in set(threading.enumerate()) - before if thread.name.startswith("ur5-twin")]
    assert not left


class Bench:
    """A port in a loop of its own; states are published to it by hand."""

    def __init__(self, port: Any) -> None:
        self.port = port
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="ur5-twin bench")
        self._thread.start()
        self._tick = 0
        try:
            self.call(port.start())
        except BaseException:
            self._end()
            raise

    def call(self, work: Any) -> Any:
        """Run a coroutine in the loop."""
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(5.0)

    def publish(self, **readings: Any) -> None:
        """A tick with readings by device."""
        self._tick += 1
        state = State(self._tick, 100.0 + 0.008 * self._tick, {}, False, readings)

        async def do() -> None:
            self.port.publish(state)

        self.call(do())

    def settle(self) -> None:
        """Let the port take in what was sent to it."""
        self.call(asyncio.sleep(0.02))

    def close(self) -> None:
        self.call(self.port.close())
        self._end()

    def _end(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


@pytest.fixture
def bench() -> Iterator[Callable[[Any], Bench]]:
    """Start a port alone; it is closed after the test."""
    made: list[Bench] = []

    def make(port: Any) -> Bench:
        made.append(Bench(port))
        return made[-1]

    yield make
    for one in made:
        one.close()
