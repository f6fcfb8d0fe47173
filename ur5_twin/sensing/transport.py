"""How the robot's packages travel: late and split, as the lab saw them (thesis section 4.4.1, figure 4.4)."""

from __future__ import annotations

import numpy as np

#: Every third package is late.
_EVERY = 3
#: The rest of a split package follows the first part after this, s.
_SPLIT = 0.001


class Arrivals:
    """When packages arrive, in pieces of any length.

    While the robot moves every third package comes together with the next one, which is split and complete 1 ms later.

    Args:
        period: from package to package, s.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._waiting = False

    def of(self, tick: np.ndarray, time: np.ndarray, moving: np.ndarray) -> np.ndarray:
        """(n,) when the next packages arrive, s.

        Args:
            tick: (n,) numbers of the packages, at least one.
            time: (n,) when they are sent, s.
            moving: (n,) whether the robot moves.
        """
        late = moving & (tick % _EVERY == _EVERY - 1)
        # Split is what a late one waits for, even if the robot has come to rest: two do not arrive at once.
        split = np.concatenate([[self._waiting], late[:-1]])
        self._waiting = bool(late[-1])
        return time + np.where(late, self._period, 0.0) + np.where(split, _SPLIT, 0.0)
