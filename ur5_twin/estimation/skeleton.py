"""What the estimators on the arm's momentum have in common; an estimator of one's own fills in one method.

::

    class Averager(MomentumEstimator):
        '''The external torque, averaged over a tenth of a second.'''

        def observe(self, arm: ArmState) -> None:
            self.tau += min(arm.dt / 0.1, 1.0) * (arm.mean - self.tau)
            self.variance[:] = 0.04 * arm.white + arm.bias
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from ur5_twin.estimation.arm_state import ArmState, Step
from ur5_twin.estimation.motor_torque import MotorTorque
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.protocol import Estimate, Sample
from ur5_twin.estimation.wrench import WrenchSolver

#: Variance of an external torque of which nothing is known yet, Nm^2.
_UNKNOWN = 1e4


class MomentumEstimator(ABC):
    """Joint torques from the arm's momentum, and the wrench from them.

    Args:
        nominal: what the estimator believes.
        motor: torque of the motors less friction, by default the law of the nominal model's drives.

    Attributes:
        tau: (6,) the external torque as estimated so far, Nm; ``observe`` writes it.
        variance: (6,) of it, Nm^2; ``observe`` writes it.
    """

    def __init__(self, nominal: NominalModel, motor: MotorTorque | None = None) -> None:
        self.arm = ArmState(nominal, motor)
        self.solver = WrenchSolver(nominal)
        self.tau, self.variance = np.zeros(6), np.full(6, _UNKNOWN)
        self._last = self.solver.unknown()

    def update(self, sample: Sample) -> Estimate:
        """The estimate at this sample (``protocol.Estimator``)."""
        step = self.arm.update(sample)
        if step is Step.NOTHING:
            return self._last
        self.solver.look(self.arm.q)
        if step is Step.STEP:
            self.observe(self.arm)
        self._last = self.solved()
        return self._last

    @abstractmethod
    def observe(self, arm: ArmState) -> None:
        """Bring ``tau`` and ``variance`` up to a sample that follows the last by ``arm.dt``."""

    def solved(self) -> Estimate:
        """The estimate at the posture of the last sample."""
        return self.solver.solve(self.tau, self.variance)
