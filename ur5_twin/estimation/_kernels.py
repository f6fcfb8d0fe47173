"""Compiled steps that the estimators share, one sample at a time over arrays that are kept."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ur5_twin.arm._dynamics_kernels import coriolis_into, gravity_into, mass_matrix_into
from ur5_twin.arm._kinematics_kernels import frames_into, jacobian_into

#: Variance of a joint torque below which nobody knows it, Nm^2; it keeps the solution's condition in bounds.
_LEAST_VARIANCE = 1e-6
_FLANGE = np.zeros(3)


@njit(cache=True, nogil=True)
def lacking(rows):  # pragma: no cover - compiled
    """Which of the rows (n, width) hold a NaN or an infinity, bit by bit."""
    bits = 0
    for i in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            if not math.isfinite(rows[i, j]):
                bits |= 1 << i
    return bits


@njit(cache=True, nogil=True)
def take(rows, held, lacking):  # pragma: no cover - compiled
    """Rows (n, width) over ``held``, without those whose bit is set in ``lacking``."""
    for i in range(rows.shape[0]):
        if not (lacking >> i) & 1:
            held[i, :] = rows[i]


@njit(cache=True, nogil=True)
def momentum(packed, q, qd, torque, M, C, g, p, u):  # pragma: no cover - compiled
    """p = M qd and u = torque + C' qd - g of one sample, so that p' = u + tau_ext (M' - 2C is skew)."""
    mass_matrix_into(packed, q, M)
    coriolis_into(packed, q, qd, C)
    gravity_into(packed, q, g)
    for i in range(6):
        p[i] = 0.0
        u[i] = torque[i] - g[i]
        for j in range(6):
            p[i] += M[i, j] * qd[j]
            u[i] += C[j, i] * qd[j]


@njit(cache=True, nogil=True)
def mean_torque(dt, p, u, qd, p_before, u_before, qd_before, rate, drive, mean, qdd):  # pragma: no cover - compiled
    """Mean external torque between two samples: (p - p_before) / dt - (u + u_before) / 2, and the two apart.

    qdd is the mean acceleration. The state moves on by a sample.
    """
    for i in range(6):
        qdd[i] = (qd[i] - qd_before[i]) / dt
        qd_before[i] = qd[i]
        rate[i] = (p[i] - p_before[i]) / dt
        drive[i] = 0.5 * (u[i] + u_before[i])
        mean[i] = rate[i] - drive[i]
        p_before[i] = p[i]
        u_before[i] = u[i]


@njit(cache=True, nogil=True)
def momentum_variance(M, velocity, out):  # pragma: no cover - compiled
    """Variance (6,) of p = M qd from the standard deviation (6,) of qd."""
    for i in range(6):
        out[i] = 0.0
        for j in range(6):
            out[i] += (M[i, j] * velocity[j]) ** 2


@njit(cache=True, nogil=True, inline="always")
def averaged_variance(share, dt, white, momentum):  # pragma: no cover - compiled
    """Variance of x <- x + share (mean - x) when torque and momentum carry white noise.

    Two samples' torques are averaged in each mean, and neighbours share one: share / 2 of the torque's variance stays.
    The momentum's noise comes as a difference: of its variance 2 share^2 / ((2 - share) dt^2) stays.
    """
    return 0.5 * share * white + 2.0 * (share / dt) ** 2 * momentum / (2.0 - share)


@njit(cache=True, nogil=True)
def flange_jacobian(dh, q, frames, J):  # pragma: no cover - compiled
    """J (6, 6) of the flange and its smallest singular value."""
    frames_into(dh, q, frames)
    jacobian_into(frames, 6, _FLANGE, J)
    return np.linalg.svd(J)[1][5]


@njit(cache=True, nogil=True)
def information(J, tau, variance, A, b):  # pragma: no cover - compiled
    """What joint torques say of the wrench: A = J R^-1 J' (6, 6) and b = J R^-1 tau (6,), R = diag(variance)."""
    for i in range(6):
        b[i] = 0.0
        for k in range(i, 6):
            A[i, k] = 0.0
        for j in range(6):
            weight = J[i, j] / max(variance[j], _LEAST_VARIANCE)
            b[i] += weight * tau[j]
            for k in range(i, 6):
                A[i, k] += weight * J[k, j]
    for i in range(6):
        for k in range(i):
            A[i, k] = A[k, i]


@njit(cache=True, nogil=True)
def posterior(A, b, prior, prior_odds, wrench, covariance):  # pragma: no cover - compiled
    """Mean and covariance of a wrench with prior N(0, diag(prior)), and the probability that there is one.

    covariance = (A + S0^-1)^-1, wrench = covariance b. Against no wrench at all the torques' likelihood is higher by
    exp(b' wrench / 2) / sqrt(det S0 det(A + S0^-1)).
    """
    L = np.empty((6, 6))
    log_det = 0.0
    for i in range(6):
        for j in range(i + 1):
            total = A[i, j] + (1.0 / prior[i] if i == j else 0.0)
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = math.sqrt(total) if i == j else total / L[j, j]
        log_det += 2.0 * math.log(L[i, i]) + math.log(prior[i])
    column = np.empty(6)
    for c in range(6):
        for i in range(c, 6):
            total = 1.0 if i == c else 0.0
            for k in range(c, i):
                total -= L[i, k] * column[k]
            column[i] = total / L[i, i]
        # Row c of L^-1' is done from below, over what stands there.
        for i in range(5, -1, -1):
            total = column[i] if i >= c else 0.0
            for k in range(i + 1, 6):
                total -= L[k, i] * covariance[k, c]
            covariance[i, c] = total / L[i, i]
    gain = 0.0
    for i in range(6):
        wrench[i] = 0.0
        for k in range(6):
            wrench[i] += 0.5 * (covariance[i, k] + covariance[k, i]) * b[k]
        gain += b[i] * wrench[i]
    for i in range(6):
        for k in range(i):
            covariance[i, k] = covariance[k, i] = 0.5 * (covariance[i, k] + covariance[k, i])
    score = 0.5 * (gain - log_det) + prior_odds
    if score > 0.0:
        return 1.0 / (1.0 + math.exp(-score))
    # Written so that exp does not overflow.
    return math.exp(score) / (1.0 + math.exp(score))


@njit(cache=True, nogil=True)
def torque_of(J, wrench, tau):  # pragma: no cover - compiled
    """tau = J' wrench."""
    for j in range(6):
        tau[j] = 0.0
        for i in range(6):
            tau[j] += J[i, j] * wrench[i]


@njit(cache=True, nogil=True, error_model="numpy")
def whitened(A, b, least, y):  # pragma: no cover - compiled
    """y with L y = b, where A = L L' (n, n), and log det L; NaN where a pivot is not above its ``least`` (n,)."""
    n = y.shape[0]
    L = np.empty((n, n))
    log = 0.0
    for i in range(n):
        y[i] = b[i]
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if j < i:
                L[i, j] = total / L[j, j]
            elif total > least[i]:
                L[i, i] = math.sqrt(total)
            else:
                return math.nan
        for k in range(i):
            y[i] -= L[i, k] * y[k]
        y[i] /= L[i, i]
        log += math.log(L[i, i])
    return log
