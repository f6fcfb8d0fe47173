"""The robot's own estimate: actual_TCP_force, turned round to be the wrench on the arm.

Where a log does not hold it, it is computed by the law that the real controller follows to its printed digits
(``control.tcp_force``), from the last one that was published on.
"""

from __future__ import annotations

import numpy as np

from ur5_twin.control.tcp_force import TcpForce, load_tcp_force_law
from ur5_twin.estimation.intake import Intake, Step
from ur5_twin.estimation.motor_torque import MOVING
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.protocol import Estimate, Sample
from ur5_twin.estimation.wrench import WrenchSolver

_NEEDED = ("target_qd", "target_moment", "target_current", "actual_q", "actual_qd", "actual_current")


class Controller:
    """F^u. The covariance is what the nominal model says of such torques: the controller publishes none."""

    def __init__(self, nominal: NominalModel) -> None:
        law = load_tcp_force_law(current=nominal.law)
        self._force = TcpForce(nominal.arm, law)
        self._solver = WrenchSolver(nominal)
        friction, noise = nominal.drives.friction, nominal.noise
        # Its law knows no Coulomb friction, so that all of it may stand in the estimate.
        level = 0.5 * (friction.coulomb_positive + friction.coulomb_negative)
        still = np.square(nominal.law.torque_constant) * law.weight / (2.0 - law.weight)
        self._resting = still * noise.current**2 + level**2
        self._moving = self._resting + still * noise.current_moving**2
        self._intake = Intake(_NEEDED)
        # The last row whose force was published, while the law has not been taken up from it.
        self._published: tuple[np.ndarray, np.ndarray] | None = None
        self._last = self._solver.unknown()

    def update(self, sample: Sample) -> Estimate:
        """The estimate at this sample (``protocol.Estimator``)."""
        if self._intake.update(sample) is Step.NOTHING:
            return self._last
        good = self._intake.sample
        force = np.asarray(good.actual_TCP_force, dtype=float)
        if np.isfinite(force).all():
            self._published = (good.actual_q.copy(), force)
        else:
            force = self._computed(good)
        self._solver.look(good.actual_q)
        variance = np.where(np.abs(good.target_qd) > MOVING, self._moving, self._resting)
        self._last = self._solver.around(-force, variance)
        return self._last

    def _computed(self, good: Sample) -> np.ndarray:
        if self._published is not None:
            self._force.start(*self._published)
            self._published = None
        rows = (
            good.actual_q,
            good.actual_qd,
            good.actual_current,
            good.target_qd,
            good.target_moment,
            good.target_current,
        )
        return self._force(*(row[None] for row in rows))[0]
