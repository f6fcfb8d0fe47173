"""What goes into an estimator of external forces, what comes out, and what is asked of it in between."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import numpy as np

if TYPE_CHECKING:
    from ur5_twin.estimation.nominal import NominalModel


class Sample(NamedTuple):
    """One row of what a real robot publishes, in RTDE's names; NaN for whatever did not come.

    Nothing here says what the truth is. While the arm is idle ``target_q`` is what was measured a tick before, as the
    real controller publishes it, and not what the servo holds.

    Attributes:
        time: the robot's stamp, s.
        target_q, target_qd, target_qdd: (6,) rad, rad/s, rad/s^2.
        target_current, target_moment: (6,) A and Nm.
        actual_q, actual_qd: (6,) rad and rad/s.
        actual_current: (6,) A.
        actual_TCP_force: (6,) the controller's own estimate: what the ARM exerts, flange, base axes, N and Nm.
        imu_acc, imu_gyro: (3,) specific force in m/s^2 and rate in rad/s, in the flange's axes.
    """

    time: float
    target_q: np.ndarray
    target_qd: np.ndarray
    target_qdd: np.ndarray
    target_current: np.ndarray
    target_moment: np.ndarray
    actual_q: np.ndarray
    actual_qd: np.ndarray
    actual_current: np.ndarray
    actual_TCP_force: np.ndarray
    imu_acc: np.ndarray
    imu_gyro: np.ndarray


class Estimate(NamedTuple):
    """What an estimator believes at a sample.

    Attributes:
        tau_ext: (6,) external torque, Nm, positive where it accelerates the joint.
        wrench: (6,) force and moment ON the arm, at the flange's origin in base axes, N and Nm. A contact elsewhere
            shows as the wrench at the flange with the same torques.
        covariance: (6, 6) of the wrench, N^2, N Nm and Nm^2.
        contact: probability in [0, 1] that anything acts on the arm.
        sigma_min: smallest singular value of the flange's Jacobian, m and rad.
    """

    tau_ext: np.ndarray
    wrench: np.ndarray
    covariance: np.ndarray
    contact: float
    sigma_min: float


@runtime_checkable
class Estimator(Protocol):
    """An estimator with its memory: fed with samples in order, it never looks ahead."""

    def update(self, sample: Sample) -> Estimate:
        """The estimate at this sample, from it and those before it.

        A sample that lacks what the estimator needs gives the last estimate again.
        """
        ...


class Factory(Protocol):
    """What makes an estimator: a class whose instances are made from the nominal model alone."""

    def __call__(self, nominal: NominalModel, /) -> Estimator: ...
