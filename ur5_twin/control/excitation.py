"""A motion that shows what a drive is made of: slow waves through the postures and quick ones on top, in every joint.

    q_j(t) = center_j + f(t) sum over waves w of A_jw sin(2 pi f_jw t + phi_jw),  f rises from 0 to 1 and falls

The slow waves move masses about, so that gravity and inertia change; the quick ones accelerate, without which a torque
constant cannot be told from a rotor's inertia. Speeds pass through zero all the time, in both directions, and stay
below the one at which the motors' ripple looks like standing still to 125 rows a second (1.94 rad/s for 404 periods a
turn).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PPoly

from ur5_twin.arm.parameters import N_JOINTS


@dataclass(frozen=True)
class Waves:
    """What a motion is made of, each (6,) a joint.

    Attributes:
        center: middle of the motion, rad, away from the arm's own links and from the floor.
        slow: amplitude of the slow wave, rad, and how many of it there are in 100 s.
        quick: of each quick wave peak acceleration, rad/s^2, and frequency, Hz.
    """

    center: tuple[float, ...]
    slow: tuple[tuple[float, ...], tuple[float, ...]]
    quick: tuple[tuple[tuple[float, ...], tuple[float, ...]], ...]


#: For what the drives are made of, with 2.2 kg known to hang 0.19 m off the flange's axis: makes the intervals of
#: ``identify plant`` small within 150 and 28 Nm of the motors. An evolution strategy (CMA) over the covariance of the
#: law's columns found it, hoping for each number to come out within its aim (benchmarks/identify_recovery.py). Joints 4
#: to 6 keep below 1.5 rad/s, since their ripple is large.
DRIVES = Waves(
    center=(0.0, -1.58, 0.65, -1.32, -2.25, -0.45),
    slow=((0.08, 0.68, 0.22, 0.13, 0.19, 0.12), (4, 21, 9, 7, 7, 5)),
    quick=(
        ((4.0, 4.6, 4.4, 3.0, 3.4, 4.5), (0.59, 1.15, 0.52, 0.52, 0.62, 0.82)),
        ((15.9, 0.4, 2.8, 4.4, 10.6, 6.9), (4.0, 2.7, 1.39, 2.61, 3.68, 2.08)),
    ),
)
#: For what hangs on the flange and nobody has weighed, up to 4.4 kg there: wide, so that its weight is told from the
#: links'. From a random search, within 140 and 25 Nm.
PAYLOAD = Waves(
    center=(0.0, -1.21, 1.6, -0.82, -1.66, 0.0),
    slow=((0.36, 0.33, 0.74, 0.67, 1.05, 0.79), (3, 5, 7, 8, 9, 11)),
    quick=(
        ((7.41, 2.78, 2.95, 2.06, 3.13, 4.46), (1.09, 0.76, 1.18, 0.64, 0.64, 1.25)),
        ((6.06, 1.56, 2.97, 5.57, 1.77, 3.0), (1.52, 1.38, 1.12, 1.37, 1.15, 0.86)),
    ),
)
#: Way in and out of the motion, s.
_RAMP = 2.0


def excitation(duration: float = 120.0, waves: Waves = DRIVES, *, seed: int = 0, period: float = 0.008) -> np.ndarray:
    """(n, 3, 6) q, qd, qdd (rad, rad/s, rad/s^2) from rest to rest, a row a tick.

    Args:
        duration: s, 10 or longer.
        waves: what it is to show.
        seed: of the waves' phases.
        period: tick, s.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration / period) + 1) * period
    rows = np.zeros((len(t), 3, N_JOINTS))
    slow, count = waves.slow
    each = [(np.array(slow), np.array(count) / 100.0)]
    for acceleration, frequency in waves.quick:
        omega = 2.0 * np.pi * np.array(frequency)
        each.append((np.array(acceleration) / omega**2, np.array(frequency)))
    for amplitude, frequency in each:
        omega = 2.0 * np.pi * frequency
        angle = np.outer(t, omega) + rng.uniform(0.0, 2.0 * np.pi, N_JOINTS)
        rows[:, 0] += amplitude * np.sin(angle)
        rows[:, 1] += amplitude * omega * np.cos(angle)
        rows[:, 2] -= amplitude * omega**2 * np.sin(angle)
    f, fd, fdd = _fade(t, duration)
    q, qd, qdd = rows[:, 0].copy(), rows[:, 1].copy(), rows[:, 2].copy()
    rows[:, 0] = np.array(waves.center) + f * q
    rows[:, 1] = f * qd + fd * q
    rows[:, 2] = f * qdd + 2.0 * fd * qd + fdd * q
    return rows


def _fade(t: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n, 1) factor with its derivatives: a quintic from 0 to 1 at the start, and back at the end."""
    # 10 s^3 - 15 s^4 + 6 s^5, highest power first.
    rise = PPoly(np.array([[6.0], [-15.0], [10.0], [0.0], [0.0], [0.0]]), np.array([0.0, 1.0]))
    into, out = np.clip(t / _RAMP, 0.0, 1.0), np.clip((duration - t) / _RAMP, 0.0, 1.0)
    first, second = rise.derivative(), rise.derivative(2)
    return (
        (rise(into) * rise(out))[:, None],
        ((first(into) * rise(out) - rise(into) * first(out)) / _RAMP)[:, None],
        ((second(into) * rise(out) + rise(into) * second(out)) / _RAMP**2)[:, None],
    )
