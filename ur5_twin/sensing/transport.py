"""How the robot's packages travel: late and split, as the lab saw them (thesis section 4.4.1, figure 4.4)."""

from __future__ import annotations

import numpy as np

#: Every third package is late.
_EVERY = 3
#: The rest of a split package follows the first part after this, s.
_SPLIT = 0.001


def arrival(tick: np.ndarray, time: np.ndarray, moving: np.ndarray, period: float) -> np.ndarray:
    """(n,) when packages arrive, s.

    While the robot moves every third package comes together with the next one, which is split and complete 1 ms later.

    Args:
        tick: (n,) numbers of the packages.
        time: (n,) when they are sent, s.
        moving: (n,) whether the robot moves.
        period: from package to package, s.
    """
    late = moving & (tick % _EVERY == _EVERY - 1)
    split = moving & (tick % _EVERY == 0) & (tick > 0)
    return time + np.where(late, period, 0.0) + np.where(split, _SPLIT, 0.0)
