"""Compiled kinematics of a serial arm with six revolute joints and any standard DH parameters."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def frames_into(dh, q, out):
    """Poses of DH frames 0 to 6 in the base frame of one sample into out (7, 4, 4).

    Args:
        dh: (6, 4), one row a joint: cos alpha, sin alpha, a, d.
        q: (6,), rad.
    """
    out[:, :, :] = 0.0
    for k in range(4):
        out[0, k, k] = 1.0
    for i in range(6):
        ca, sa, a, d = dh[i, 0], dh[i, 1], dh[i, 2], dh[i, 3]
        c, s = math.cos(q[i]), math.sin(q[i])
        for r in range(3):
            x, y, z = out[i, r, 0], out[i, r, 1], out[i, r, 2]
            along = c * x + s * y
            across = c * y - s * x
            out[i + 1, r, 0] = along
            out[i + 1, r, 1] = ca * across + sa * z
            out[i + 1, r, 2] = ca * z - sa * across
            out[i + 1, r, 3] = out[i, r, 3] + a * along + d * z
        out[i + 1, 3, 3] = 1.0


@njit(cache=True, nogil=True)
def frames_rows(dh, q, out):
    """``frames_into`` for every row of q (n, 6) into out (n, 7, 4, 4)."""
    for k in range(q.shape[0]):
        frames_into(dh, q[k], out[k])


@njit(cache=True, nogil=True)
def jacobian_into(frames, link, point, out):
    """Geometric Jacobian of a point of one sample into out (6, 6): [z x (p - o); z] for joints 1 to ``link``.

    Args:
        frames: (7, 4, 4) from ``frames_into``.
        link: 1 to 6.
        point: (3,) in the link's frame, m.
    """
    out[:, :] = 0.0
    X = frames[link]
    px = X[0, 0] * point[0] + X[0, 1] * point[1] + X[0, 2] * point[2] + X[0, 3]
    py = X[1, 0] * point[0] + X[1, 1] * point[1] + X[1, 2] * point[2] + X[1, 3]
    pz = X[2, 0] * point[0] + X[2, 1] * point[1] + X[2, 2] * point[2] + X[2, 3]
    for i in range(link):
        zx, zy, zz = frames[i, 0, 2], frames[i, 1, 2], frames[i, 2, 2]
        rx, ry, rz = px - frames[i, 0, 3], py - frames[i, 1, 3], pz - frames[i, 2, 3]
        out[0, i], out[1, i], out[2, i] = zy * rz - zz * ry, zz * rx - zx * rz, zx * ry - zy * rx
        out[3, i], out[4, i], out[5, i] = zx, zy, zz


@njit(cache=True, nogil=True)
def jacobian_dot_into(J, qd, link, out):
    """Time derivative of a geometric Jacobian of one sample into out (6, 6).

    Column i of J is [z_i x r_i; z_i] with r_i from the joint to the point. Joint k before i turns both, and
    (z_k x z_i) x r_i + z_i x (z_k x r_i) = z_k x (z_i x r_i). Joint k from i on only moves the point, by z_k x r_k,
    and leaves z_i x (z_k x r_k). The columns of J already hold those products.
    """
    out[:, :] = 0.0
    for i in range(link):
        for k in range(link):
            a, b = (k, i) if k < i else (i, k)
            zx, zy, zz = J[3, a], J[4, a], J[5, a]
            vx, vy, vz = J[0, b], J[1, b], J[2, b]
            out[0, i] += (zy * vz - zz * vy) * qd[k]
            out[1, i] += (zz * vx - zx * vz) * qd[k]
            out[2, i] += (zx * vy - zy * vx) * qd[k]
            if k < i:
                ux, uy, uz = J[3, i], J[4, i], J[5, i]
                out[3, i] += (zy * uz - zz * uy) * qd[k]
                out[4, i] += (zz * ux - zx * uz) * qd[k]
                out[5, i] += (zx * uy - zy * ux) * qd[k]


@njit(cache=True, nogil=True)
def jacobian_rows(dh, q, link, point, out):
    """``jacobian_into`` for every row of q (n, 6) into out (n, 6, 6)."""
    frames = np.empty((7, 4, 4))
    for k in range(q.shape[0]):
        frames_into(dh, q[k], frames)
        jacobian_into(frames, link, point, out[k])


@njit(cache=True, nogil=True)
def jacobian_dot_rows(J, qd, link, out):
    """``jacobian_dot_into`` for every row of J (n, 6, 6) and qd (n, 6) into out (n, 6, 6)."""
    for k in range(qd.shape[0]):
        jacobian_dot_into(J[k], qd[k], link, out[k])


@njit(cache=True, nogil=True)
def motion_rows(dh, q, qd, qdd, twist, acceleration):
    """Twist J qd and acceleration J qdd + J' qd of the flange for every row of (n, 6) arrays into (n, 6) each."""
    frames = np.empty((7, 4, 4))
    J, J_dot = np.empty((6, 6)), np.empty((6, 6))
    origin = np.zeros(3)
    for k in range(q.shape[0]):
        frames_into(dh, q[k], frames)
        jacobian_into(frames, 6, origin, J)
        jacobian_dot_into(J, qd[k], 6, J_dot)
        for i in range(6):
            v, a = 0.0, 0.0
            for j in range(6):
                v += J[i, j] * qd[k, j]
                a += J[i, j] * qdd[k, j] + J_dot[i, j] * qd[k, j]
            twist[k, i] = v
            acceleration[k, i] = a


@njit(cache=True, nogil=True)
def rotation_vector_into(X, out):
    """Rotation vector (3,), rad, of the rotation in X (4, 4), through the quaternion, whose largest part is not small.

    At pi either sign may come out.
    """
    trace = X[0, 0] + X[1, 1] + X[2, 2]
    w, x, y, z = 0.0, 0.0, 0.0, 0.0
    if trace >= X[0, 0] and trace >= X[1, 1] and trace >= X[2, 2]:
        w = 1.0 + trace
        x, y, z = X[2, 1] - X[1, 2], X[0, 2] - X[2, 0], X[1, 0] - X[0, 1]
    elif X[0, 0] >= X[1, 1] and X[0, 0] >= X[2, 2]:
        x = 1.0 + X[0, 0] - X[1, 1] - X[2, 2]
        w, y, z = X[2, 1] - X[1, 2], X[1, 0] + X[0, 1], X[0, 2] + X[2, 0]
    elif X[1, 1] >= X[2, 2]:
        y = 1.0 + X[1, 1] - X[0, 0] - X[2, 2]
        w, x, z = X[0, 2] - X[2, 0], X[1, 0] + X[0, 1], X[2, 1] + X[1, 2]
    else:
        z = 1.0 + X[2, 2] - X[0, 0] - X[1, 1]
        w, x, y = X[1, 0] - X[0, 1], X[0, 2] + X[2, 0], X[2, 1] + X[1, 2]
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    size = math.sqrt(x * x + y * y + z * z)
    # angle / |v| for the quaternion (w, v), which need not be of length one; 2 / w where v vanishes.
    scale = 2.0 * math.atan2(size, w) / size if size > 0.0 else 2.0 / w
    out[0], out[1], out[2] = scale * x, scale * y, scale * z


@njit(cache=True, nogil=True)
def poses_rows(dh, q, out):
    """Position and rotation vector of the flange for every row of q (n, 6) into out (n, 6)."""
    frames = np.empty((7, 4, 4))
    for k in range(q.shape[0]):
        frames_into(dh, q[k], frames)
        for i in range(3):
            out[k, i] = frames[6, i, 3]
        rotation_vector_into(frames[6], out[k, 3:])
