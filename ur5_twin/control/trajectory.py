"""Reference motions as the robot plans them: trapezoids of speed in joint space.

Rows are (3, 6): q, qd, qdd in rad, rad/s and rad/s^2, one a tick. Where qdd jumps, a row has the value it takes from
its own time on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ur5_twin.arm.parameters import N_JOINTS, Limits
from ur5_twin.control.limits import check_position, check_rates
from ur5_twin.control.profile import Trapezoid, ticks
from ur5_twin.errors import TwinError


def movej(
    start: ArrayLike,
    goal: ArrayLike,
    *,
    speed: float = 1.05,
    acceleration: float = 1.4,
    period: float,
    limits: Limits | None = None,
) -> np.ndarray:
    """A movej: every joint starts and stops together, the one with the longest way at the given speed.

    The leading joint's way x(t) has a trapezoidal speed, or a triangular one if it is too short to reach ``speed``;
    q = start + x (goal - start) / max |goal - start|. Speed and acceleration default to URScript's.

    Args:
        start, goal: (6,) joint positions, rad.
        speed: of the leading joint, rad/s.
        acceleration: of the leading joint, rad/s^2.
        period: tick, s.
        limits: of the arm; without them nothing is checked against any.

    Returns:
        (n, 3, 6) q, qd, qdd at 0, period, 2 period, ... up to and including rest at the goal.

    Raises:
        TwinError: speed, acceleration or the period is not positive, or goal, speed or acceleration is beyond the
            limits of a joint.
    """
    require_positive("movej", speed=speed, acceleration=acceleration, period=period)
    start, goal = np.asarray(start, dtype=float), np.asarray(goal, dtype=float)
    way = goal - start
    longest = np.abs(way).max()
    if limits is not None:
        check_position(limits, goal, "movej: goal")
    if longest == 0:
        return still(goal, 1)
    direction = way / longest
    if limits is not None:
        check_rates(limits, direction, speed, acceleration, "movej")
    law = Trapezoid(float(longest), speed, acceleration)
    x, xd, xdd = law.at(np.arange(ticks(law.duration, period) + 1) * period)
    rows = np.stack([start + np.outer(x, direction), np.outer(xd, direction), np.outer(xdd, direction)], axis=1)
    rows[-1] = still(goal, 1)[0]
    return rows


def stop(q: ArrayLike, qd: ArrayLike, *, deceleration: float, period: float) -> np.ndarray:
    """A stopj, or a protective stop: straight on in joint space to rest within the given deceleration.

    All joints stop together after T = max |qd| / deceleration, rounded up to whole ticks, so that the arm keeps
    the direction it moves in: qdd = -qd / T.

    Args:
        q: (6,) where the stop begins, rad.
        qd: (6,) the speed there, rad/s.
        deceleration: of the fastest joint at most, rad/s^2.
        period: tick, s.

    Returns:
        (n, 3, 6) q, qd, qdd at 0, period, 2 period, ... up to and including rest at q + qd T / 2.

    Raises:
        TwinError: deceleration or period is not positive.
    """
    require_positive("stop", deceleration=deceleration, period=period)
    q, qd = np.asarray(q, dtype=float), np.asarray(qd, dtype=float)
    fastest = np.abs(qd).max()
    if fastest == 0.0:
        return still(q, 1)
    n = max(ticks(fastest / deceleration, period), 1)
    duration = n * period
    left = np.arange(n, -1, -1) * period
    end, braking = q + 0.5 * qd * duration, -qd / duration
    rows = np.stack(
        [end + np.outer(0.5 * left**2, braking), np.outer(-left, braking), np.tile(braking, (len(left), 1))], axis=1
    )
    rows[-1] = still(end, 1)[0]
    return rows


def rest(q: ArrayLike, *, seconds: float, period: float) -> np.ndarray:
    """(n, 3, 6) q, qd, qdd of standing still at ``q`` (6,) for some time."""
    return still(q, max(1, round(seconds / period)))


def still(q: ArrayLike, n: int) -> np.ndarray:
    """(n, 3, 6) rows of standing still at ``q`` (6,)."""
    rows = np.zeros((n, 3, N_JOINTS))
    rows[:, 0] = q
    return rows


def require_positive(what: str, **values: float) -> None:
    """Raise a TwinError for the first of the named values that is not a positive number."""
    for name, value in values.items():
        if not 0 < value < np.inf:
            raise TwinError(f"{what}: {name} is {value}, it must be positive")
