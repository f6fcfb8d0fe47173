"""The robot over RTDE (30004), by ur_rtde's receive interface; the only place that imports it."""

from __future__ import annotations

import contextlib
import time
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


class RtdeSource:
    """A robot with RTDE: CB3 from 3.3 on at 125 Hz, the e-Series at 500 Hz. It only reads.

    ur_rtde takes in packages in a thread of its own and keeps the newest; if several wait it drops the older ones, as
    it is made to. A row is read between two equal stamps, so that it is one tick's, and each stamp gives one row. What
    was dropped shows in the stamps and is counted by who keeps the clock (``live.clock``).

    Args:
        host: name or address; the port is RTDE's own, 30004.

    Attributes:
        name, columns: as of ``device.Device``.
        lost: 0; see above.
        torn: rows given up because a package came between the getters each time.

    Raises:
        MissingExtraError: ur_rtde is not installed.
    """

    name = "robot"

    def __init__(self, host: str) -> None:
        if find_spec("rtde_receive") is None:
            raise MissingExtraError("RTDE", "live")
        self.host = host
        self.columns = {name: 3 if name == "actual_tool_accelerometer" else 6 for name in _GETTERS}
        self.lost = self.torn = 0
        self._robot: Any = None
        self._stamp = -np.inf
        self._since = 0.0
        self._getters: list[tuple[str, Callable[[], list[float]]]] = []

    def start(self) -> None:
        """Connect.

        Raises:
            WireError: nobody answers.
        """
        from rtde_receive import RTDEReceiveInterface

        self.close()
        try:
            self._robot = RTDEReceiveInterface(self.host, -1.0, ["timestamp", *_GETTERS])
        except RuntimeError as error:
            raise WireError(
                f"{self.host}, port 30004: no RTDE ({' '.join(str(error).split())}); controllers before 3.3 have only "
                "the real-time interface (--port realtime)"
            ) from None
        self._getters = [(name, getattr(self._robot, getter)) for name, getter in _GETTERS.items()]
        self._stamp, self._since = -np.inf, time.monotonic()

    def rows(self) -> list[Row]:
        """The next row, if one comes within some milliseconds (``device.Device``).

        Raises:
            WireError: the connection is lost.
        """
        if self._robot is None:
            raise WireError(f"{self.host}: not connected")
        until = time.monotonic() + 0.005
        while (stamp := self._robot.getTimestamp()) == self._stamp:
            now = time.monotonic()
            if now - self._since > _SILENCE or not self._robot.isConnected():
                self.close()
                raise WireError(f"{self.host}: the connection is lost")
            if now > until:
                return []
            time.sleep(_LOOK)
        for _ in range(_TRIES):
            columns = {name: np.array(get()) for name, get in self._getters}
            again = self._robot.getTimestamp()
            if again == stamp:
                self._stamp, self._since = stamp, time.monotonic()
                return [Row(stamp, time.time(), columns)]
            stamp = again
        self.torn += 1
        return []

    def close(self) -> None:
        """Disconnect."""
        if self._robot is not None:
            with contextlib.suppress(RuntimeError):
                self._robot.disconnect()
            self._robot = None
