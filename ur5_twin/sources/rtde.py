"""The robot over RTDE (30004), by ur_rtde's receive interface; the only place that imports it."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np

from ur5_twin.errors import MissingExtraError, WireError
from ur5_twin.sources.device import Row

#: Column -> ur_rtde's getter.
_GETTERS = {
    "target_q": "getTargetQ",
    "target_qd": "getTargetQd",
    "target_qdd": "getTargetQdd",
    "target_current": "getTargetCurrent",
    "target_moment": "getTargetMoment",
    "actual_q": "getActualQ",
    "actual_qd": "getActualQd",
    "actual_current": "getActualCurrent",
    "actual_TCP_pose": "getActualTCPPose",
    "actual_TCP_speed": "getActualTCPSpeed",
    "actual_TCP_force": "getActualTCPForce",
    "actual_tool_accelerometer": "getActualToolAccelerometer",
}
#: Between two looks at the stamp, and how long none may come before the connection counts as lost, s.
_LOOK, _SILENCE = 0.0003, 1.0
#: Looks until a row is whole: ur_rtde may take in the next package between two getters.
_TRIES = 5
#: Rows that wait to be taken; more are lost.
_WAITING = 20_000
#: The thread that looks must get the interpreter within a fraction of a tick, s; Python's own 5 ms are two ticks.
_SWITCH = 0.0003


class RtdeSource:
    """A robot with RTDE: CB3 from 3.3 on at 125 Hz, the e-Series at 500 Hz. It only reads.

    ur_rtde takes in packages in a thread of its own and keeps the newest; if several wait it drops the older ones, as
    it is made to. A thread of ours looks at the stamp three thousand times a second and copies each new row, whatever
    the rest of the program does. A row is read between two equal stamps, so that it is one tick's. What was dropped
    shows in the stamps and is counted by who keeps the clock (``live.clock``).

    Args:
        host: name or address; the port is RTDE's own, 30004.

    Attributes:
        name, columns: as of ``device.Device``.
        lost: rows that were not taken in time, or that a package came into each time they were read.

    Raises:
        MissingExtraError: ur_rtde is not installed.
    """

    name = "robot"

    def __init__(self, host: str) -> None:
        if find_spec("rtde_receive") is None:
            raise MissingExtraError("RTDE", "live")
        self.host = host
        self.columns = {name: 3 if name == "actual_tool_accelerometer" else 6 for name in _GETTERS}
        self.lost = 0
        self._robot: Any = None
        self._rows: deque[Row] = deque()
        self._came = threading.Event()
        self._closing = threading.Event()
        self._reader: threading.Thread | None = None

    def start(self) -> None:
        """Connect.

        Raises:
            WireError: nobody answers.
        """
        from rtde_receive import RTDEReceiveInterface

        self.close()
        sys.setswitchinterval(min(_SWITCH, sys.getswitchinterval()))
        try:
            self._robot = RTDEReceiveInterface(self.host, -1.0, ["timestamp", *_GETTERS])
        except RuntimeError as error:
            raise WireError(
                f"{self.host}, port 30004: no RTDE ({' '.join(str(error).split())}); controllers before 3.3 have only "
                "the real-time interface (--port realtime)"
            ) from None
        self._rows.clear()
        self._closing.clear()
        self._reader = threading.Thread(target=self._read, args=(self._robot,), name="rtde", daemon=True)
        self._reader.start()

    def rows(self) -> list[Row]:
        """What has come since the last call, or comes within some milliseconds (``device.Device``).

        Raises:
            WireError: the connection is lost.
        """
        if self._reader is None:
            raise WireError(f"{self.host}: not connected")
        self._came.wait(0.005)
        self._came.clear()
        found = [self._rows.popleft() for _ in range(len(self._rows))]
        if not found and not self._reader.is_alive():
            self.close()
            raise WireError(f"{self.host}: the connection is lost")
        return found

    def close(self) -> None:
        """Disconnect."""
        self._closing.set()
        if self._reader is not None:
            self._reader.join(timeout=1.0)
            self._reader = None
        if self._robot is not None:
            with contextlib.suppress(RuntimeError):
                self._robot.disconnect()
            self._robot = None

    def _read(self, robot: Any) -> None:
        """Copy rows until the connection is lost or closed."""
        getters = [(name, getattr(robot, getter)) for name, getter in _GETTERS.items()]
        stamp_of: Callable[[], float] = robot.getTimestamp
        last, since = stamp_of(), time.monotonic()
        while not self._closing.is_set():
            stamp = stamp_of()
            if stamp == last:
                if time.monotonic() - since > _SILENCE:
                    return
                time.sleep(_LOOK)
                continue
            for _ in range(_TRIES):
                columns = {name: np.array(get()) for name, get in getters}
                again = stamp_of()
                if again == stamp:
                    if len(self._rows) < _WAITING:
                        self._rows.append(Row(stamp, time.time(), columns))
                    else:
                        self.lost += 1
                    break
                stamp = again
            else:
                self.lost += 1
            last, since = stamp, time.monotonic()
            self._came.set()
