"""A payload that nobody has weighed, from the same currents as the plant: one body for all joints and logs.

Beside the payload's ten numbers the masses of links 2 to 6 are sought, which are known to ``LINK_MASS_OFF``: what an
arm weighs more than it should must not count as payload. The current of joint j depends on these numbers by
S_j = (d link + load d |link| sgn(qd)) / k. With each joint's own numbers solved for at every step (variable projection;
Golub and Pereyra 1973, in the form of Kaufman 1975) what is left depends on them by Q_j = S_j - T_j T_j^+ S_j with the
derivatives T_j in the joint's own numbers, and

    step = (sum_j Q_j' Q_j / s_j^2 + prior)^-1 (sum_j Q_j' e_j / s_j^2 - prior numbers)

with s_j the standard deviation of what joint j leaves. The links set the scale of both torque constants and payload.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ur5_twin.identification import spread
from ur5_twin.identification.load import LARGEST_INERTIA, LINK_MASS_OFF, Load, likeliest
from ur5_twin.identification.plant_solve import Shared, Solution
from ur5_twin.identification.plant_windows import BODY, Windows

#: Standard deviations of what is known beforehand of mass, first and second moments, and the shares of masses.
_KNOWN = np.repeat((np.inf, LARGEST_INERTIA, LINK_MASS_OFF), (4, 6, 5))


@dataclass(frozen=True)
class Step:
    """From one estimate of payload and links' masses to the next.

    Attributes:
        numbers: (15,) the new estimate.
        influence: (m, 15) what each second of the logs, and what was known beforehand, adds to its error.
        done: whether it moved by less than a hundredth of its standard deviations.
    """

    numbers: np.ndarray
    influence: np.ndarray
    done: bool

    @property
    def load(self) -> Load:
        """The payload with its uncertainty; errors are correlated within a second."""
        phi, influence = self.numbers[:BODY], self.influence[:, :BODY]
        number = int(influence.any(axis=1).sum())
        covariance = number / max(number - len(_KNOWN), 1) * influence.T @ influence
        return Load(phi, covariance, likeliest(phi, covariance))

    def shared(self, w: Windows, solution: Solution) -> Shared:
        """What the payload's error means for a joint's own numbers."""
        return Shared(_slope(w, solution)[:, :BODY], self.influence[:, :BODY])


def step(numbers: np.ndarray, joints: Sequence[tuple[Windows, Solution]]) -> Step:
    """A step of Gauss and Newton.

    Args:
        numbers: (15,) the estimate.
        joints: of each joint the windows with these numbers on the links, and the joint's own numbers with them.
    """
    known = np.diag(1.0 / _KNOWN)
    information = known**2
    gradients = np.zeros((joints[0][0].blocks, len(numbers)))
    for w, solution in joints:
        slope = _slope(w, solution)
        left = slope - solution.tangent @ np.linalg.lstsq(solution.tangent, slope, rcond=None)[0]
        weight = 1.0 / max(solution.left, 1e-6) ** 2
        information += weight * left.T @ left
        gradients += weight * spread.by_block(left * solution.error[:, None], w.block, w.blocks)
    inverse = np.linalg.pinv(information, hermitian=True)
    influence = np.concatenate([gradients, known]) @ inverse
    change = inverse @ (gradients.sum(axis=0) - known**2 @ numbers)
    deviation = np.sqrt((influence**2).sum(axis=0))
    return Step(numbers + change, influence, bool((np.abs(change) <= 0.01 * deviation + 1e-9).all()))


def _slope(w: Windows, solution: Solution) -> np.ndarray:
    values = solution.values
    return (w.sought + values["load"] * w.sought_load) / values["torque_constant"]
