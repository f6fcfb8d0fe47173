"""Whether a push acts that is small but lasts, where joints move: its odds against no push, or none any more.

In motion a sample's current is noise of some Nm, 16 ms long. A push of 10 N is less than that, and shows by lasting;
but so does friction that is not quite the map's. Without a push, the torque error of a joint that moves is taken for

    e = slow + fast + a friction + b torque

slow and fast as the map's identification found them (``identification.residual``), slow starting with what the joint
stuck with; a and b, by which friction and the motors' torque are off, are all but constant and learnt on the way. A
Kalman filter a joint leaves white innovations nu of variance s^2. A push w that is constant from some instant on adds
A w to them, where A is J' put through the same filters from that instant; so that with w ~ N(0, S)

    log B = z' (I + S^-1)^-1 z / 2 - log det(1 + S I) / 2,    I = sum A' A / s^2,    z = sum A' nu / s^2

(the generalised likelihood ratio test of Willsky and Jones, IEEE Trans. Automatic Control 21, 1976, with a prior
instead of a maximum). ``Onset`` holds such sums for the last instants of a grid; F is the mean of their B. That a push
acted until some instant of the grid, and no longer does, has the factor that F had then, F_k:

    odds = p F / (1 + p q sum F_k)

p the odds that a push began of late, q that it ended from one instant to the next. Joints at rest say nothing here:
what a stuck gear holds is for ``friction_kalman``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from ur5_twin.drives.current_map import Residual
from ur5_twin.estimation._kernels import whitened
from ur5_twin.estimation.settings import OnsetSpec

#: s between two instants at which a push may have begun, and how many of them are held.
_APART, _HELD = 0.096, 8
#: Odds that a push ended from one instant to the next.
_ENDED = 0.01
#: s for which the learnt shares keep.
_MEMORY = 100.0
#: States: the slow and the fast part, the shares of friction and torque.
_SLOW, _FAST, _N = 0, 1, 4
#: An innovation beyond this many standard deviations counts as that many.
_LARGEST = 5.0
#: Variance of a torque that the filter takes for exact, Nm^2.
_LEAST = 1e-3
#: Samples that a push must have lasted.
_FEWEST = 2
#: The log of a Bayes factor beyond which more is the same.
_CERTAIN = 200.0


class Onset:
    """Pushes that began in the last 0.8 s.

    Args:
        spec: what pushes and the arm's deviation from its map are like.
        residuals: how the map errs, a joint each (``drives.current_map.CurrentMap.residuals``).
    """

    def __init__(self, spec: OnsetSpec, residuals: Sequence[Residual]) -> None:
        self._error = np.array(residuals)
        self._shares = np.array([spec.friction_share, spec.torque_share])
        self._push = np.array([spec.force_n**2] * 3 + [spec.moment_nm**2] * 3)
        self._x, self._P = np.zeros((6, _N)), np.zeros((6, _N, _N))
        for k, share in enumerate(self._shares, start=2):
            self._P[:, k, k] = share**2
        self._slid = np.zeros(6, dtype=bool)
        self._passed = np.zeros((_HELD, 6, 6, _N))
        self._I, self._z = np.zeros((_HELD, 6, 6)), np.zeros((_HELD, 6))
        self._age = np.full(_HELD, -1)
        self._begun = spec.prior / (1.0 - spec.prior)
        self._before, self._factor = np.zeros(_HELD), 0.0
        self._next, self._wait = 0, 0.0

    def restart(self) -> None:
        """After a gap: nothing is known of it, but what was learnt of the arm stays."""
        self._age[:] = -1
        self._slid[:] = False
        self._before[:] = 0.0
        self._factor, self._wait = 0.0, 0.0

    def update(
        self,
        dt: float,
        error: np.ndarray,
        J: np.ndarray,
        slope: np.ndarray,
        moving: np.ndarray,
        friction: np.ndarray,
        torque: np.ndarray,
        touched: bool,
    ) -> float:
        """The odds of a push after one more sample.

        Args:
            dt: s since the last one.
            error: (6,) torque that the measured current has less than the expected one, Nm.
            J: (6, 6) Jacobian of the flange, its transpose from wrench to torque.
            slope: (6,) A/Nm.
            moving: (6,) whether the target moves.
            friction, torque: (6,) what the map expects of either, Nm.
            touched: whether something touches the arm as far as is known; nothing is learnt of the arm then.
        """
        self._wait -= dt
        if self._wait <= 0.0:
            self._wait += _APART
            k = self._next
            self._passed[k], self._I[k], self._z[k], self._age[k] = 0.0, 0.0, 0.0, 0
            self._before[k] = self._factor
            self._next = (k + 1) % _HELD
        _filter(
            dt,
            error,
            J,
            slope,
            moving,
            friction,
            torque,
            touched,
            self._error,
            self._shares,
            self._x,
            self._P,
            self._slid,
            (self._passed, self._I, self._z, self._age),
        )
        self._factor = _factor(self._I, self._z, self._age, self._push)
        return self._begun * self._factor / (1.0 + self._begun * _ENDED * self._before.sum())


@njit(cache=True, nogil=True, error_model="numpy")
def _filter(
    dt, error, J, slope, moving, friction, torque, touched, of, shares, x, P, slid, pushes
):  # pragma: no cover - compiled  # fmt: skip
    passed, information, z, age = pushes
    seen, gain, cross = np.ones(_N), np.empty(_N), np.empty(_N)
    keep, size, A = np.empty(_N), np.empty(_N), np.empty(6)
    for h in range(age.shape[0]):
        if age[h] >= 0:
            age[h] += 1
    keep[2] = keep[3] = math.exp(-dt / _MEMORY)
    size[2], size[3] = shares[0], shares[1]
    for j in range(6):
        if not moving[j]:
            slid[j] = False
            continue
        keep[_SLOW], keep[_FAST] = math.exp(-dt / of[j, 1]), math.exp(-dt / of[j, 3])
        size[_SLOW], size[_FAST] = of[j, 0] / slope[j], of[j, 2] / slope[j]
        if not slid[j]:
            slid[j] = True
            _begin(x[j], P[j], max(size[_SLOW], of[j, 8] / slope[j]), size[_FAST])
            for h in range(age.shape[0]):
                for c in range(6):
                    passed[h, j, c, _SLOW] = passed[h, j, c, _FAST] = 0.0
        seen[2], seen[3] = friction[j], torque[j]
        for a in range(_N):
            x[j, a] *= keep[a]
            for b in range(_N):
                P[j, a, b] *= keep[a] * keep[b]
            P[j, a, a] += (1.0 - keep[a] ** 2) * size[a] ** 2
        innovation, variance = error[j], _LEAST
        for a in range(_N):
            innovation -= seen[a] * x[j, a]
            cross[a] = 0.0
            for b in range(_N):
                cross[a] += P[j, a, b] * seen[b]
        for a in range(_N):
            variance += seen[a] * cross[a]
        for a in range(_N):
            gain[a] = 0.0 if touched and a > _FAST else cross[a] / variance
        most = _LARGEST * math.sqrt(variance)
        innovation = min(max(innovation, -most), most)
        for h in range(age.shape[0]):
            if age[h] < 0:
                continue
            for c in range(6):
                A[c] = J[c, j]
                for a in range(_N):
                    passed[h, j, c, a] *= keep[a]
                    A[c] -= seen[a] * passed[h, j, c, a]
                for a in range(_N):
                    passed[h, j, c, a] += gain[a] * A[c]
            for c in range(6):
                z[h, c] += A[c] * innovation / variance
                for d in range(c + 1):
                    information[h, c, d] += A[c] * A[d] / variance
        for a in range(_N):
            x[j, a] += gain[a] * innovation
            for b in range(_N):
                P[j, a, b] += gain[a] * gain[b] * variance - gain[a] * cross[b] - cross[a] * gain[b]


@njit(cache=True, nogil=True)
def _begin(x, P, slow, fast):  # pragma: no cover - compiled
    """A joint that starts to slide: new noise, and at first friction of any direction."""
    for a in range(2):
        x[a] = 0.0
        for b in range(_N):
            P[a, b] = P[b, a] = 0.0
    P[_SLOW, _SLOW], P[_FAST, _FAST] = slow * slow, fast * fast


@njit(cache=True, nogil=True, error_model="numpy")
def _factor(information, z, age, push):  # pragma: no cover - compiled
    """Mean of the Bayes factors; 0 where there is none yet."""
    total, count = 0.0, 0
    A, y, least = np.empty((6, 6)), np.empty(6), np.zeros(6)
    for h in range(age.shape[0]):
        if age[h] < 0:
            continue
        count += 1
        if age[h] < _FEWEST:
            continue
        for c in range(6):
            for d in range(c):
                A[c, d] = information[h, c, d]
            A[c, c] = information[h, c, c] + 1.0 / push[c]
        log = -whitened(A, z[h], least, y)
        for c in range(6):
            log += 0.5 * y[c] * y[c] - 0.5 * math.log(push[c])
        total += math.exp(min(log, _CERTAIN))
    return total / max(count, 1)
