"""Reference motions as the robot plans them: trapezoids of speed in joint space."""

from __future__ import annotations

import numpy as np

from ur5_twin.errors import TwinError


def movej(start: np.ndarray, goal: np.ndarray, *, speed: float, acceleration: float, period: float) -> np.ndarray:
    """A movej: every joint starts and stops together, the one with the longest way at the given speed.

    The way s(t) from 0 to 1 has a trapezoidal speed, or a triangular one if the way is too short to reach ``speed``;
    q = start + s (goal - start).

    Args:
        start, goal: (6,) joint positions, rad.
        speed: of the leading joint, rad/s.
        acceleration: of the leading joint, rad/s^2.
        period: tick, s.

    Returns:
        (n, 3, 6) q, qd, qdd at 0, period, 2 period, ... up to and including rest at the goal.

    Raises:
        TwinError: a limit or the period is not positive.
    """
    for name, value in (("speed", speed), ("acceleration", acceleration), ("period", period)):
        if not value > 0:
            raise TwinError(f"movej: {name} is {value}, it must be positive")
    start, way = np.asarray(start, dtype=float), np.asarray(goal, dtype=float) - start
    longest = np.abs(way).max()
    if longest == 0:
        return np.stack([start, np.zeros_like(way), np.zeros_like(way)])[None]
    v, a = speed / longest, acceleration / longest
    ramp = min(v / a, np.sqrt(1.0 / a))
    v = a * ramp
    duration = 1.0 / v + ramp
    t = np.arange(int(np.ceil(duration / period)) + 1) * period
    left = np.maximum(duration - t, 0.0)
    accelerating, braking = t < ramp, left < ramp
    s = np.where(accelerating, 0.5 * a * t**2, np.where(braking, 1.0 - 0.5 * a * left**2, v * (t - 0.5 * ramp)))
    sd = np.where(accelerating, a * t, np.where(braking, a * left, v))
    sdd = np.where(accelerating, a, np.where(braking & (left > 0), -a, 0.0))
    return np.stack([start + np.outer(s, way), np.outer(sd, way), np.outer(sdd, way)], axis=1)


def rest(q: np.ndarray, *, seconds: float, period: float) -> np.ndarray:
    """(n, 3, 6) q, qd, qdd of standing still at ``q`` (6,) for some time."""
    still = np.stack([np.asarray(q, dtype=float), np.zeros(6), np.zeros(6)])
    return np.tile(still, (max(1, round(seconds / period)), 1, 1))
