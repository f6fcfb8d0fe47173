"""Rigid-body dynamics M(q) qdd + C(q, qd) qd + g(q) = tau of an arm model (thesis section 2.2.5).

One implementation, the recursive Newton-Euler algorithm compiled by numba, serves one sample (6,), a log (n, 6) and
many cells (n_cells, n, 6). tau is the torque at the joint: motor minus friction plus J' F of a contact. The rotors'
reflected inertia stands on the diagonal of M. Code that is compiled itself calls the one-sample kernels re-exported
here with ``Dynamics.packed``::

    @njit
    def step(packed, q, qd, a, tau):
        rnea_into(packed, q, qd, a, tau)
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from ur5_twin.arm import _dynamics_kernels as kernels
from ur5_twin.arm import inertia
from ur5_twin.arm._dynamics_kernels import (
    Packed,
    bias_into,
    coriolis_into,
    forward_into,
    gravity_into,
    mass_matrix_into,
    rnea_into,
)
from ur5_twin.arm.kinematics import joint_rows, pack_dh
from ur5_twin.arm.parameters import N_JOINTS, ArmModel

__all__ = [
    "Dynamics",
    "Packed",
    "bias_into",
    "coriolis_into",
    "forward_into",
    "gravity_into",
    "mass_matrix_into",
    "rnea_into",
]


class Dynamics:
    """The dynamics of one arm model.

    Every method takes arrays (..., 6) whose leading axes broadcast against each other and returns those leading axes.
    The methods release the interpreter lock while they compute.

    Attributes:
        model: the model it was made from, its tool included.
        packed: the same numbers for the compiled one-sample kernels ``rnea_into(packed, q, qd, qdd, out)``,
            ``bias_into(packed, q, qd, out)``, ``gravity_into(packed, q, out)``, ``mass_matrix_into(packed, q, out)``,
            ``coriolis_into(packed, q, qd, out)`` and ``forward_into(packed, q, qd, tau, out)``. Their arrays are
            contiguous float64, (6,) or (6, 6), and ``out`` is none of the inputs. numba's cache does not see a change
            in another file: delete the cache of your own compiled callers after editing the kernels.
    """

    def __init__(self, model: ArmModel) -> None:
        self.model = model
        self.packed = pack(model)

    def mass_matrix(self, q: ArrayLike) -> np.ndarray:
        """M(q) (..., 6, 6), kg m^2, symmetric and positive definite, rotors included (thesis equation 2.61)."""
        return self._matrix(kernels.mass_matrix_rows, q)

    def coriolis_matrix(self, q: ArrayLike, qd: ArrayLike) -> np.ndarray:
        """C(q, qd) (..., 6, 6), Nm s/rad, of the Christoffel symbols, M' - 2C is skew (equations 2.65, 2.66)."""
        return self._matrix(kernels.coriolis_rows, q, qd)

    def gravity(self, q: ArrayLike) -> np.ndarray:
        """g(q) = dP/dq (..., 6), Nm: the torque that holds the arm still (thesis equation 2.67)."""
        return self._vector(kernels.gravity_rows, q)

    def bias(self, q: ArrayLike, qd: ArrayLike) -> np.ndarray:
        """C(q, qd) qd + g(q) (..., 6), Nm."""
        return self._vector(kernels.bias_rows, q, qd)

    def inverse(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        """tau = M qdd + C qd + g (..., 6), Nm, from rad, rad/s and rad/s^2 (thesis equation 2.64)."""
        return self._vector(kernels.rnea_rows, q, qd, qdd)

    def forward(self, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> np.ndarray:
        """qdd = M^-1 (tau - C qd - g) (..., 6), rad/s^2."""
        return self._vector(kernels.forward_rows, q, qd, tau)

    def kinetic_energy(self, q: ArrayLike, qd: ArrayLike) -> np.ndarray:
        """K = qd' M qd / 2 (...), J, the rotors' spin about their joints included (thesis equation 2.61)."""
        qd = np.asarray(qd, dtype=float)
        return 0.5 * np.einsum("...i,...ij,...j->...", qd, self.mass_matrix(q), qd)

    def potential_energy(self, q: ArrayLike) -> np.ndarray:
        """P = sum of m g z (...), J, heights above the base's origin (thesis equation 2.63)."""
        (rows,), lead = joint_rows(q)
        out = np.empty(rows.shape[0])
        kernels.potential_rows(self.packed, rows, out)
        return out.reshape(lead)

    def _vector(self, kernel: Callable[..., None], *inputs: ArrayLike) -> np.ndarray:
        rows, lead = joint_rows(*inputs)
        out = np.empty((rows[0].shape[0], N_JOINTS))
        kernel(self.packed, *rows, out)
        return out.reshape(*lead, N_JOINTS)

    def _matrix(self, kernel: Callable[..., None], *inputs: ArrayLike) -> np.ndarray:
        rows, lead = joint_rows(*inputs)
        out = np.empty((rows[0].shape[0], N_JOINTS, N_JOINTS))
        kernel(self.packed, *rows, out)
        return out.reshape(*lead, N_JOINTS, N_JOINTS)


def pack(model: ArmModel) -> Packed:
    """The numbers of an arm model as the compiled kernels want them, in joint frames (see ``Packed``)."""
    links = np.empty((N_JOINTS, 15))
    steps = pack_dh(model)
    for i, (mass, center, tensor) in enumerate(zip(*model.bodies(), strict=True)):
        ca, sa, a, d = steps[i]
        # DH frame i in joint frame J_i: along (a, 0, d), then turned by alpha about x.
        R = np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]])
        p = R @ center + np.array([a, 0.0, d])
        about_joint = inertia.shift(R @ tensor @ R.T, mass, p)
        links[i] = [*steps[i], mass, *(mass * p), *about_joint[np.triu_indices(3)], model.rotor_inertia[i]]
    return Packed(links, float(model.gravity))
