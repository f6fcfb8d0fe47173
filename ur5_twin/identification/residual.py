"""How a current map is wrong on logs it has not seen: two Gauss-Markov processes a joint, by maximum likelihood.

    i - i_map = slow + fast,    d slow = -slow / T dt + sqrt(2 / T) sigma dW,    fast likewise

with one set of numbers while the joint's target moves and one while it rests. ``slow`` is friction that the map does
not know, above all what a gear sticks with at rest; ``fast`` is ripple and noise. Within ``SETTLING`` after a stop the
slow one takes up its size at rest at once: a joint sticks with whatever it stopped with. Where the encoder of a resting
joint moves by x, its friction turns round (``TURNING``, and F the level ``Residual.turned``)::

    slow <- e slow + (1 - e) F sign(x) + noise of variance (1 - e^2) F^2,    e = exp(-|x| / TURNING)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numba
import numpy as np
from scipy.optimize import minimize

from ur5_twin.arm.parameters import N_JOINTS
from ur5_twin.drives.current_map import SETTLING, SETTLING_TIME, TURNING, Residual
from ur5_twin.drives.terms import Ride

#: Bounds of (slow A, slow s, fast A, fast s), moving and at rest. A time constant beyond the logs' rests cannot be
#: told, nor one below a row's 8 ms.
_LOW = np.array([[2e-3, 0.1, 2e-3, 0.008], [2e-3, 1.0, 2e-3, 0.008]])
_HIGH = np.array([[2.0, 1.0, 2.0, 0.05], [2.0, 30.0, 2.0, 0.3]])
#: Of the level F, A, and where its search begins.
_LEVELS, _LEVEL = (1e-3, 1.0), 0.1
#: Errors beyond this many standard deviations count by their size, not its square.
_LARGE = 2.0
#: Steps of the search, and the relative change of the cost that ends it.
_SWEEPS, _SAME = 200, 1e-7


def fit_residual(
    rides: Sequence[Ride], errors: Sequence[np.ndarray], progress: Callable[[int], object] = lambda done: None
) -> tuple[Residual, ...]:
    """The processes' numbers, a joint at a time.

    Args:
        rides: logs of free motion.
        errors: of each, actual_current less what a fit on the others expects, (n, 6) A.
        progress: called with the number of joints done.
    """
    found = []
    for j in range(N_JOINTS):
        rows = [
            (np.ascontiguousarray(e[:, j]), of.moving[:, j], of.step, np.diff(of.angle[:, j], prepend=of.angle[0, j]))
            for of, e in zip(rides, errors, strict=True)
        ]
        size = float(np.concatenate([e for e, *_ in rows]).std())
        start = np.array([[0.4 * size, 0.3, 0.9 * size, 0.016], [size, 5.0, 0.1 * size, 0.1]])

        def cost(x: np.ndarray, rows: Sequence[tuple[np.ndarray, ...]] = rows) -> float:
            numbers, level = np.exp(x[:8]).reshape(2, 4), math.exp(x[8])
            return sum(_cost(e, moving, step, way, numbers, level) for e, moving, step, way in rows)

        bounds = [*zip(np.log(_LOW).ravel(), np.log(_HIGH).ravel(), strict=True), tuple(np.log(_LEVELS))]
        first = np.append(np.log(np.clip(start, _LOW, _HIGH)).ravel(), math.log(_LEVEL))
        best = minimize(cost, first, method="L-BFGS-B", bounds=bounds, options={"maxiter": _SWEEPS, "ftol": _SAME})
        found.append(Residual._make(np.exp(best.x).tolist()))
        progress(j + 1)
    return tuple(found)


@numba.njit(cache=True, nogil=True)
def _cost(error, moving, step, way, numbers, level):  # pragma: no cover - compiled
    """Negative log likelihood of one joint's error, robust, by a Kalman filter of both processes."""
    slow, fast = 0.0, 0.0
    p00, p01, p11 = numbers[1, 0] ** 2, 0.0, numbers[1, 2] ** 2
    cost, rested = 0.0, SETTLING
    for k in range(len(error)):
        i = 0 if moving[k] else 1
        rested = 0.0 if moving[k] else rested + step[k]
        slow_time = SETTLING_TIME if i == 1 and rested < SETTLING else numbers[i, 1]
        if k > 0:
            a, b = np.exp(-step[k] / slow_time), np.exp(-step[k] / numbers[i, 3])
            slow *= a
            fast *= b
            p00 = a * a * p00 + (1.0 - a * a) * numbers[i, 0] ** 2
            p01 = a * b * p01
            p11 = b * b * p11 + (1.0 - b * b) * numbers[i, 2] ** 2
            if i == 1:
                a = np.exp(-abs(way[k]) / TURNING)
                slow = a * slow + (1.0 - a) * level * np.sign(way[k])
                p00 = a * a * p00 + (1.0 - a * a) * level**2
                p01 *= a
        s = p00 + 2.0 * p01 + p11 + 1e-8
        off = abs(error[k] - slow - fast)
        z = off / np.sqrt(s)
        cost += 0.5 * np.log(s) + (0.5 * z * z if z < _LARGE else _LARGE * z - 0.5 * _LARGE * _LARGE)
        g0, g1 = (p00 + p01) / s, (p01 + p11) / s
        innovation = error[k] - slow - fast
        slow += g0 * innovation
        fast += g1 * innovation
        c0, c1 = p00 + p01, p01 + p11
        p00 -= g0 * c0
        p01 -= g0 * c1
        p11 -= g1 * c1
    return cost
