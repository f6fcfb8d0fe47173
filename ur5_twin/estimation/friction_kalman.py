"""Our estimator: a Kalman filter in which wrench and friction compete for what the current map does not explain.

The measurement is, per joint, the torque that the measured current has over the expected one
(``estimation.expected_current``), against the motor::

    (i_map - i) / slope = J' w + slow + fast

- w, the wrench at the flange, is a push: a smooth process about zero of a given size and length (Matern, order 3/2:
  w'' = -2 r w' - r^2 w + noise with r = sqrt(3) / length), so that what shakes faster than a hand is no push; and in
  ``friction_kalman_lasting`` a second, first-order one that lasts for seconds beside it;
- slow and fast, per joint, are how the map errs on logs it has not seen, with the sizes and time constants that its
  identification found for motion and for rest (``identification.residual``). At rest slow is large and lasting: a gear
  sticks with whatever it stopped with, and that is no contact.

What lasts at rest may be either: the first takes pushes of more than a second or two for friction little by little,
the second holds them and takes more friction for a push. A torque that fits no wrench of ordinary size is friction, one
that appears while all joints rest and fits a wrench is a push, and in motion the ripple is averaged as long as its own
correlation asks for. It starts untouched, as a force sensor is tared. What no joint feels near a singularity stays at
the prior. The filter's covariance is the estimate's; the probability of contact is the Bayes factor of w = 0 (Savage
and Dickey).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from ur5_twin.drives.current_map import SETTLING, SETTLING_TIME
from ur5_twin.errors import EstimationError
from ur5_twin.estimation.expected_current import ExpectedCurrent
from ur5_twin.estimation.intake import Intake, Step
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.protocol import Estimate, Sample
from ur5_twin.estimation.settings import FrictionKalmanSpec, Settings
from ur5_twin.estimation.wrench import WrenchSolver

_NEEDED = (
    "target_q",
    "target_qd",
    "target_qdd",
    "target_moment",
    "target_current",
    "actual_q",
    "actual_current",
)
#: States: the quick push, its rate, the lasting push, and the slow and the fast part of each joint's error.
_RATE, _LONG, _SLOW, _FAST, _N = 6, 12, 18, 24, 30
#: An innovation beyond this many standard deviations counts as that many: a spike is no push.
_LARGEST = 5.0
#: Variance of a torque that the filter takes for exact, Nm^2; it keeps the innovation's from vanishing.
_LEAST = 1e-3


class _Push(NamedTuple):
    """What is expected of pushes: variances (6,) in N^2 and Nm^2, and s."""

    quick: np.ndarray
    length: float
    lasting: np.ndarray
    lasts: float


class FrictionKalman:
    """The filter above, with the push of ``[friction_kalman]``: short ones, by hand."""

    def __init__(self, nominal: NominalModel) -> None:
        spec = self.spec(nominal.settings)
        if not nominal.current_map.residuals:
            raise EstimationError(
                f"drive {nominal.current_map.name} does not say how it errs: it has not been tried on logs"
            )
        self._expected = ExpectedCurrent(nominal)
        self._intake = Intake(_NEEDED)
        self._solver = WrenchSolver(nominal)
        quick = np.array([spec.force_n**2] * 3 + [spec.moment_nm**2] * 3)
        lasting = np.array([spec.lasting_force_n**2] * 3 + [spec.lasting_moment_nm**2] * 3)
        self._push = _Push(quick, spec.push_s, lasting, spec.lasting_s)
        self._odds = math.log(spec.prior_contact / (1.0 - spec.prior_contact))
        self._error = np.array(nominal.current_map.residuals)
        self._x, self._P = np.zeros(_N), np.zeros((_N, _N))
        self._rested = np.full(6, np.inf)
        self._last = self._solver.unknown()
        self._new = True

    @staticmethod
    def spec(settings: Settings) -> FrictionKalmanSpec:
        """The part of the settings that is this estimator's."""
        return settings.friction_kalman

    def update(self, sample: Sample) -> Estimate:
        """The estimate at this sample (``protocol.Estimator``)."""
        step = self._intake.update(sample)
        if step is Step.NOTHING:
            return self._last
        held = self._intake.sample
        self._expected.update(held, self._intake.dt)
        self._solver.look(held.actual_q)
        if step is Step.START:
            # Untouched at the very start; after a silence anything may have happened.
            _begin(self._x, self._P, self._error, self._expected.slope, self._push, 0.0 if self._new else 1.0)
            self._new = False
        wrench, covariance, tau = np.empty(6), np.empty((6, 6)), np.empty(6)
        contact = _step(
            self._x,
            self._P,
            self._rested,
            self._intake.dt,
            self._error,
            self._push,
            self._odds,
            self._solver.J,
            held.actual_current,
            self._expected.current,
            self._expected.slope,
            self._expected.moving,
            wrench,
            covariance,
            tau,
        )
        self._last = Estimate(tau, wrench, covariance, contact, self._solver.sigma_min)
        return self._last


class FrictionKalmanLasting(FrictionKalman):
    """The filter above, with the pushes of ``[friction_kalman_lasting]``: leaning hands and tools that press."""

    @staticmethod
    def spec(settings: Settings) -> FrictionKalmanSpec:
        """The part of the settings that is this estimator's."""
        return settings.friction_kalman_lasting


@njit(cache=True, nogil=True)
def _begin(x, P, error, slope, push, share):  # pragma: no cover - compiled
    """At rest, with a share of the wrench's prior variance: none where it is known that nothing touches the arm."""
    x[:] = 0.0
    P[:] = 0.0
    for j in range(6):
        P[j, j] = share * push.quick[j]
        P[_RATE + j, _RATE + j] = share * 3.0 / push.length**2 * push.quick[j]
        P[_LONG + j, _LONG + j] = share * push.lasting[j]
        P[_SLOW + j, _SLOW + j] = (error[j, 4] / slope[j]) ** 2
        P[_FAST + j, _FAST + j] = (error[j, 6] / slope[j]) ** 2


@njit(cache=True, nogil=True, error_model="numpy")
def _predict(x, P, rested, dt, error, push, slope, moving):  # pragma: no cover - compiled
    r = math.sqrt(3.0) / push.length
    decay = math.exp(-r * dt)
    # The push's transition matrix over dt and what its noise adds, per unit of variance.
    a, b, c, d = decay * (1.0 + r * dt), decay * dt, -decay * r * r * dt, decay * (1.0 - r * dt)
    added = 1.0 - a * a - b * b * r * r
    crossed = -a * c - b * d * r * r
    added_rate = r * r - c * c - d * d * r * r
    for i in range(6):
        w, v = x[i], x[_RATE + i]
        x[i], x[_RATE + i] = a * w + b * v, c * w + d * v
        for k in range(_N):
            w, v = P[i, k], P[_RATE + i, k]
            P[i, k], P[_RATE + i, k] = a * w + b * v, c * w + d * v
    for k in range(_N):
        for i in range(6):
            w, v = P[k, i], P[k, _RATE + i]
            P[k, i], P[k, _RATE + i] = a * w + b * v, c * w + d * v
    for i in range(6):
        P[i, i] += added * push.quick[i]
        P[i, _RATE + i] += crossed * push.quick[i]
        P[_RATE + i, i] += crossed * push.quick[i]
        P[_RATE + i, _RATE + i] += added_rate * push.quick[i]
        rested[i] = 0.0 if moving[i] else rested[i] + dt
        first = 0 if moving[i] else 4
        slow_time = error[i, first + 1]
        if not moving[i] and rested[i] < SETTLING:
            slow_time = SETTLING_TIME
        _wander(x, P, _LONG + i, math.exp(-dt / push.lasts), math.sqrt(push.lasting[i]))
        _wander(x, P, _SLOW + i, math.exp(-dt / slow_time), error[i, first] / slope[i])
        _wander(x, P, _FAST + i, math.exp(-dt / error[i, first + 3]), error[i, first + 2] / slope[i])


@njit(cache=True, nogil=True)
def _wander(x, P, row, keep, size):  # pragma: no cover - compiled
    """One state's first-order process: what it keeps, and the standard deviation it has in the end."""
    x[row] *= keep
    for k in range(_N):
        P[row, k] *= keep
    for k in range(_N):
        P[k, row] *= keep
    P[row, row] += (1.0 - keep * keep) * size**2


@njit(cache=True, nogil=True, error_model="numpy")
def _step(
    x, P, rested, dt, error, push, odds, J, current, expected, slope, moving, wrench, covariance, tau
):  # pragma: no cover - compiled  # fmt: skip
    _predict(x, P, rested, dt, error, push, slope, moving)
    Ph = np.empty(_N)
    for j in range(6):
        innovation = (expected[j] - current[j]) / slope[j] - x[_SLOW + j] - x[_FAST + j]
        for i in range(6):
            innovation -= J[i, j] * (x[i] + x[_LONG + i])
        for i in range(_N):
            Ph[i] = P[i, _SLOW + j] + P[i, _FAST + j]
            for k in range(6):
                Ph[i] += (P[i, k] + P[i, _LONG + k]) * J[k, j]
        total = _LEAST + Ph[_SLOW + j] + Ph[_FAST + j]
        for i in range(6):
            total += J[i, j] * (Ph[i] + Ph[_LONG + i])
        most = _LARGEST * math.sqrt(total)
        innovation = min(max(innovation, -most), most)
        for i in range(_N):
            gain = Ph[i] / total
            x[i] += gain * innovation
            for k in range(_N):
                P[i, k] -= gain * Ph[k]
    for i in range(_N):
        for k in range(i):
            P[i, k] = P[k, i] = 0.5 * (P[i, k] + P[k, i])
    for i in range(6):
        wrench[i] = x[i] + x[_LONG + i]
        for k in range(6):
            covariance[i, k] = P[i, k] + P[i, _LONG + k] + P[_LONG + i, k] + P[_LONG + i, _LONG + k]
    for j in range(6):
        tau[j] = 0.0
        for i in range(6):
            tau[j] += J[i, j] * wrench[i]
    return _contact(wrench, covariance, push.quick + push.lasting, odds)


@njit(cache=True, nogil=True, error_model="numpy")
def _contact(wrench, covariance, push, odds):  # pragma: no cover - compiled
    """Probability that the wrench is not zero: odds times the prior's density at zero over the posterior's."""
    score = odds
    L, z = np.empty((6, 6)), np.empty(6)
    for i in range(6):
        z[i] = wrench[i]
        for j in range(i + 1):
            total = covariance[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if total <= 1e-9 * push[i]:
                    # Known to be untouched.
                    return 0.0
                L[i, i] = math.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
        for k in range(i):
            z[i] -= L[i, k] * z[k]
        z[i] /= L[i, i]
        score += 0.5 * z[i] * z[i] + math.log(L[i, i]) - 0.5 * math.log(push[i])
    if score > 0.0:
        return 1.0 / (1.0 + math.exp(-score))
    return math.exp(score) / (1.0 + math.exp(score))
