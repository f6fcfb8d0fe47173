"""From external joint torques to the wrench at the flange, near singular postures too.

tau_ext = J' W + noise, noise ~ N(0, R), W ~ N(0, S0)::

    W = (J R^-1 J' + S0^-1)^-1 J R^-1 tau_ext,    covariance (J R^-1 J' + S0^-1)^-1

In a direction that no joint feels the prior alone is left: none of the torque's error comes through, and the covariance
says that nothing is known. That is damped least squares with a damping that knows its units. The probability of contact
compares the torques' likelihood under W ~ N(0, S0) with that under W = 0.
"""

from __future__ import annotations

import math

import numpy as np

from ur5_twin.estimation import _kernels as kernels
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.protocol import Estimate


class WrenchSolver:
    """Wrenches of one arm, a posture at a time.

    Args:
        nominal: whose kinematics, prior wrench and prior probability of contact it takes.

    Attributes:
        J: (6, 6) Jacobian of the flange at the last ``look``.
        sigma_min: its smallest singular value.
    """

    def __init__(self, nominal: NominalModel) -> None:
        spec = nominal.settings.wrench
        self.prior = np.array([spec.prior_force_n**2] * 3 + [spec.prior_moment_nm**2] * 3)
        self.prior_odds = math.log(spec.prior_contact / (1.0 - spec.prior_contact))
        self._prior_contact = spec.prior_contact
        self.J = np.zeros((6, 6))
        self.sigma_min = 0.0
        self._dh = nominal.dh
        self._frames = np.empty((7, 4, 4))
        self._A, self._b = np.empty((6, 6)), np.empty(6)

    def look(self, q: np.ndarray) -> None:
        """Take the Jacobian at q (6,), rad."""
        self.sigma_min = float(kernels.flange_jacobian(self._dh, q, self._frames, self.J))

    def solve(self, tau: np.ndarray, variance: np.ndarray) -> Estimate:
        """The estimate of external torques tau (6,) Nm with variances (6,) Nm^2 at the posture looked at."""
        kernels.information(self.J, tau, variance, self._A, self._b)
        wrench, covariance = np.empty(6), np.empty((6, 6))
        contact = kernels.posterior(self._A, self._b, self.prior, self.prior_odds, wrench, covariance)
        return Estimate(tau.copy(), wrench, covariance, contact, self.sigma_min)

    def of_information(self, A: np.ndarray, b: np.ndarray) -> Estimate:
        """The estimate of A = sum J R^-1 J' (6, 6) and b = sum J R^-1 tau (6,), gathered over several samples."""
        wrench, covariance, tau = np.empty(6), np.empty((6, 6)), np.empty(6)
        contact = kernels.posterior(A, b, self.prior, self.prior_odds, wrench, covariance)
        kernels.torque_of(self.J, wrench, tau)
        return Estimate(tau, wrench, covariance, contact, self.sigma_min)

    def around(self, wrench: np.ndarray, variance: np.ndarray) -> Estimate:
        """A wrench (6,) that something else has estimated, with what torques of these variances leave open."""
        tau = np.empty(6)
        kernels.torque_of(self.J, wrench, tau)
        return self.solve(tau, variance)._replace(wrench=wrench.copy())

    def unknown(self) -> Estimate:
        """What is known before the first sample: the prior."""
        return Estimate(np.zeros(6), np.zeros(6), np.diag(self.prior), self._prior_contact, 0.0)
