"""A rigid body at the flange as ten numbers in which its wrench is linear, and which of them a real body can have.

    phi = [m, m c, Ixx, Iyy, Izz, Ixy, Ixz, Iyz],   I about the flange's origin, all in the flange's axes
    f = m a + (S(alpha) + S(omega)^2) m c,   n = m c x a + I alpha + omega x I omega

a is the flange's acceleration less gravity (Atkeson, An and Hollerbach 1986). A body of positive density everywhere
has a positive definite pseudo-inertia P = [[tr(I)/2 1 - I, m c], [m c', m]] (Wensing, Kim and Slotine 2018), and
every such P is U U' with U upper triangular of positive diagonal, whose logarithms are free numbers (Rucker and
Wensing 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from ur5_twin import spatial
from ur5_twin.arm import inertia, kinematics
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.sensing.kinetics import FlangeMotion

#: Density of a body whose size is not known, aluminium, kg/m^3.
_DENSITY = 2700.0
#: Smallest share of the largest eigenvalue of P that a fit starts from.
_FLOOR = 1e-6


@dataclass(frozen=True)
class Body:
    """Mass in kg, mass centre (3,) in m and tensor (3, 3) about it in kg m^2, in the flange frame."""

    mass: float
    center: np.ndarray
    inertia: np.ndarray

    @property
    def phi(self) -> np.ndarray:
        """(10,) the numbers above."""
        about_origin = inertia.shift(self.inertia, self.mass, self.center)
        return np.array([self.mass, *(self.mass * self.center), *six(about_origin)])


def ball(mass: float, center: np.ndarray) -> Body:
    """A body of which mass and centre alone are known: a ball of aluminium."""
    radius = (0.75 * mass / (np.pi * _DENSITY)) ** (1.0 / 3.0)
    return Body(mass, np.asarray(center), np.eye(3) * (0.4 * mass * radius**2))


def of_phi(phi: np.ndarray) -> Body:
    """The body of ten numbers (10,) with a mass that is not zero."""
    mass, center = float(phi[0]), phi[1:4] / phi[0]
    return Body(mass, center, _tensor(phi[4:]) - inertia.shift(np.zeros((3, 3)), mass, center))


def wrench_columns(motion: FlangeMotion) -> np.ndarray:
    """(n, 6, 10) the wrench about the flange in its axes that moves a body, by each of its ten numbers."""
    a, omega, alpha = (motion.into_flange(v) for v in (motion.acceleration, motion.omega, motion.alpha))
    columns = np.zeros((len(a), 6, 10))
    columns[:, :3, 0] = a
    spin = spatial.skew(omega)
    columns[:, :3, 1:4] = spatial.skew(alpha) + spin @ spin
    columns[:, 3:, 1:4] = -spatial.skew(a)
    columns[:, 3:, 4:] = _times(alpha) + spin @ _times(omega)
    return columns


def torque_columns(model: ArmModel, q: np.ndarray, motion: FlangeMotion) -> np.ndarray:
    """(n, 6, 10) the joints' torque that moves a body at the flange, by each of its ten numbers: J' of the wrench."""
    wrench = wrench_columns(motion)
    R_BF = np.swapaxes(motion.R_FB, 1, 2)
    in_base = np.concatenate([R_BF @ wrench[:, :3], R_BF @ wrench[:, 3:]], axis=1)
    return np.swapaxes(kinematics.jacobian(model, q), 1, 2) @ in_base


def pseudo_inertia(phi: np.ndarray) -> np.ndarray:
    """P (4, 4) of ten numbers."""
    tensor = _tensor(phi[4:])
    P = np.empty((4, 4))
    P[:3, :3] = 0.5 * np.trace(tensor) * np.eye(3) - tensor
    P[:3, 3] = P[3, :3] = phi[1:4]
    P[3, 3] = phi[0]
    return P


def nearest_body(phi: np.ndarray, covariance: np.ndarray) -> Body:
    """The body that a body can be, nearest to a fit by the fit's own covariance.

    Minimises (x - phi)' C^-1 (x - phi) over all x with positive definite P, which is what a fit by least squares under
    that constraint gives, since its cost is quadratic.

    Args:
        phi: (10,) the fit.
        covariance: C (10, 10) of it.
    """
    scale = np.sqrt(np.diag(covariance))
    whiten = np.linalg.inv(np.linalg.cholesky(covariance / np.outer(scale, scale))) / scale
    values, vectors = np.linalg.eigh(pseudo_inertia(phi))
    start = vectors @ np.diag(np.maximum(values, _FLOOR * max(values[-1], 1e-9))) @ vectors.T
    # Upper triangular from numpy's lower one, by turning the order of the axes round.
    U = np.linalg.cholesky(start[::-1, ::-1])[::-1, ::-1]
    free = np.triu_indices(4, 1)
    found = least_squares(
        lambda x: whiten @ (_phi_of(_upper(x, free)) - phi), np.concatenate([np.log(np.diag(U)), U[free]])
    )
    return of_phi(_phi_of(_upper(found.x, free)))


def parts(body: Body) -> list[dict[str, object]]:
    """Homogeneous balls of the same mass, centre and tensor, in the layout of a tool's parts.

    Six of them on the body's principal axes: the second moment along axis k is that of two at sqrt(3 s_k) either side.
    """
    moments, axes = np.linalg.eigh(0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia)
    second = np.maximum(moments, 0.0) / body.mass
    radius = max(0.9 * np.sqrt(5.0 * second.min()), 1e-4)
    distance = np.sqrt(3.0 * np.maximum(second - radius**2 / 5.0, 0.0))
    places = [body.center + sign * d * axis for d, axis in zip(distance, axes.T, strict=True) for sign in (1.0, -1.0)]
    return [
        {
            "name": f"payload_{i}",
            "shape": "sphere",
            "mass_kg": body.mass / 6.0,
            "radius_mm": float(radius * 1e3),
            "center_mm": [float(x) for x in place * 1e3],
        }
        for i, place in enumerate(places, start=1)
    ]


def _upper(x: np.ndarray, free: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    U = np.diag(np.exp(x[:4]))
    U[free] = x[4:]
    return U


def _phi_of(U: np.ndarray) -> np.ndarray:
    P = U @ U.T
    tensor = np.trace(P[:3, :3]) * np.eye(3) - P[:3, :3]
    return np.array([P[3, 3], *P[:3, 3], *six(tensor)])


def six(tensor: np.ndarray) -> np.ndarray:
    """(6,) Ixx, Iyy, Izz, Ixy, Ixz, Iyz of a tensor (3, 3)."""
    return tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _tensor(six: np.ndarray) -> np.ndarray:
    xx, yy, zz, xy, xz, yz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _times(v: np.ndarray) -> np.ndarray:
    """(n, 3, 6) with I v = times(v) [Ixx, Iyy, Izz, Ixy, Ixz, Iyz]."""
    x, y, z, none = v[:, 0], v[:, 1], v[:, 2], np.zeros(len(v))
    rows = ((x, none, none, y, z, none), (none, y, none, x, none, z), (none, none, z, none, x, y))
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)
