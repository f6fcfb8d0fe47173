"""Feedback linearisation with a PD law (thesis equations 2.69, 2.71) and an integral, for compiled callers.

    tau = M(q) a + C(q, qd) qd + g(q),   a = A qdd_d - K0 e - K1 e' - KI int(e) dt,   e = q - q_d + T qd_d

Shapes: q, qd, kappa, integral (6,); a target is (3, 6): q_d, qd_d, qdd_d. ``packed`` is ``Dynamics.packed`` of the
model that the controller linearises with. The thesis' law has no integral and no lag: KI and T are zero and A
is one for its gains.
"""

from __future__ import annotations

import numba
import numpy as np

from ur5_twin.arm.dynamics import rnea_into

#: Acceleration that the rounding of a log's sixth decimal can feign, rad/s^2.
_ROUNDING = 0.2


@numba.njit(cache=True, nogil=True, error_model="numpy")
def reference(before, after, dt, coefficients, step):  # pragma: no cover - compiled
    """The reference from one target to the next, as a polynomial in t per joint.

    It is the quintic that has q_d, qd_d and qdd_d of both targets: held constant over a tick, the reference would lag
    by half a tick, some milliradians at the speeds of the logs. Where that quintic needs clearly more acceleration than
    the two targets ask for, the target stepped rather than moved: the real controller lets its target follow the
    measured position while it is idle, and sets it onto the measured position when a move ends (up to 4 mrad within a
    tick); a log stamped by the receiver's clock steps a little everywhere. The joint's reference then ends in the new
    target with the acceleration going straight from one target's to the other's, and begins away from the old one by
    ``step``.

    Args:
        before, after: (3, 6) targets.
        dt: s between them.
        coefficients: (6, 6) by power of t and joint, written.
        step: (2, 6) jump of q_d in rad and of qd_d in rad/s at t = 0, written; zero where the target moved.
    """
    c = coefficients
    for j in range(6):
        q0, v0, a0 = before[0, j], before[1, j], before[2, j]
        q1, v1, a1 = after[0, j], after[1, j], after[2, j]
        d = q1 - q0
        c[0, j] = q0
        c[1, j] = v0
        c[2, j] = 0.5 * a0
        c[3, j] = (20.0 * d - (8.0 * v1 + 12.0 * v0) * dt - (3.0 * a0 - a1) * dt**2) / (2.0 * dt**3)
        c[4, j] = (-30.0 * d + (14.0 * v1 + 16.0 * v0) * dt + (3.0 * a0 - 2.0 * a1) * dt**2) / (2.0 * dt**4)
        c[5, j] = (12.0 * d - 6.0 * (v1 + v0) * dt + (a1 - a0) * dt**2) / (2.0 * dt**5)
        peak = 0.0
        for k in range(1, 8):
            t = 0.125 * k * dt
            peak = max(peak, abs(2.0 * c[2, j] + t * (6.0 * c[3, j] + t * (12.0 * c[4, j] + t * 20.0 * c[5, j]))))
        if peak > 1.5 * max(abs(a0), abs(a1)) + _ROUNDING:
            c[0, j] = q1 - v1 * dt + (a0 / 6.0 + a1 / 3.0) * dt**2
            c[1, j] = v1 - 0.5 * (a0 + a1) * dt
            c[3, j] = (a1 - a0) / (6.0 * dt)
            c[4, j] = 0.0
            c[5, j] = 0.0
        step[0, j] = c[0, j] - q0
        step[1, j] = c[1, j] - v0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def demand(c, t, j, q, qd, kappa0, kappa1, kappai, lag, share, integral):  # pragma: no cover - compiled
    """The servo's acceleration for joint j with the reference at time t of the polynomial, and the position error."""
    q_d = c[0, j] + t * (c[1, j] + t * (c[2, j] + t * (c[3, j] + t * (c[4, j] + t * c[5, j]))))
    qd_d = c[1, j] + t * (2.0 * c[2, j] + t * (3.0 * c[3, j] + t * (4.0 * c[4, j] + t * 5.0 * c[5, j])))
    qdd_d = 2.0 * c[2, j] + t * (6.0 * c[3, j] + t * (12.0 * c[4, j] + t * 20.0 * c[5, j]))
    error = q - q_d + lag[j] * qd_d
    rate = qd - qd_d + lag[j] * qdd_d
    return share[j] * qdd_d - kappa0[j] * error - kappa1[j] * rate - kappai[j] * integral[j], error


@numba.njit(cache=True, nogil=True, error_model="numpy")
def law(target, q, qd, kappa0, kappa1, kappai, lag, share, integral, packed, torque):  # pragma: no cover - compiled
    """The control law at a sample."""
    a = np.empty(6)
    for j in range(6):
        error = q[j] - target[0, j] + lag[j] * target[1, j]
        rate = qd[j] - target[1, j] + lag[j] * target[2, j]
        a[j] = share[j] * target[2, j] - kappa0[j] * error - kappa1[j] * rate - kappai[j] * integral[j]
    rnea_into(packed, q, qd, a, torque)
