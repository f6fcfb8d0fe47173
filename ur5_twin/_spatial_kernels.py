"""Compiled kernels of ``spatial`` for what a tick needs of single vectors and rotations: numpy's and scipy's numbers to
the bit, without the cost of a call into them."""

from __future__ import annotations

import math

import numba
import numpy as np

#: Below this angle the rotation vector's scale is a series, rad; as scipy has it.
_SMALL = 1e-3


@numba.njit(cache=True, nogil=True, error_model="numpy")
def cross_rows(a, b, out):  # pragma: no cover - compiled
    """a x b of rows (n, 3) or (1, 3)."""
    for k in range(out.shape[0]):
        i, j = k % a.shape[0], k % b.shape[0]
        out[k, 0] = a[i, 1] * b[j, 2] - a[i, 2] * b[j, 1]
        out[k, 1] = a[i, 2] * b[j, 0] - a[i, 0] * b[j, 2]
        out[k, 2] = a[i, 0] * b[j, 1] - a[i, 1] * b[j, 0]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def vectors_from_rotations(R, out):  # pragma: no cover - compiled
    """Rotation vectors (n, 3), rad, of exact rotations (n, 3, 3), through the quaternion x y z w."""
    q = np.empty(4)
    for n in range(R.shape[0]):
        M = R[n]
        trace = M[0, 0] + M[1, 1] + M[2, 2]
        i, most = 0, M[0, 0]
        for c in range(1, 3):
            if M[c, c] > most:
                i, most = c, M[c, c]
        if trace > most:
            q[0], q[1], q[2] = M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1]
            q[3] = 1.0 + trace
        else:
            j, k = (i + 1) % 3, (i + 2) % 3
            q[i] = 1.0 - trace + 2.0 * M[i, i]
            q[j], q[k] = M[j, i] + M[i, j], M[k, i] + M[i, k]
            q[3] = M[k, j] - M[j, k]
        norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        for c in range(4):
            q[c] /= norm
        # Of the two quaternions the one whose angle is at most pi; at pi itself the first number that is not zero.
        flip = q[3] < 0.0
        for c in range(3):
            if q[3] == 0.0 and q[c] != 0.0:
                flip = q[c] < 0.0
                break
        if flip:
            for c in range(4):
                q[c] = -q[c]
        angle = 2.0 * math.atan2(math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]), q[3])
        square = angle * angle
        scale = 2.0 + square / 12.0 + 7.0 * square * square / 2880.0
        if angle > _SMALL:
            scale = angle / math.sin(angle / 2.0)
        for c in range(3):
            out[n, c] = scale * q[c]
