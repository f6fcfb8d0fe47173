"""What every live source has in common, a robot or a sensor: it is started, asked for what has come, and closed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np


class Rows(NamedTuple):
    """What a device has reported since it was last asked, in the order of arrival.

    Attributes:
        time: (n,) s on the device's own clock, as it came: it may repeat, jump or be NaN.
        arrival: (n,) s on the host's monotonic clock (``time.monotonic``) at which each row was in.
        columns: name -> (n, width).
    """

    time: np.ndarray
    arrival: np.ndarray
    columns: Mapping[str, np.ndarray]

    def __bool__(self) -> bool:
        return len(self.time) > 0


class Device(Protocol):
    """A live source. Its rows are gathered in a thread of its own, so that none waits for whoever asks."""

    @property
    def device(self) -> str:
        """The name of its table: ``robot``, ``ft`` or ``imu``."""
        ...

    def start(self) -> None:
        """Connect.

        Raises:
            WireError: there is nobody, or not what was expected.
        """
        ...

    def rows(self) -> list[Rows]:
        """What has come since the last call; rows whose columns differ are in separate pieces. Never waits."""
        ...

    def news(self) -> list[str]:
        """What has happened to the connection since the last call, in sentences."""
        ...

    def close(self) -> None:
        """Disconnect; what has come until then can still be asked for."""
        ...
