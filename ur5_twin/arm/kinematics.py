"""Forward and differential kinematics of the arm (thesis sections 2.2.2, 2.2.3 and 5.3).

Every function takes an ``ArmModel`` or its ``DenavitHartenberg`` parameters and joint arrays (..., 6), be it one
sample, a log or many cells, and keeps the leading axes. B is the base (DH frame 0), F the flange (DH frame 6);
everything is in base axes, SI units and rad. A tool does not move F.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ur5_twin import spatial
from ur5_twin.arm import _kinematics_kernels as kernels
from ur5_twin.arm.parameters import N_JOINTS, ArmModel, DenavitHartenberg

Arm = ArmModel | DenavitHartenberg

#: Minimal representations of the flange's orientation: ZYZ Euler angles as in the thesis, or UR's rotation vector.
Orientation = Literal["zyz", "rotation_vector"]

_ORIGIN = np.zeros(3)


def forward(arm: Arm, q: ArrayLike) -> np.ndarray:
    """X_BF (..., 4, 4), the flange's pose in the base (thesis equation 2.18), from q (..., 6), rad."""
    return link_frames(arm, q)[..., 6, :, :]


def link_frames(arm: Arm, q: ArrayLike) -> np.ndarray:
    """Poses (..., 7, 4, 4) of DH frames 0 to 6 in the base (thesis equations 2.17, 2.19); frame i sits on link i."""
    (rows,), lead = joint_rows(q)
    out = np.empty((rows.shape[0], 7, 4, 4))
    kernels.frames_rows(pack_dh(arm), rows, out)
    return out.reshape(*lead, 7, 4, 4)


def jacobian(arm: Arm, q: ArrayLike) -> np.ndarray:
    """Geometric Jacobian J (..., 6, 6) of the flange: [v; omega] = J qd (thesis equations 2.26 to 2.29)."""
    return point_jacobian(arm, q, 6)


def point_jacobian(arm: Arm, q: ArrayLike, link: int, p_in_link: ArrayLike = _ORIGIN) -> np.ndarray:
    """Geometric Jacobian (..., 6, 6) of a point fixed to a link (thesis equation 2.40); zero beyond the link's joint.

    Args:
        arm: the arm.
        q: (..., 6), rad.
        link: 1 to 6.
        p_in_link: (3,) the point in the link's DH frame, m.

    Raises:
        ValueError: there is no such link.
    """
    if link not in range(1, N_JOINTS + 1):
        raise ValueError(f"link must be 1 to {N_JOINTS}, not {link}")
    (rows,), lead = joint_rows(q)
    out = np.empty((rows.shape[0], 6, N_JOINTS))
    kernels.jacobian_rows(pack_dh(arm), rows, link, np.array(p_in_link, dtype=float), out)
    return out.reshape(*lead, 6, N_JOINTS)


def jacobian_dot(arm: Arm, q: ArrayLike, qd: ArrayLike, link: int = 6, p_in_link: ArrayLike = _ORIGIN) -> np.ndarray:
    """dJ/dt (..., 6, 6) of ``point_jacobian``, by default of the flange's geometric Jacobian, in closed form.

    Args:
        arm: the arm.
        q: (..., 6), rad.
        qd: (..., 6), rad/s.
        link: 1 to 6.
        p_in_link: (3,) the point in the link's DH frame, m.
    """
    (q_rows, qd_rows), lead = joint_rows(q, qd)
    J = point_jacobian(arm, q_rows, link, p_in_link)
    out = np.empty_like(J)
    kernels.jacobian_dot_rows(J, qd_rows, link, out)
    return out.reshape(*lead, 6, N_JOINTS)


def twist(arm: Arm, q: ArrayLike, qd: ArrayLike) -> np.ndarray:
    """[v; omega] (..., 6) of the flange in base axes, m/s and rad/s (thesis equation 2.25)."""
    return _apply(jacobian(arm, q), qd)


def acceleration(arm: Arm, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
    """[v'; omega'] (..., 6) = J qdd + J' qd of the flange in base axes, m/s^2 and rad/s^2, gravity not included.

    The geometric counterpart of thesis equation 2.35; it has no representational singularity.
    """
    return _apply(jacobian(arm, q), qdd) + _apply(jacobian_dot(arm, q, qd), qd)


def motion(arm: Arm, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """``twist`` and ``acceleration`` (..., 6) together, in one pass."""
    (q_rows, qd_rows, qdd_rows), lead = joint_rows(q, qd, qdd)
    velocity, rate = np.empty_like(q_rows), np.empty_like(q_rows)
    kernels.motion_rows(pack_dh(arm), q_rows, qd_rows, qdd_rows, velocity, rate)
    return velocity.reshape(*lead, 6), rate.reshape(*lead, 6)


def pose_coordinates(arm: Arm, q: ArrayLike, orientation: Orientation = "zyz") -> np.ndarray:
    """X (..., 6) = [position; orientation] of the flange in m and rad (thesis equation 2.30)."""
    X_BF = forward(arm, q)
    return np.concatenate([X_BF[..., :3, 3], _coordinates(X_BF[..., :3, :3], orientation)], axis=-1)


def tcp_pose(arm: Arm, q: ArrayLike) -> np.ndarray:
    """[x y z rx ry rz] (..., 6) of the flange, m and rad, as a UR without tool offset logs actual_TCP_pose.

    Near a rotation by pi the vector may be the one of the other sign, as in the robot's own logs: compare rotations,
    not their vectors.
    """
    (rows,), lead = joint_rows(q)
    out = np.empty((len(rows), 6))
    kernels.poses_rows(pack_dh(arm), rows, out)
    return out.reshape(*lead, 6)


def analytical_jacobian(arm: Arm, q: ArrayLike, orientation: Orientation = "zyz") -> np.ndarray:
    """J_a (..., 6, 6): X' = J_a qd for X of ``pose_coordinates`` (thesis equation 2.34 with 2.33 corrected).

    At a representational singularity of "zyz" (z of the flange along z of the base) its last three rows are nan.
    "rotation_vector" has none, but its X jumps where the angle passes pi.
    """
    J = jacobian(arm, q)
    beta = _coordinates(forward(arm, q)[..., :3, :3], orientation)
    inverse = spatial.zyz_rates_inverse(beta) if orientation == "zyz" else spatial.vector_rates_inverse(beta)
    return np.concatenate([J[..., :3, :], inverse @ J[..., 3:, :]], axis=-2)


def analytical_acceleration(
    arm: Arm, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, orientation: Orientation = "zyz"
) -> np.ndarray:
    """X'' (..., 6) = J_a qdd + J_a' qd (thesis equation 2.35), m/s^2 and rad/s^2.

    beta'' = B^-1 (omega' - B' beta'); nan in its last three entries where ``analytical_jacobian`` is.
    """
    geometric = acceleration(arm, q, qd, qdd)
    beta = _coordinates(forward(arm, q)[..., :3, :3], orientation)
    if orientation == "zyz":
        inverse, derivative = spatial.zyz_rates_inverse(beta), spatial.zyz_rates_derivative
    else:
        inverse, derivative = spatial.vector_rates_inverse(beta), spatial.vector_rates_derivative
    beta_dot = _apply(inverse, twist(arm, q, qd)[..., 3:])
    beta_ddot = _apply(inverse, geometric[..., 3:] - _apply(derivative(beta, beta_dot), beta_dot))
    return np.concatenate([geometric[..., :3], beta_ddot], axis=-1)


def pack_dh(arm: Arm) -> np.ndarray:
    """(6, 4) cos alpha, sin alpha, a, d of each joint: the compiled kernels' view of the DH parameters."""
    return (arm.dh if isinstance(arm, ArmModel) else arm).packed


def joint_rows(*inputs: ArrayLike) -> tuple[list[np.ndarray], tuple[int, ...]]:
    """Joint arrays (..., 6) as contiguous rows (n, 6) over their common leading shape, and that shape.

    Raises:
        ValueError: the last axis does not hold six joints.
    """
    arrays = [np.asarray(x, dtype=float) for x in inputs]
    shape = arrays[0].shape
    if len(shape) == 2 and shape[1] == N_JOINTS and all(x.shape == shape for x in arrays):
        return [np.ascontiguousarray(x) for x in arrays], shape[:1]
    if any(x.shape != arrays[0].shape for x in arrays):
        arrays = list(np.broadcast_arrays(*arrays))
    shape = arrays[0].shape
    if not shape or shape[-1] != N_JOINTS:
        raise ValueError(f"the last axis must hold the {N_JOINTS} joints, got shapes {[np.shape(x) for x in inputs]}")
    return [np.ascontiguousarray(x).reshape(-1, N_JOINTS) for x in arrays], shape[:-1]


def _coordinates(R_BF: np.ndarray, orientation: Orientation) -> np.ndarray:
    if orientation == "zyz":
        return spatial.zyz_from_rotation(R_BF)
    if orientation == "rotation_vector":
        return spatial.vector_from_rotation(R_BF, exact=True)
    raise ValueError(f"unknown orientation '{orientation}' (known: rotation_vector, zyz)")


def _apply(matrix: np.ndarray, vector: ArrayLike) -> np.ndarray:
    return (matrix @ np.asarray(vector, dtype=float)[..., None])[..., 0]
