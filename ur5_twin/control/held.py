"""What the servo holds, from what the controller publishes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

#: Deceleration that ends a move and is no rounding, rad/s^2.
BRAKING = 1e-2


#: A target that jumps this far, and to within this of where the arm was measured, was given up, rad.
_JUMP, _AT_ARM = 0.1, 5e-3


def given_up(before: np.ndarray, target_q: np.ndarray, actual_q: np.ndarray) -> np.ndarray:
    """(n,) whether the controller gave up its path, as in a protective stop: target_q jumps to where the arm is.

    Args:
        before: (n, 6) target_q a row earlier, rad.
        target_q: (n, 6) rad.
        actual_q: (n, 6) measured a row earlier, which an idle controller publishes as target_q.
    """
    jumps = np.abs(target_q - before).max(axis=-1) > _JUMP
    return jumps & (np.abs(target_q - actual_q).max(axis=-1) < _AT_ARM)


def commanded(target: np.ndarray, begins: np.ndarray | None = None) -> np.ndarray:
    """Targets (n, 3, 6) as the servo holds them, from the ones that are published.

    While the arm is idle the real controller publishes as target_q what it measured a tick earlier, and so a push at
    standstill shows in target_q too; the servo goes on holding the end of the last move, to which the arm returns.
    Rows without target velocity and acceleration therefore hold the end of the last move, or the first row. Where rows
    are missing the last row of a move is not its end; it is where that row's deceleration brings the joint to rest,
    q + qd |qd| / (2 |qdd|).

    Args:
        target: target_q, target_qd, target_qdd; rad, rad/s, rad/s^2.
        begins: (n,) rows before which nothing is known to be held, besides the first: a silence, a restart.
    """
    if begins is not None and begins[1:].any():
        starts = [0, *(np.flatnonzero(begins[1:]) + 1), len(target)]
        return np.concatenate([commanded(target[a:b]) for a, b in pairwise(starts)])
    q, qd, qdd = target[:, 0], target[:, 1], target[:, 2]
    idle = np.asarray(~target[:, 1:].any(axis=(1, 2)))
    braking = (qd * qdd < 0.0) & (np.abs(qdd) > BRAKING)
    end = q + np.divide(qd * np.abs(qd), 2.0 * np.abs(qdd), out=np.zeros_like(q), where=braking)
    last = np.maximum.accumulate(np.where(idle, -1, np.arange(len(target))))
    held = target.copy()
    held[:, 0] = np.where(idle[:, None], np.where(last[:, None] < 0, q[:1], end[np.maximum(last, 0)]), q)
    return held


class Held:
    """``commanded``, row by row."""

    def __init__(self) -> None:
        self._end: np.ndarray | None = None

    def forget(self) -> None:
        """Nothing is known to be held: the next row begins anew."""
        self._end = None

    def update(self, target: np.ndarray) -> np.ndarray:
        """The target (3, 6) of the next row as the servo holds it."""
        q, qd, qdd = target
        if target[1:].any():
            braking = (qd * qdd < 0.0) & (np.abs(qdd) > BRAKING)
            self._end = q + np.divide(qd * np.abs(qd), 2.0 * np.abs(qdd), out=np.zeros_like(q), where=braking)
            return target
        end = self._end
        if end is None:
            end = self._end = q.copy()
        return np.stack([end, qd, qdd])
