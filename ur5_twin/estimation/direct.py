"""The thesis' direct residual: the current's torque less what the motion needs (equations 6.8 and 6.9).

F = J^-T (k i + b - tau_mu) and F* = J^-T (k i + b - tau_mu - tau_fr), tau_mu = M qdd + C qd + g, low-passed by a
Butterworth filter of order 5 (equation 5.12), with the thesis' own k, b and friction (``[thesis]`` of
``models/drives.toml``). q and qd are the measured ones; qdd is the target's, the only acceleration that is published.
The thesis' F is what the arm exerts, and so the wrench here is its negative. J^-T is the solution of
``estimation.wrench`` for torques known to 2 Nm, whatever friction leaves in them: the plain inverse but near singular
postures, where it stays finite. The covariance is that of what friction does leave.

The thesis filters logs as a whole, to and fro, which a running estimator cannot: ``direct`` and ``direct_friction`` run
the same filter forwards (and are late by some 0.35 s at its 1.454 Hz), ``zero_phase`` does what the thesis did.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numba import njit
from scipy.signal import butter, sosfilt_zi, sosfiltfilt

from ur5_twin.arm.dynamics import rnea_into
from ur5_twin.estimation.intake import Intake, Step
from ur5_twin.estimation.motor_torque import MOVING
from ur5_twin.estimation.nominal import PERIOD, NominalModel
from ur5_twin.estimation.protocol import Estimate, Sample
from ur5_twin.estimation.wrench import WrenchSolver

#: Variance of the torques that are inverted, Nm^2: damps directions whose singular value is below 2 Nm / 150 N.
_INVERTED = np.full(6, 4.0)


class Direct:
    """F: friction left in, and so taken for force."""

    friction = False

    def __init__(self, nominal: NominalModel) -> None:
        self.solver = WrenchSolver(nominal)
        self.sos = butter_of(nominal)
        self.raw = np.zeros(6)
        self.variance = np.zeros(6)
        self._nominal, self._linear, self._noise = nominal, nominal.linear, nominal.noise
        self._zi = sosfilt_zi(self.sos)
        self._state: np.ndarray | None = None
        self._intake = Intake()
        self._tau, self._wrench = np.empty(6), np.empty(6)
        self._share = nominal.settings.motor_torque.friction_share
        self._last = self.solver.unknown()

    def update(self, sample: Sample) -> Estimate:
        """The estimate at this sample (``protocol.Estimator``)."""
        if not self.look(sample):
            return self._last
        if self._state is None:
            # As if the first wrench had been there for ever: no step from zero.
            self._state = self._zi[:, :, None] * self.raw
        _filtered(self.sos, self._state, self.raw, self._wrench)
        self._last = self.solver.around(self._wrench, self.variance)
        return self._last

    def look(self, sample: Sample) -> bool:
        """Write the wrench of this sample, without the filter, to ``raw``; False if the sample lacks something."""
        if self._intake.update(sample) is Step.NOTHING:
            return False
        good, linear, noise = self._intake.sample, self._linear, self._noise
        _residual(
            self._nominal.packed,
            good.actual_q,
            good.actual_qd,
            good.target_qdd,
            good.actual_current,
            linear.torque_constant,
            linear.offset,
            linear.coulomb,
            linear.viscous,
            linear.dead_zone,
            self.friction,
            noise.current,
            noise.current_moving,
            self._share if self.friction else 1.0,
            self._tau,
            self.variance,
        )
        self.solver.look(good.actual_q)
        self.raw = self.solver.solve(self._tau, _INVERTED).wrench
        return True


class DirectFriction(Direct):
    """F*: with the thesis' Coulomb and viscous friction taken off."""

    friction = True


def butter_of(nominal: NominalModel) -> np.ndarray:
    """Second-order sections of the low-pass of ``[direct]`` at the robot's rate."""
    spec = nominal.settings.direct
    return np.asarray(butter(spec.order, spec.cutoff_hz, fs=1.0 / PERIOD, output="sos"))


def zero_phase(nominal: NominalModel, samples: Iterable[Sample]) -> list[Estimate]:
    """F of a whole log, filtered to and fro as in the thesis. NOT causal: each row knows what comes after it."""
    return _zero_phase(Direct(nominal), samples)


def zero_phase_friction(nominal: NominalModel, samples: Iterable[Sample]) -> list[Estimate]:
    """F* of a whole log, filtered to and fro as in the thesis. NOT causal: each row knows what comes after it."""
    return _zero_phase(DirectFriction(nominal), samples)


def _zero_phase(estimator: Direct, samples: Iterable[Sample]) -> list[Estimate]:
    rows = []
    for sample in samples:
        known = estimator.look(sample)
        q = sample.actual_q if known else rows[-1][0] if rows else np.zeros(6)
        rows.append((q, estimator.raw, estimator.variance.copy()))
    if not rows:
        return []
    raw = np.array([row[1] for row in rows])
    # The longest run-in that scipy would take by itself, or what there is.
    smooth = sosfiltfilt(estimator.sos, raw, axis=0, padlen=min(3 * (2 * len(estimator.sos) + 1), len(raw) - 1))
    estimates = []
    for (q, _, variance), wrench in zip(rows, smooth, strict=True):
        estimator.solver.look(np.ascontiguousarray(q))
        estimates.append(estimator.solver.around(wrench, variance))
    return estimates


@njit(cache=True, nogil=True)
def _residual(
    packed, q, qd, qdd, current, constant, offset, coulomb, viscous, dead_zone, friction, noise, noise_moving, share,
    tau, variance,
):  # pragma: no cover - compiled  # fmt: skip
    rnea_into(packed, q, qd, qdd, tau)
    for j in range(6):
        tau[j] -= constant[j] * current[j] + offset[j]
        if friction:
            direction = 0.0 if abs(qd[j]) <= dead_zone else 1.0 if qd[j] > 0.0 else -1.0
            tau[j] += coulomb[j] * direction + viscous[j] * qd[j]
        level = coulomb[j] + viscous[j] * abs(qd[j])
        variance[j] = (constant[j] * noise[j]) ** 2
        if abs(qd[j]) > MOVING:
            variance[j] += (constant[j] * noise_moving[j]) ** 2 + (share * level) ** 2
        else:
            variance[j] += level**2 / 3.0


@njit(cache=True, nogil=True)
def _filtered(sos, state, x, out):  # pragma: no cover - compiled
    """One row x (6,) through second-order sections, direct form II transposed; state (sections, 2, 6) moves on."""
    for j in range(x.shape[0]):
        value = x[j]
        for n in range(sos.shape[0]):
            y = sos[n, 0] * value + state[n, 0, j]
            state[n, 0, j] = sos[n, 1] * value - sos[n, 4] * y + state[n, 1, j]
            state[n, 1, j] = sos[n, 2] * value - sos[n, 5] * y
            value = y
        out[j] = value
