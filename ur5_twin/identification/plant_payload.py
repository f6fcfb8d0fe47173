"""A payload that nobody has weighed, from the same currents as the plant: one body for all joints and logs.

The current of joint j depends on the payload's numbers phi by S_j = (d link + load d |link| sgn(qd)) / k. With each
joint's own numbers solved for at every phi (variable projection; Golub and Pereyra 1973, in the form of Kaufman 1975)
what is left depends on phi by Q_j = S_j - T_j T_j^+ S_j, T_j being the derivatives in the joint's own numbers, and

    step = (sum_j Q_j' Q_j / s_j^2 + prior)^-1 sum_j Q_j' e_j / s_j^2

with s_j the standard deviation of what joint j leaves. The masses of the links, which are known, set the scale of both
torque constants and payload.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ur5_twin.identification import spread
from ur5_twin.identification.load import LARGEST_INERTIA, Load, likeliest
from ur5_twin.identification.plant_solve import Shared, Solution
from ur5_twin.identification.plant_windows import Windows


@dataclass(frozen=True)
class Step:
    """From one estimate of a payload to the next.

    Attributes:
        phi: (10,) the new estimate.
        influence: (blocks, 10) what each second of the logs adds to its error.
        done: whether it moved by less than a hundredth of its standard deviations.
    """

    phi: np.ndarray
    influence: np.ndarray
    done: bool

    @property
    def covariance(self) -> np.ndarray:
        """Of phi, errors being correlated within a second."""
        number = int(self.influence.any(axis=1).sum())
        return number / max(number - self.influence.shape[1], 1) * self.influence.T @ self.influence

    @property
    def load(self) -> Load:
        """The payload with its uncertainty."""
        covariance = self.covariance
        return Load(self.phi, covariance, likeliest(self.phi, covariance))

    def shared(self, w: Windows, solution: Solution) -> Shared:
        """What its error means for a joint's own numbers."""
        return Shared(_slope(w, solution), self.influence)


def step(phi: np.ndarray, joints: Sequence[tuple[Windows, Solution]]) -> Step:
    """A step of Gauss and Newton.

    Args:
        phi: (10,) the estimate.
        joints: of each joint the windows with that payload on the links, and the joint's own numbers with it.
    """
    information = np.diag(np.repeat((0.0, 1.0 / LARGEST_INERTIA**2), (4, 6)))
    pull = information @ phi
    gradients = np.zeros((joints[0][0].blocks, len(phi)))
    for w, solution in joints:
        slope = _slope(w, solution)
        left = slope - solution.tangent @ np.linalg.lstsq(solution.tangent, slope, rcond=None)[0]
        weight = 1.0 / max(solution.left, 1e-6) ** 2
        information += weight * left.T @ left
        gradients += weight * spread.by_block(left * solution.error[:, None], w.block, w.blocks)
    inverse = np.linalg.pinv(information, hermitian=True)
    influence = gradients @ inverse
    change = inverse @ (gradients.sum(axis=0) - pull)
    deviation = np.sqrt((influence**2).sum(axis=0))
    return Step(phi + change, influence, bool((np.abs(change) <= 0.01 * deviation + 1e-9).all()))


def _slope(w: Windows, solution: Solution) -> np.ndarray:
    values = solution.values
    return (w.payload + values["load"] * w.payload_load) / values["torque_constant"]
