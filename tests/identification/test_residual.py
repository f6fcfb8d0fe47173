"""How a map errs: known processes are recovered from their sum."""

from __future__ import annotations

import numpy as np

from ur5_twin.drives.current_map import TURNING
from ur5_twin.drives.terms import Ride
from ur5_twin.identification.residual import fit_residual

STEP = 0.008
MOVING = (0.1, 0.4, 0.3, 0.02)
REST = (0.6, 4.0, 0.02, 0.05)
TURNED = 0.4


def made(seed: int) -> tuple[Ride, np.ndarray]:
    """120 s in which all joints move and rest for 3 s in turn, and what a map would leave of their currents.

    Some rests have a jerk by two and a half times the way on which friction turns.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(15000) * STEP
    moving = (time // 3.0).astype(int) % 2 == 0
    slow, fast = np.zeros(6), np.zeros(6)
    error = np.empty((len(time), 6))
    since, angle = 0.0, np.zeros(len(time))
    for k in range(len(time)):
        a, t, b, u = MOVING if moving[k] else REST
        since = 0.0 if moving[k] else since + STEP
        keep = np.exp(-STEP / (0.05 if not moving[k] and since < 0.1 else t)), np.exp(-STEP / u)
        slow = keep[0] * slow + np.sqrt(1.0 - keep[0] ** 2) * a * rng.normal(size=6)
        fast = keep[1] * fast + np.sqrt(1.0 - keep[1] ** 2) * b * rng.normal(size=6)
        angle[k] = angle[k - 1]
        if not moving[k] and k % 375 in (150, 250):
            way = rng.choice([-1.0, 1.0]) * 2.5 * TURNING
            angle[k] += way
            e = np.exp(-2.5)
            slow = e * slow + (1.0 - e) * TURNED * np.sign(way) + np.sqrt(1.0 - e * e) * TURNED * rng.normal(size=6)
        error[k] = slow + fast
    qd = np.repeat(np.where(moving, 1.0, 0.0)[:, None], 6, axis=1)
    none, angles = np.zeros_like(qd), np.repeat(angle[:, None], 6, axis=1)
    return Ride("made", time, none, none, qd, none, none, none, angles, none, none, none), error


def test_recovers_both_processes() -> None:
    rides, errors = zip(*(made(seed) for seed in (1, 2)), strict=True)
    found = np.array(fit_residual(rides, errors))
    # 40 rests of 3 s hold some 40 independent values of the slow part: its size is known to 10 %, its 4 s to half, and
    # six joints are looked at. The fast part in motion has 240 s of 20 ms.
    assert np.allclose(found[:, 2], MOVING[2], rtol=0.1)
    assert np.allclose(found[:, 3], MOVING[3], rtol=0.2)
    assert np.allclose(found[:, 4], REST[0], rtol=0.35)
    assert (found[:, 5] > 1.0).all()
    # 80 jerks, each of which says the level twice: by its mean, and by its spread.
    assert np.allclose(found[:, 8], TURNED, rtol=0.25)
    # The fast part at rest drowns in what the slow one does in 0.05 s, so that its size is not asked for.
