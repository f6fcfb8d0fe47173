"""Singular configurations of a UR arm in closed form, which the thesis leaves open (its section 3.1).

det J = a2 a3 sin q3 sin q5 l, with l = a2 cos q2 + a3 cos(q2 + q3) + d5 sin(q2 + q3 + q4), of the flange's geometric
Jacobian; three factors, three families of singular configurations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ur5_twin.arm.kinematics import Arm, jacobian
from ur5_twin.arm.parameters import ArmModel


@dataclass(frozen=True)
class Distances:
    """Signed distances to the three families, each (...), zero on the family and of one sign on each of its sides.

    Attributes:
        shoulder: m, from the wrist centre o_5 to the plane through the axes of joint 1 and (parallel to it) joint 2.
        elbow: rad, by which joint 3 must turn to stretch or fold the arm: arcsin(sin q3), in [-pi/2, pi/2].
        wrist: rad, by which joint 5 must turn to bring joint 6's axis parallel to joints 2 to 4: arcsin(sin q5).
    """

    shoulder: np.ndarray
    elbow: np.ndarray
    wrist: np.ndarray


def distances(arm: Arm, q: ArrayLike) -> Distances:
    """How far joint positions q (..., 6), rad, are from each family of singular configurations."""
    q = np.asarray(q, dtype=float)
    return Distances(shoulder_distance(arm, q), _folded(q[..., 2]), _folded(q[..., 4]))


def shoulder_distance(arm: Arm, q: ArrayLike) -> np.ndarray:
    """l (...) = a2 cos q2 + a3 cos(q2 + q3) + d5 sin(q2 + q3 + q4), m: o_5 along (cos q1, sin q1, 0)."""
    dh = arm.dh if isinstance(arm, ArmModel) else arm
    q = np.asarray(q, dtype=float)
    q23 = q[..., 1] + q[..., 2]
    return dh.a[1] * np.cos(q[..., 1]) + dh.a[2] * np.cos(q23) + dh.d[4] * np.sin(q23 + q[..., 3])


def determinant(arm: Arm, q: ArrayLike) -> np.ndarray:
    """det J (...), m^3, of the flange's geometric Jacobian at q (..., 6), in closed form for a UR's DH parameters."""
    dh = arm.dh if isinstance(arm, ArmModel) else arm
    q = np.asarray(q, dtype=float)
    return dh.a[1] * dh.a[2] * np.sin(q[..., 2]) * np.sin(q[..., 4]) * shoulder_distance(arm, q)


def manipulability(arm: Arm, q: ArrayLike) -> np.ndarray:
    """Yoshikawa's sqrt(det J J') = |det J| (...), m^3."""
    return np.abs(determinant(arm, q))


def smallest_singular_value(arm: Arm, q: ArrayLike, length: float = 1.0) -> np.ndarray:
    """Smallest singular value (...) of J with its linear rows divided by ``length`` in m, so that units agree.

    A torque error of 1 Nm shows as a wrench error of at most 1 / it (force times length and moment, in Nm): the factor
    by which errors grow in a force estimate.
    """
    J = jacobian(arm, q)
    J[..., :3, :] /= length
    return np.linalg.svd(J, compute_uv=False)[..., -1]


def _folded(angle: np.ndarray) -> np.ndarray:
    """arcsin(sin angle), without the root of rounding that arcsin has where it turns back."""
    turns = np.rint(angle / np.pi)
    return (angle - turns * np.pi) * np.where(turns % 2 == 0, 1.0, -1.0)
