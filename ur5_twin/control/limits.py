"""Motions against the joints' limits (thesis table 4.1)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ur5_twin.arm.parameters import JOINT_NAMES, Limits
from ur5_twin.errors import TwinError

#: A value above its limit by less than this share is at it: rounding of the planner's sums, nine digits of a limit.
ROUNDING = 1e-9

_KINDS = (("be at", "rad"), ("turn at", "rad/s"), ("accelerate at", "rad/s^2"))


def check_rows(limits: Limits, rows: np.ndarray, where: Callable[[int], str]) -> None:
    """Refuse a motion that leaves the joints' limits of position, speed or acceleration.

    Args:
        limits: of the arm.
        rows: (n, 3, 6) q, qd, qdd.
        where: says of a row's index what the arm does there; the message begins with it.

    Raises:
        TwinError: names the first row beyond a limit, the joint, its value and the limit.
    """
    bounds = np.stack([limits.q, limits.qd, limits.qdd])
    beyond = ~(np.abs(rows) <= bounds * (1.0 + ROUNDING))
    if not beyond.any():
        return
    row = int(np.argmax(beyond.any(axis=(1, 2))))
    # Of several joints beyond their limits, the one that is worst off.
    kind, joint = np.unravel_index(
        np.argmax(np.where(beyond[row], np.abs(rows[row]) / bounds, 0.0)), (len(_KINDS), len(JOINT_NAMES))
    )
    verb, unit = _KINDS[kind]
    value, bound = rows[row, kind, joint], bounds[kind, joint]
    raise TwinError(
        f"{where(row)}: {JOINT_NAMES[joint]} would {verb} {value:.6g} {unit}, its limit is +-{bound:.6g} {unit}"
    )


def check_position(limits: Limits, q: np.ndarray, what: str) -> None:
    """Refuse a joint position (6,), rad, beyond the joints' limits; ``what`` begins the message."""
    beyond = ~(np.abs(q) <= limits.q * (1.0 + ROUNDING))
    if beyond.any():
        j = int(np.argmax(beyond))
        raise TwinError(f"{what}: {JOINT_NAMES[j]} is {q[j]:.6g} rad, its limit is +-{limits.q[j]:.6g} rad")


def check_rates(limits: Limits, direction: np.ndarray, speed: float, acceleration: float, what: str) -> None:
    """Refuse a speed or an acceleration that a joint's limit does not allow.

    Args:
        limits: of the arm.
        direction: (6,) how far each joint turns for 1 rad of the leading one.
        speed: of the leading joint, rad/s.
        acceleration: of the leading joint, rad/s^2.
        what: begins the message.

    Raises:
        TwinError: names the joint, its value and its limit.
    """
    for name, value, bounds, unit in (
        ("speed", speed, limits.qd, "rad/s"),
        ("acceleration", acceleration, limits.qdd, "rad/s^2"),
    ):
        share = np.abs(direction) * value / bounds
        j = int(np.argmax(share))
        if not share[j] <= 1.0 + ROUNDING:
            asked = abs(direction[j]) * value
            raise TwinError(f"{what}: {name} of {JOINT_NAMES[j]} is {asked:.6g} {unit}, its limit is {bounds[j]:.6g}")
