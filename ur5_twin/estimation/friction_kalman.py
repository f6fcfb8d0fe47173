"""Our estimator: a Kalman filter in which wrench and friction compete for what the current map does not explain.

The measurement is, per joint, the torque that the measured current has over the expected one
(``estimation.expected_current``), against the motor::

    (i_map - i) / slope = J' w + slow + fast

- w, the wrench at the flange of whatever touches the arm, wanders about zero: a first-order process of a given size and
  length, wide enough for contacts elsewhere than at the flange;
- slow and fast, per joint, are how the map errs on logs it has not seen, with the sizes and time constants that its
  identification found for motion and for rest (``identification.residual``). At rest slow is friction: it stays as it
  is while the encoder does, and where the encoder moves it turns round to oppose the way. That a push has to overcome
  it, and is not seen in the current before it has, is all in there.

Most of the time nothing touches an arm, and then w is not small but nothing. So the filter's own answer, which is that
of an arm that is touched, is weighed against w = 0 at every sample by the Bayes factor of the two (Savage and Dickey):
the estimate is the filter's times the probability of contact. The stated covariance is that of a touched arm about the
estimate, whatever the probability: an interval that holds only where nothing happens is of no use. It starts untouched,
as a force sensor is tared. What no joint feels near a singularity stays at the prior.

The probability of contact that goes with the estimate adds the odds of a push that is lost in a sample's noise and
shows by lasting (``estimation.onset``). The estimate is not weighed by those: this filter forgets too soon to say how
large such a push is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from ur5_twin.drives.current_map import SETTLING, SETTLING_TIME, TURNING
from ur5_twin.errors import EstimationError
from ur5_twin.estimation._kernels import whitened
from ur5_twin.estimation.expected_current import ExpectedCurrent
from ur5_twin.estimation.intake import Intake, Step
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.onset import Onset
from ur5_twin.estimation.protocol import Estimate, Sample
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
#: States: the wrench, and the slow and the fast part of each joint's error.
_SLOW, _FAST, _N = 6, 12, 18
#: An innovation beyond this many standard deviations counts as that many: a spike is no push.
_LARGEST = 5.0
#: A probability that counts as certain.
_CERTAIN = 1.0 - 1e-12
#: Variance of a torque that the filter takes for exact, Nm^2; it keeps the innovation's from vanishing.
_LEAST = 1e-3


class _Contact(NamedTuple):
    """What is expected of a wrench: variances (6,) in N^2 and Nm^2, s, and the log odds that there is one."""

    variance: np.ndarray
    length: float
    odds: float


class FrictionKalman:
    """The filter above, with the numbers of ``[friction_kalman]``."""

    def __init__(self, nominal: NominalModel) -> None:
        spec = nominal.settings.friction_kalman
        if not nominal.current_map.residuals:
            raise EstimationError(
                f"drive {nominal.current_map.name} does not say how it errs: it has not been tried on logs"
            )
        self._expected = ExpectedCurrent(nominal)
        self._intake = Intake(_NEEDED)
        self._solver = WrenchSolver(nominal)
        variance = np.array([spec.force_n**2] * 3 + [spec.moment_nm**2] * 3)
        self._contact = _Contact(variance, spec.push_s, math.log(_odds(spec.prior_contact)))
        self._error = np.array(nominal.current_map.residuals)
        # Sizes of the four parts; the turned friction's spread.
        self._error[:, [0, 2, 4, 6]] *= spec.doubt
        self._spread = spec.doubt * spec.turned * self._error[:, 8]
        self._x, self._P = np.zeros(_N), np.zeros((_N, _N))
        self._rested, self._q = np.full(6, np.inf), np.zeros(6)
        self._onset = Onset(nominal.settings.onset, nominal.current_map.residuals)
        self._last = self._solver.unknown()
        self._new = True

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
            _begin(self._x, self._P, self._error, self._expected.slope, self._contact, 0.0 if self._new else 1.0)
            self._q[:] = held.actual_q
            self._onset.restart()
            self._new = False
        wrench, covariance, tau = np.empty(6), np.empty((6, 6)), np.empty(6)
        touched = _step(
            self._x,
            self._P,
            self._rested,
            self._q,
            self._intake.dt,
            self._error,
            self._spread,
            self._contact,
            self._solver.J,
            held.actual_q,
            held.actual_current,
            self._expected.current,
            self._expected.slope,
            self._expected.moving,
            wrench,
            covariance,
            tau,
        )
        contact = self._contacted(touched)
        self._last = Estimate(tau, wrench, covariance, contact, self._solver.sigma_min)
        return self._last

    def _contacted(self, touched: float) -> float:
        """Probability of contact: a push of any course or, in motion, a small one that lasts."""
        expected, held = self._expected, self._intake.sample
        begun = self._onset.update(
            self._intake.dt,
            (expected.current - held.actual_current) / expected.slope,
            self._solver.J,
            expected.slope,
            expected.moving,
            expected.friction / expected.slope,
            expected.torque,
            self._last.contact > 0.5,
        )
        odds = _odds(min(touched, _CERTAIN)) + begun
        return odds / (1.0 + odds)


def _odds(probability: float) -> float:
    return probability / (1.0 - probability)


@njit(cache=True, nogil=True)
def _begin(x, P, error, slope, contact, share):  # pragma: no cover - compiled
    """At rest, with a share of the wrench's prior variance: none where it is known that nothing touches the arm."""
    x[:] = 0.0
    P[:] = 0.0
    for j in range(6):
        P[j, j] = share * contact.variance[j]
        P[_SLOW + j, _SLOW + j] = (error[j, 4] / slope[j]) ** 2
        P[_FAST + j, _FAST + j] = (error[j, 6] / slope[j]) ** 2


@njit(cache=True, nogil=True, error_model="numpy")
def _predict(x, P, rested, q, dt, error, spread, contact, angle, slope, moving):  # pragma: no cover - compiled
    for j in range(6):
        rested[j] = 0.0 if moving[j] else rested[j] + dt
        first = 0 if moving[j] else 4
        slow_time = error[j, first + 1]
        if not moving[j] and rested[j] < SETTLING:
            slow_time = SETTLING_TIME
        _wander(x, P, j, math.exp(-dt / contact.length), math.sqrt(contact.variance[j]))
        _wander(x, P, _SLOW + j, math.exp(-dt / slow_time), error[j, first] / slope[j])
        _wander(x, P, _FAST + j, math.exp(-dt / error[j, first + 3]), error[j, first + 2] / slope[j])
        way = angle[j] - q[j]
        q[j] = angle[j]
        if not moving[j] and way != 0.0:
            keep = math.exp(-abs(way) / TURNING)
            _wander(x, P, _SLOW + j, keep, spread[j] / slope[j])
            # Friction opposes the way, as a push against it would.
            x[_SLOW + j] -= (1.0 - keep) * math.copysign(error[j, 8] / slope[j], way)


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
    x, P, rested, q, dt, error, spread, contact, J, angle, current, expected, slope, moving, wrench, covariance, tau
):  # pragma: no cover - compiled  # fmt: skip
    _predict(x, P, rested, q, dt, error, spread, contact, angle, slope, moving)
    Ph = np.empty(_N)
    for j in range(6):
        innovation = (expected[j] - current[j]) / slope[j] - x[_SLOW + j] - x[_FAST + j]
        for i in range(6):
            innovation -= J[i, j] * x[i]
        for i in range(_N):
            Ph[i] = P[i, _SLOW + j] + P[i, _FAST + j]
            for k in range(6):
                Ph[i] += P[i, k] * J[k, j]
        total = _LEAST + Ph[_SLOW + j] + Ph[_FAST + j]
        for i in range(6):
            total += J[i, j] * Ph[i]
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
    touched = _probability(x, P, contact)
    for i in range(6):
        wrench[i] = touched * x[i]
        for k in range(6):
            covariance[i, k] = P[i, k] + (1.0 - touched) ** 2 * x[i] * x[k]
    for j in range(6):
        tau[j] = 0.0
        for i in range(6):
            tau[j] += J[i, j] * wrench[i]
    return touched


@njit(cache=True, nogil=True, error_model="numpy")
def _probability(x, P, contact):  # pragma: no cover - compiled
    """Probability that the wrench is not zero: odds times the prior's density at zero over the posterior's."""
    z = np.empty(_SLOW)
    score = contact.odds + whitened(P, x, 1e-9 * contact.variance, z)
    if math.isnan(score):
        # Known to be untouched.
        return 0.0
    for i in range(_SLOW):
        score += 0.5 * z[i] * z[i] - 0.5 * math.log(contact.variance[i])
    if score > 0.0:
        return 1.0 / (1.0 + math.exp(-score))
    return math.exp(score) / (1.0 + math.exp(score))
