"""Rotations, poses, twists and wrenches, for one sample or any number of leading axes.

``X_AB`` is the pose of frame B in frame A, (..., 4, 4); ``R_AB`` its rotation (..., 3, 3): v_A = R_AB v_B. A wrench is
[force; moment], a twist [linear; angular], both (..., 6). Angles are in rad, lengths in m.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy.typing import ArrayLike

from ur5_twin import _spatial_kernels as kernels

#: What the six numbers of a wrench are called.
WRENCH_AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
WRENCH_UNITS = ("N", "N", "N", "Nm", "Nm", "Nm")
#: Below this |sin theta| the first and third ZYZ angle are not defined well enough to differentiate.
ZYZ_SINGULAR_SIN = 1e-9


def skew(v: ArrayLike) -> np.ndarray:
    """S(v) (..., 3, 3) with S(v) w = v x w, from v (..., 3) (thesis appendix A.2)."""
    v = np.asarray(v, dtype=float)
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def cross(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """a x b (..., 3), to the bit what numpy's makes of it at a fifth of its cost for single vectors."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    shape = np.broadcast_shapes(a.shape, b.shape)
    out = np.empty(shape)
    if len(shape) == 2:
        kernels.cross_rows(a.reshape(-1, 3), b.reshape(-1, 3), out)
        return out
    out[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    out[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    out[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out


def rotation_from_vector(r: ArrayLike) -> np.ndarray:
    """R (..., 3, 3) = exp(S(r)) from rotation vectors r (..., 3), rad (thesis equation 2.8)."""
    from scipy.spatial.transform import Rotation  # half of this package's users never need scipy's import time

    r = np.asarray(r, dtype=float)
    return Rotation.from_rotvec(r.reshape(-1, 3)).as_matrix().reshape(*r.shape, 3)


def vector_from_rotation(R: ArrayLike, *, exact: bool = False) -> np.ndarray:
    """Rotation vectors (..., 3), rad, of length 0 to pi, from R (..., 3, 3); the inverse of ``rotation_from_vector``.

    Well conditioned up to and at pi, where the thesis' equations 2.9 and 2.10 divide by zero (it goes through the
    quaternion). At pi exactly r and -r are the same rotation and either may be returned.

    Args:
        R: rotations.
        exact: they are rotations to rounding; otherwise the nearest ones are looked for, at far greater cost.
    """
    R = np.asarray(R, dtype=float)
    if exact:
        out = np.empty((R.size // 9, 3))
        kernels.vectors_from_rotations(R.reshape(-1, 3, 3), out)
        return out.reshape(R.shape[:-1])
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(R.shape[:-1])


def rotation_angle(R: ArrayLike) -> np.ndarray:
    """Angle (...), 0 to pi rad, of rotations R (..., 3, 3)."""
    return np.linalg.norm(vector_from_rotation(R), axis=-1)


def rotation_from_zyz(phi: ArrayLike) -> np.ndarray:
    """R (..., 3, 3) = Rz(phi_0) Ry(phi_1) Rz(phi_2) from Euler angles (..., 3), rad (thesis equation 2.2)."""
    phi = np.asarray(phi, dtype=float)
    (c1, c2, c3), (s1, s2, s3) = np.moveaxis(np.cos(phi), -1, 0), np.moveaxis(np.sin(phi), -1, 0)
    rows = [
        [c1 * c2 * c3 - s1 * s3, -c1 * c2 * s3 - s1 * c3, c1 * s2],
        [s1 * c2 * c3 + c1 * s3, -s1 * c2 * s3 + c1 * c3, s1 * s2],
        [-s2 * c3, s2 * s3, c2],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def zyz_from_rotation(R: ArrayLike) -> np.ndarray:
    """ZYZ Euler angles (..., 3), rad, from R (..., 3, 3): the second in [0, pi], the others in (-pi, pi].

    Thesis equations 2.4 to 2.7 in numpy's order arctan2(y, x); its appendix A.3 has the arguments the other way
    round. Where the second angle is 0 or pi only phi_0 + phi_2 (or their difference) exists and phi_0 is set to 0.
    """
    R = np.asarray(R, dtype=float)
    sin = np.hypot(R[..., 0, 2], R[..., 1, 2])
    free = sin < ZYZ_SINGULAR_SIN
    up = np.where(R[..., 2, 2] > 0.0, 1.0, -1.0)
    phi = np.where(free, 0.0, np.arctan2(R[..., 1, 2], R[..., 0, 2]))
    # With phi_0 = 0 the upper left of R is [[c2 c3, -c2 s3], [s3, c3]]; c2 is +1 or -1.
    psi = np.where(
        free,
        np.arctan2(-R[..., 0, 1] * up, R[..., 0, 0] * up),
        np.arctan2(R[..., 2, 1], -R[..., 2, 0]),
    )
    return np.stack([phi, np.arctan2(sin, R[..., 2, 2]), psi], axis=-1)


def zyz_rates(phi: ArrayLike) -> np.ndarray:
    """B (..., 3, 3) with omega = B(phi) phi', omega in the fixed axes of R = Rz(phi_0) Ry(phi_1) Rz(phi_2).

    This is thesis equation 2.33 corrected: the printed matrix has the first and the third angle exchanged.
    """
    phi = np.asarray(phi, dtype=float)
    out = np.zeros((*phi.shape, 3))
    c, s = np.cos(phi[..., :2]), np.sin(phi[..., :2])
    out[..., 0, 1], out[..., 0, 2] = -s[..., 0], c[..., 0] * s[..., 1]
    out[..., 1, 1], out[..., 1, 2] = c[..., 0], s[..., 0] * s[..., 1]
    out[..., 2, 0], out[..., 2, 2] = 1.0, c[..., 1]
    return out


def zyz_rates_inverse(phi: ArrayLike) -> np.ndarray:
    """B^-1 (..., 3, 3): phi' = B^-1 omega; nan at the representational singularity sin(phi_1) = 0 (equation 3.1)."""
    phi = np.asarray(phi, dtype=float)
    out = np.zeros((*phi.shape, 3))
    c, s = np.cos(phi[..., :2]), np.sin(phi[..., :2])
    s2 = np.where(np.abs(s[..., 1]) < ZYZ_SINGULAR_SIN, np.nan, s[..., 1])
    out[..., 2, 0], out[..., 2, 1] = c[..., 0] / s2, s[..., 0] / s2
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = -c[..., 1] * out[..., 2, 0], -c[..., 1] * out[..., 2, 1], 1.0
    out[..., 1, 0], out[..., 1, 1] = -s[..., 0], c[..., 0]
    # The middle row stays finite at the singularity; a half-valid answer is worse than none.
    out[np.isnan(s2)] = np.nan
    return out


def zyz_rates_derivative(phi: ArrayLike, phi_dot: ArrayLike) -> np.ndarray:
    """dB/dt (..., 3, 3) of ``zyz_rates`` along phi' (..., 3), rad/s."""
    phi, phi_dot = np.broadcast_arrays(np.asarray(phi, dtype=float), np.asarray(phi_dot, dtype=float))
    out = np.zeros((*phi.shape, 3))
    c, s = np.cos(phi[..., :2]), np.sin(phi[..., :2])
    c1, c2, s1, s2 = c[..., 0], c[..., 1], s[..., 0], s[..., 1]
    d1, d2 = phi_dot[..., 0], phi_dot[..., 1]
    out[..., 0, 1], out[..., 0, 2] = -c1 * d1, -s1 * s2 * d1 + c1 * c2 * d2
    out[..., 1, 1], out[..., 1, 2] = -s1 * d1, c1 * s2 * d1 + s1 * c2 * d2
    out[..., 2, 2] = -s2 * d2
    return out


def _vector_coefficients(r: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(1 - cos t)/t^2, (t - sin t)/t^3 and their derivatives by t, divided by t, for t = |r|; each (..., 1, 1)."""
    square = np.sum(r * r, axis=-1)[..., None, None]
    # Below 0.05 rad the closed forms cancel; the series' first left-out term is below 1e-16 there.
    small = square < 2.5e-3
    t2 = np.where(small, 1.0, square)
    t = np.sqrt(t2)
    c, s = np.cos(t), np.sin(t)
    x = square
    a = np.where(small, 0.5 - x / 24 + x**2 / 720 - x**3 / 40320 + x**4 / 3628800, (1 - c) / t2)
    b = np.where(small, 1 / 6 - x / 120 + x**2 / 5040 - x**3 / 362880, (t - s) / (t2 * t))
    da = np.where(small, -1 / 12 + x / 180 - x**2 / 6720 + x**3 / 453600, (t * s - 2 * (1 - c)) / t2**2)
    db = np.where(small, -1 / 60 + x / 1260 - x**2 / 60480 + x**3 / 4989600, (3 * s - 2 * t - t * c) / (t2**2 * t))
    return a, b, da, db


def vector_rates(r: ArrayLike) -> np.ndarray:
    """B (..., 3, 3) with omega = B(r) r', omega in the fixed axes of R = exp(S(r)): I + a S(r) + b S(r)^2.

    a = (1 - cos t)/t^2, b = (t - sin t)/t^3, t = |r| (the left Jacobian of SO(3)).
    """
    r = np.asarray(r, dtype=float)
    a, b, _, _ = _vector_coefficients(r)
    S = skew(r)
    return np.eye(3) + a * S + b * (S @ S)


def vector_rates_inverse(r: ArrayLike) -> np.ndarray:
    """B^-1 (..., 3, 3): r' = B^-1 omega. Regular for |r| < 2 pi, so wherever ``vector_from_rotation`` leads."""
    r = np.asarray(r, dtype=float)
    a, b, _, _ = _vector_coefficients(r)
    S = skew(r)
    # I - S/2 + (1 - t sin t / (2 (1 - cos t))) / t^2 S^2, where sin t / t = 1 - b t^2 and 1 - cos t = a t^2.
    square = np.sum(r * r, axis=-1)[..., None, None]
    small = square < 2.5e-3
    closed = 1.0 / np.where(small, 1.0, square) - (1.0 - b * square) / (2.0 * a * np.where(small, 1.0, square))
    series = 1 / 12 + square / 720 + square**2 / 30240 + square**3 / 1209600
    return np.eye(3) - 0.5 * S + np.where(small, series, closed) * (S @ S)


def vector_rates_derivative(r: ArrayLike, r_dot: ArrayLike) -> np.ndarray:
    """dB/dt (..., 3, 3) of ``vector_rates`` along r' (..., 3), rad/s."""
    r, r_dot = np.broadcast_arrays(np.asarray(r, dtype=float), np.asarray(r_dot, dtype=float))
    a, b, da, db = _vector_coefficients(r)
    S, S_dot = skew(r), skew(r_dot)
    along = np.sum(r * r_dot, axis=-1)[..., None, None]
    return a * S_dot + b * (S @ S_dot + S_dot @ S) + along * (da * S + db * (S @ S))


def pose(R_AB: ArrayLike, p_AB: ArrayLike) -> np.ndarray:
    """X_AB (..., 4, 4) from R_AB (..., 3, 3) and p_AB (..., 3), m (thesis equation 2.11)."""
    R_AB, p_AB = np.asarray(R_AB, dtype=float), np.asarray(p_AB, dtype=float)
    lead = np.broadcast_shapes(R_AB.shape[:-2], p_AB.shape[:-1])
    X_AB = np.zeros((*lead, 4, 4))
    X_AB[..., :3, :3], X_AB[..., :3, 3], X_AB[..., 3, 3] = R_AB, p_AB, 1.0
    return X_AB


def pose_from_vector(x: ArrayLike) -> np.ndarray:
    """X_AB (..., 4, 4) from [x y z rx ry rz] (..., 6), m and rad, as a UR logs poses."""
    x = np.asarray(x, dtype=float)
    return pose(rotation_from_vector(x[..., 3:]), x[..., :3])


def vector_from_pose(X_AB: ArrayLike, *, exact: bool = False) -> np.ndarray:
    """[x y z rx ry rz] (..., 6), m and rad, from X_AB (..., 4, 4); the rotation vector is at most pi long.

    ``exact`` as in ``vector_from_rotation``.
    """
    X_AB = np.asarray(X_AB, dtype=float)
    return np.concatenate([X_AB[..., :3, 3], vector_from_rotation(X_AB[..., :3, :3], exact=exact)], axis=-1)


def compose(*poses: ArrayLike) -> np.ndarray:
    """X_AC = X_AB X_BC and so on from left to right, each (..., 4, 4) (thesis equation 2.13)."""
    return reduce(np.matmul, (np.asarray(X, dtype=float) for X in poses))


def inverse(X_AB: ArrayLike) -> np.ndarray:
    """X_BA (..., 4, 4) (thesis equation 2.12)."""
    X_AB = np.asarray(X_AB, dtype=float)
    R_BA = np.swapaxes(X_AB[..., :3, :3], -1, -2)
    return pose(R_BA, -np.einsum("...ij,...j->...i", R_BA, X_AB[..., :3, 3]))


def transform_point(X_AB: ArrayLike, p_B: ArrayLike) -> np.ndarray:
    """Coordinates in A (..., 3) of a point given in B (..., 3), m."""
    X_AB = np.asarray(X_AB, dtype=float)
    return np.einsum("...ij,...j->...i", X_AB[..., :3, :3], np.asarray(p_B, dtype=float)) + X_AB[..., :3, 3]


def rotate_wrench(R_AB: ArrayLike, wrench_B: ArrayLike) -> np.ndarray:
    """The same wrench (or twist) about the same point in the axes of A, (..., 6), from the axes of B."""
    wrench_B = np.asarray(wrench_B, dtype=float)
    halves = wrench_B.reshape(*wrench_B.shape[:-1], 2, 3)
    rotated = np.einsum("...ij,...kj->...ki", np.asarray(R_AB, dtype=float), halves)
    return rotated.reshape(*rotated.shape[:-2], 6)


def shift_wrench(wrench_P: ArrayLike, p_PQ: ArrayLike) -> np.ndarray:
    """The wrench [f; m_Q] (..., 6) about Q that equals [f; m_P] about P: m_Q = m_P - p_PQ x f.

    Args:
        wrench_P: (..., 6), N and Nm.
        p_PQ: (..., 3) from P to Q in the wrench's axes, m.
    """
    wrench_P, p_PQ = np.asarray(wrench_P, dtype=float), np.asarray(p_PQ, dtype=float)
    moment = wrench_P[..., 3:] - cross(p_PQ, wrench_P[..., :3])
    return np.concatenate([np.broadcast_to(wrench_P[..., :3], moment.shape), moment], axis=-1)


def shift_twist(twist_P: ArrayLike, p_PQ: ArrayLike) -> np.ndarray:
    """The twist [v_Q; omega] (..., 6) of the same body at Q: v_Q = v_P + omega x p_PQ, p_PQ (..., 3) in its axes, m."""
    twist_P, p_PQ = np.asarray(twist_P, dtype=float), np.asarray(p_PQ, dtype=float)
    linear = twist_P[..., :3] + cross(twist_P[..., 3:], p_PQ)
    return np.concatenate([linear, np.broadcast_to(twist_P[..., 3:], linear.shape)], axis=-1)


def velocity_transform(X_ij: ArrayLike) -> np.ndarray:
    """V (..., 6, 6) taking the twist of a body at frame i in its axes to that at frame j in j's axes.

    V = [[R', -R' S(p)], [0, R']] with X_ij = (R, p) the pose of frame j in frame i (thesis equation 2.41). Power is
    the same in both frames, so a wrench goes the other way with V': F_i = V' F_j.
    """
    X_ij = np.asarray(X_ij, dtype=float)
    R_ji = np.swapaxes(X_ij[..., :3, :3], -1, -2)
    out = np.zeros((*X_ij.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R_ji
    out[..., :3, 3:] = -R_ji @ skew(X_ij[..., :3, 3])
    return out
