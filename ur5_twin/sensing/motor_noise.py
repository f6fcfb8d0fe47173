"""What a motor's current does while the joint moves, beyond what friction and ripple of the simulated gears explain.

The lab's currents have more in them in motion than at rest, at all frequencies, a little more at low ones. It comes
from gears and motors and so belongs to the motion, not to the sensor; as nobody can predict it yet, it is added to the
current that is reported: an autoregressive noise of first order that stops with the joint.
"""

from __future__ import annotations

import numpy as np

from ur5_twin.filters import first_order

#: The tick at which the noise was measured, s.
TICK = 0.008
#: A joint moves at more than this, rad/s.
_MOVING = 0.01


class MotorNoise:
    """The noise with its memory, in pieces of any length.

    Args:
        std: (6,) standard deviation in motion, A.
        pole: of x_k = pole x_k-1 + w_k from row to row.
        rng: of the noise.
    """

    def __init__(self, std: np.ndarray, pole: float, rng: np.random.Generator) -> None:
        self._std, self._pole, self._rng = std, pole, rng
        self._memory = np.zeros((1, len(std)))

    def added(self, current: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Currents (n, 6) in A with the noise of joints that move at qd (n, 6) rad/s."""
        white = self._rng.standard_normal(current.shape)
        gain = np.sqrt(1.0 - self._pole**2)
        coloured, self._memory = first_order(float(gain), self._pole, white, self._memory)
        return current + self._std * coloured * (np.abs(qd) > _MOVING)
