"""The servoj stream: set points from outside, followed by a filter inside the controller."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from ur5_twin.arm.parameters import N_JOINTS, ArmModel
from ur5_twin.control.commands import ServoJ
from ur5_twin.control.limits import check_position, check_rows
from ur5_twin.control.profile import ticks
from ur5_twin.control.trajectory import require_positive, stop

#: The stream's filter has settled when it is this near to the last set point, rad, and this slow, rad/s: a twelfth of
#: an encoder step (12 urad), and as much again in 0.1 s.
_SETTLED_RAD, _SETTLED_RAD_S = 1e-6, 1e-5
#: What then remains is braked away within one tick, since that needs less than this, rad/s^2.
_BRAKE = 1.4


def servoj(model: ArmModel, q_start: ArrayLike, stream: ServoJ, *, period: float, name: str = "servoj") -> np.ndarray:
    """Follow a stream of set points from rest, then settle at the last one and rest.

    URScript's manual describes gain as the P-term that draws the current position to the set point, and lookahead_time
    as the time by which the current position is projected forward. Taken at its word that is, with u the newest set
    point at each tick,

        qdd = gain (u - q - lookahead_time qd),

    a second-order filter with natural frequency sqrt(gain) and damping ratio lookahead_time sqrt(gain) / 2: 17.3 rad/s
    and 0.87 with the defaults. It follows a ramp lookahead_time late. Each tick's piece is solved exactly.

    Args:
        model: the arm with its limits.
        q_start: (6,) where the arm rests, rad; set points start to count when they arrive.
        stream: times, set points, lookahead_time and gain.
        period: tick, s.
        name: of the command, for messages.

    Returns:
        (n, 3, 6) q, qd, qdd at 0, period, ... up to and including rest, less than 2e-6 rad from the last set point.

    Raises:
        TwinError: a set point is beyond a joint's limits or makes a joint turn or accelerate beyond them; the message
            names the set point.
    """
    require_positive(name, period=period)
    q_start = np.asarray(q_start, dtype=float)
    times, points = np.array(stream.times), np.array(stream.points)
    for k, point in enumerate(points):
        check_position(model.limits, point, f"{name}: set point {k} at {times[k]:.3f} s")
    g, lookahead = stream.gain, stream.lookahead_time
    step = expm(np.array([[0.0, 1.0], [-g, -g * lookahead]]) * period)

    # The newest set point at each tick (a point that arrives on a tick, rounding aside, counts from it on); before the
    # first the arm rests.
    last = ticks(times[-1], period)
    newest = np.searchsorted(times, (np.arange(last + 1) + 1e-9) * period, side="right") - 1
    target = np.where((newest >= 0)[:, None], points[newest], q_start)

    rows: list[np.ndarray] = []
    q, qd = q_start, np.zeros(N_JOINTS)
    while True:
        u = target[min(len(rows), last)]
        offset = q - u
        if len(rows) >= last and np.abs(offset).max() < _SETTLED_RAD and np.abs(qd).max() < _SETTLED_RAD_S:
            break
        rows.append(np.stack([q, qd, -g * (offset + lookahead * qd)]))
        offset, qd = step[0, 0] * offset + step[0, 1] * qd, step[1, 0] * offset + step[1, 1] * qd
        q = u + offset
    final = stop(q, qd, deceleration=_BRAKE, period=period)
    out = np.concatenate([np.array(rows).reshape(-1, 3, N_JOINTS), final])

    def where(k: int) -> str:
        point = newest[min(k, last)]
        return f"{name}: at {k * period:.3f} s set point {point} (of {times[point]:.3f} s) asks too much"

    check_rows(model.limits, out, where)
    return out
