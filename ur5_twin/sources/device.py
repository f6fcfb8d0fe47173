"""What every device that is listened to has in common, the robot and the sensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np


class Row(NamedTuple):
    """What a device reported at once.

    Attributes:
        time: s on the device's own clock.
        host: POSIX time of arrival, s.
        columns: name -> (width,).
    """

    time: float
    host: float
    columns: Mapping[str, np.ndarray]


class Device(Protocol):
    """A device that reports rows.

    Attributes:
        name: ``robot``, ``ft`` or ``imu``.
        columns: what its rows hold: name -> width; known after ``start``.
        lost: rows that it is known to have sent and that did not come.
    """

    @property
    def name(self) -> str: ...

    @property
    def columns(self) -> Mapping[str, int]: ...

    @property
    def lost(self) -> int: ...

    def start(self) -> None:
        """Connect.

        Raises:
            WireError: it cannot be reached.
        """
        ...

    def rows(self) -> list[Row]:
        """What has come since the last call, waiting some milliseconds for it at most.

        Raises:
            WireError: the connection is lost; ``start`` may be tried again.
        """
        ...

    def close(self) -> None:
        """Disconnect."""
        ...
