"""Closed-form inverse kinematics of a UR arm: all of the up to eight joint positions that reach a flange pose.

Joints 2, 3 and 4 are parallel, so the wrist centre o_5 fixes joint 1, the flange's orientation then joints 5 and 6, and
a planar arm of two links remains for joints 2, 3 and 4. Angles come out in (-pi, pi].
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from ur5_twin.arm.kinematics import Arm
from ur5_twin.arm.parameters import N_JOINTS, ArmModel, DenavitHartenberg
from ur5_twin.errors import ModelError

#: Shoulder, wrist and elbow branch of each of the eight solutions.
BRANCHES = tuple(product(("left", "right"), ("positive", "negative"), ("positive", "negative")))

#: A cosine or sine up to this far beyond 1 counts as 1: rounding at a stretched arm, 1e-10 m of a 1 m reach.
_REACH_TOLERANCE = 1e-10

#: Below this |sin q5| joints 4 and 6 turn about one axis and only the sum (or difference) of their angles matters.
WRIST_SINGULAR_SIN = 1e-9


@dataclass(frozen=True)
class Solutions:
    """The joint positions that reach a pose.

    Attributes:
        q: (..., 8, 6), rad in (-pi, pi]; nan where a branch does not exist.
        valid: (..., 8) which branches exist. At a wrist singularity both wrist branches coincide and the second of them
            is not counted; a stretched elbow likewise gives the same position in both elbow branches, which both count.
    """

    q: np.ndarray
    valid: np.ndarray

    #: (shoulder, wrist, elbow) of each branch: shoulder "left" where o_5 lies ahead of joint 1's axis
    #: (``singularities.shoulder_distance`` > 0), wrist the sign of sin q5, elbow that of sin q3.
    branches = BRANCHES


def solve(arm: Arm, X_BF: ArrayLike, q6_hint: ArrayLike = 0.0) -> Solutions:
    """All joint positions that put the flange at a pose.

    Args:
        arm: an arm with a UR's pattern of DH parameters.
        X_BF: (..., 4, 4) pose of the flange in the base; its rotation must be orthonormal.
        q6_hint: (...) rad, the angle joint 6 takes where sin q5 = 0 leaves it free, or the nearest to it that links 2
            and 3 can still reach.

    Returns:
        Solutions; a pose out of reach has fewer, or none, and is no error.

    Raises:
        ModelError: the DH parameters are not a UR's (joints 2 to 4 parallel, 5 and 6 across, no other offsets).
    """
    dh = arm.dh if isinstance(arm, ArmModel) else arm
    _check(dh)
    X_BF = np.asarray(X_BF, dtype=float)
    lead = X_BF.shape[:-2]
    (d1, _, _, d4, d5, d6), (_, a2, a3, *_) = dh.d, dh.a
    # One axis per choice: shoulder, wrist, elbow.
    X = X_BF[..., None, None, None, :, :]
    hint = np.broadcast_to(np.asarray(q6_hint, dtype=float), lead)[..., None, None, None]
    shoulder = np.array([1.0, -1.0])[:, None, None]
    wrist = np.array([1.0, -1.0])[:, None]
    elbow = np.array([1.0, -1.0])

    # Joint 1: o_5 lies d4 off the plane of links 2 and 3, whose normal is z_1 = n = (sin q1, -cos q1, 0).
    o5 = X[..., :3, 3] - d6 * X[..., :3, 2]
    radius = np.hypot(o5[..., 0], o5[..., 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        side = _clipped(d4 / radius)
    along = np.arctan2(o5[..., 1], o5[..., 0])
    q1 = np.where(shoulder > 0, along + np.arcsin(side), along + np.pi - np.arcsin(side))
    c1, s1 = np.cos(q1), np.sin(q1)

    # Joints 5 and 6: n in the flange's axes is (cos q6 sin q5, -sin q6 sin q5, cos q5).
    n_F = s1[..., None] * X[..., 0, :3] - c1[..., None] * X[..., 1, :3]
    sin5 = np.hypot(n_F[..., 0], n_F[..., 1])
    free = sin5 < WRIST_SINGULAR_SIN
    q5 = np.where(free, np.arctan2(0.0, n_F[..., 2]), wrist * np.arctan2(sin5, n_F[..., 2]))
    q6 = np.where(free, hint, np.arctan2(-wrist * n_F[..., 1], wrist * n_F[..., 0]))
    ahead = c1 * o5[..., 0] + s1 * o5[..., 1]
    y5 = np.sin(q6)[..., None] * X[..., :3, 0] + np.cos(q6)[..., None] * X[..., :3, 1]
    z4_angle = np.arctan2(-y5[..., 2], -c1 * y5[..., 0] - s1 * y5[..., 1])
    turn = _turn_into_reach(ahead, o5[..., 2] - d1, z4_angle, d5, a2, a3)
    # Near the wrist singularity q6 is only known to rounding / sin q5: it may take the turn that rounding hides.
    allowed = free | (np.abs(turn) * sin5 < 1e-12)
    q6 = np.where(allowed, q6 - np.sign(n_F[..., 2]) * turn, q6)

    # Frame 4 in the base: X_BF without joints 5 and 6. x_4 and z_4 in the plane of the arm, (cos q1, sin q1, 0) and up.
    c5, s5, c6, s6 = np.cos(q5), np.sin(q5), np.cos(q6), np.sin(q6)
    x5 = c6[..., None] * X[..., :3, 0] - s6[..., None] * X[..., :3, 1]
    y5 = s6[..., None] * X[..., :3, 0] + c6[..., None] * X[..., :3, 1]
    z5 = X[..., :3, 2]
    # R_45 = Rz(q5) Rx(-pi/2) = [[c5, 0, -s5], [s5, 0, c5], [0, -1, 0]].
    x4 = c5[..., None] * x5 - s5[..., None] * z5
    z4 = -y5
    in_plane = c1 * x4[..., 0] + s1 * x4[..., 1]
    q234 = np.arctan2(x4[..., 2], in_plane)

    # Joints 2 and 3: a planar arm from o_1 to o_3 = o_5 - d5 z_4 - d4 n.
    px = ahead - d5 * (c1 * z4[..., 0] + s1 * z4[..., 1])
    py = o5[..., 2] - d5 * z4[..., 2] - d1
    c3 = _clipped((px**2 + py**2 - a2**2 - a3**2) / (2.0 * a2 * a3))
    q3 = elbow * np.arccos(c3)
    q2 = np.arctan2(py, px) - np.arctan2(a3 * np.sin(q3), a2 + a3 * np.cos(q3))
    q4 = q234 - q2 - q3

    q = np.stack(np.broadcast_arrays(q1, q2, q3, q4, q5, q6), axis=-1)
    q = np.pi - np.remainder(np.pi - q, 2.0 * np.pi)
    valid = np.isfinite(q).all(axis=-1) & ~(free & (wrist < 0))
    q = np.where(valid[..., None], q, np.nan)
    return Solutions(q.reshape(*lead, 8, N_JOINTS), valid.reshape(*lead, 8))


def nearest(arm: ArmModel, X_BF: ArrayLike, q_near: ArrayLike) -> np.ndarray:
    """The joint position within the arm's limits that reaches a pose with the least turn from a given one.

    Whole turns are added where they bring a joint nearer and the limits (+-2 pi) allow it. Nearest means the smallest
    sum of squared joint differences. At a wrist singularity joint 6 stays where it is.

    Args:
        arm: the arm with its limits.
        X_BF: (..., 4, 4) pose of the flange in the base.
        q_near: (..., 6), rad.

    Returns:
        (..., 6), rad; nan where the pose is out of reach.
    """
    q_near = np.asarray(q_near, dtype=float)
    q = solve(arm, X_BF, q6_hint=q_near[..., 5]).q
    near, limit = q_near[..., None, :], arm.limits.q
    turn = 2.0 * np.pi
    turns = np.rint((near - q) / turn)
    # The nearest turn that keeps the joint within its limits.
    turns = np.clip(turns, np.ceil((-limit - q) / turn), np.floor((limit - q) / turn))
    q = q + turns * turn
    distance = np.sum((q - near) ** 2, axis=-1)
    best = np.argmin(np.where(np.isnan(distance), np.inf, distance), axis=-1)
    return np.take_along_axis(q, best[..., None, None], axis=-2)[..., 0, :]


def _clipped(x: np.ndarray) -> np.ndarray:
    """x with rounding beyond +-1 removed, nan where it is truly beyond: then there is no such angle."""
    return np.where(np.abs(x) <= 1.0 + _REACH_TOLERANCE, np.clip(x, -1.0, 1.0), np.nan)


def _turn_into_reach(x: np.ndarray, y: np.ndarray, z4_angle: np.ndarray, d5: float, a2: float, a3: float) -> np.ndarray:
    """Smallest turn of z_4 in the arm's plane that brings o_3 = o_5 - d5 z_4 within reach of links 2 and 3.

    Args:
        x, y: o_5 in the plane from joint 2's axis, m.
        z4_angle: where z_4 points in that plane, rad.
        d5, a2, a3: of the DH parameters, m.

    Returns:
        The turn, rad; what cannot be reached at all stays out of reach.
    """
    radius = np.hypot(x, y)
    angle = np.angle(np.exp(1j * (z4_angle - np.arctan2(y, x))))
    # |o_3|^2 = radius^2 + d5^2 - 2 d5 radius cos(angle), between (|a2| - |a3|)^2 and (|a2| + |a3|)^2.
    size = np.maximum(2.0 * d5 * radius, np.finfo(float).tiny)
    reach = np.array([abs(a2) - abs(a3), abs(a2) + abs(a3)]) ** 2
    low, high = (np.arccos(np.clip((radius**2 + d5**2 - limit) / size, -1.0, 1.0)) for limit in reach)
    return np.copysign(np.clip(np.abs(angle), low, high), angle) - angle


def _check(dh: DenavitHartenberg) -> None:
    half = np.pi / 2
    alpha = np.array([half, 0.0, 0.0, half, -half, 0.0])
    zeros = (*dh.a[[0, 3, 4, 5]], *dh.d[[1, 2]])
    if not np.allclose(dh.alpha, alpha, atol=1e-12) or np.any(zeros) or not dh.a[1] or not dh.a[2]:
        raise ModelError(
            "closed-form inverse kinematics needs a UR's DH parameters: alpha = pi/2, 0, 0, pi/2, -pi/2, 0; "
            f"a only for joints 2 and 3; d2 = d3 = 0 (got alpha {dh.alpha}, a {dh.a}, d {dh.d})"
        )
