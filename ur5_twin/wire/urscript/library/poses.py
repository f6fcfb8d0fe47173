"""Functions of poses p[x, y, z, rx, ry, rz] (m, rotation vector in rad) and of wrenches."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ur5_twin import spatial
from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript.costs import costs
from ur5_twin.wire.urscript.library.lists import array, inverse
from ur5_twin.wire.urscript.values import Pose, is_number, shown


def matrix(name: str, pose: Any) -> np.ndarray:
    """X (4, 4) of a pose; a list of six numbers will do.

    Raises:
        ScriptError: it is none.
    """
    found = array(name, pose)
    if found.shape != (6,) or not np.isfinite(found).all():
        raise ScriptError(f"{name} of {shown(pose)[:40]}: not a pose of six numbers")
    return spatial.pose_from_vector(found)


def pose(X: np.ndarray) -> Pose:
    """The pose of X (4, 4)."""
    return Pose(spatial.vector_from_pose(X).tolist())


@costs(100)
def pose_trans(p_from: Any, p_from_to: Any) -> Pose:
    """X_A X_B: the second pose, given in the first one's frame."""
    return pose(matrix("pose_trans", p_from) @ matrix("pose_trans", p_from_to))


@costs(100)
def pose_inv(p_from: Any) -> Pose:
    """X^-1."""
    return pose(np.linalg.inv(matrix("pose_inv", p_from)))


@costs(100)
def pose_add(p_1: Any, p_2: Any) -> Pose:
    """Positions added, rotations R_1 R_2."""
    first, second = matrix("pose_add", p_1), matrix("pose_add", p_2)
    X = np.eye(4)
    X[:3, :3] = first[:3, :3] @ second[:3, :3]
    X[:3, 3] = first[:3, 3] + second[:3, 3]
    return pose(X)


@costs(100)
def pose_sub(p_to: Any, p_from: Any) -> Pose:
    """Positions subtracted, rotations R_to R_from^-1."""
    first, second = matrix("pose_sub", p_to), matrix("pose_sub", p_from)
    X = np.eye(4)
    X[:3, :3] = first[:3, :3] @ second[:3, :3].T
    X[:3, 3] = first[:3, 3] - second[:3, 3]
    return pose(X)


@costs(100)
def pose_dist(pose_from: Any, pose_to: Any) -> float:
    """Length of the difference of positions (m) and rotation (rad) together."""
    return float(np.linalg.norm(pose_sub(pose_to, pose_from)))


@costs(40)
def point_dist(p_from: Any, p_to: Any) -> float:
    """Distance of two poses' origins, m."""
    return float(np.linalg.norm(matrix("point_dist", p_to)[:3, 3] - matrix("point_dist", p_from)[:3, 3]))


@costs(200)
def interpolate_pose(p_from: Any, p_to: Any, alpha: Any) -> Pose:
    """Between two poses: the first at 0, the second at 1; straight, and with the shortest rotation."""
    first, second = matrix("interpolate_pose", p_from), matrix("interpolate_pose", p_to)
    if not is_number(alpha):
        raise ScriptError(f"interpolate_pose at {shown(alpha)[:40]}: not a number")
    turn = Rotation.from_matrix(first[:3, :3].T @ second[:3, :3]).as_rotvec()
    X = np.eye(4)
    X[:3, :3] = first[:3, :3] @ Rotation.from_rotvec(alpha * turn).as_matrix()
    X[:3, 3] = first[:3, 3] + alpha * (second[:3, 3] - first[:3, 3])
    return pose(X)


@costs(40)
def wrench_trans(T_from_to: Any, w_from: Any) -> list[float]:
    """A wrench [force, moment] given in frame "from", in frame "to", of which the pose in "from" is given."""
    X, w = matrix("wrench_trans", T_from_to), array("wrench_trans", w_from)
    if w.shape != (6,):
        raise ScriptError(f"wrench_trans of {shown(w_from)[:40]}: not a wrench of six numbers")
    force = X[:3, :3].T @ w[:3]
    moment = X[:3, :3].T @ (w[3:] - np.cross(X[:3, 3], w[:3]))
    return [*force.tolist(), *moment.tolist()]


@costs(100)
def inv(m: Any) -> Pose | list[list[float]]:
    """Inverse of a square matrix or of a pose."""
    return pose_inv(m) if isinstance(m, Pose) else inverse(m)


@costs(20)
def rotvec2rpy(rotation_vector: Any) -> list[float]:
    """Roll, pitch and yaw (rad) of a rotation vector: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    R = Rotation.from_rotvec(_three("rotvec2rpy", rotation_vector)).as_matrix()
    upright = math.hypot(R[0, 0], R[1, 0])
    pitch = math.atan2(-R[2, 0], upright)
    if upright < spatial.ZYZ_SINGULAR_SIN:
        # Only the sum or difference of roll and yaw exists: all of it is the roll.
        return [math.atan2(-R[1, 2], R[1, 1]), pitch, 0.0]
    return [math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])]


@costs(20)
def rpy2rotvec(rpy: Any) -> list[float]:
    """Rotation vector of roll, pitch and yaw (rad)."""
    return Rotation.from_euler("xyz", _three("rpy2rotvec", rpy)).as_rotvec().tolist()


def _three(name: str, value: Any) -> np.ndarray:
    found = array(name, value)
    if found.shape != (3,) or not np.isfinite(found).all():
        raise ScriptError(f"{name} of {shown(value)[:40]}: not three numbers")
    return found


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "inv": inv,
    "pose_trans": pose_trans,
    "pose_inv": pose_inv,
    "pose_add": pose_add,
    "pose_sub": pose_sub,
    "pose_dist": pose_dist,
    "point_dist": point_dist,
    "interpolate_pose": interpolate_pose,
    "wrench_trans": wrench_trans,
    "rotvec2rpy": rotvec2rpy,
    "rpy2rotvec": rpy2rotvec,
}
