"""What a force sensor and an accelerometer at the flange feel, from the arm's motion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ur5_twin import spatial
from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.sensing.signals import Load, Signals


@dataclass(frozen=True)
class FlangeMotion:
    """How the flange moves, in base axes.

    Attributes:
        R_FB: (n, 3, 3) base axes in flange axes.
        omega, alpha: (n, 3) rad/s, rad/s^2.
        acceleration: (n, 3) of its origin, less gravity: what a mass there would weigh over its mass, m/s^2.
    """

    R_FB: np.ndarray
    omega: np.ndarray
    alpha: np.ndarray
    acceleration: np.ndarray

    @classmethod
    def of(cls, model: ArmModel, signals: Signals) -> FlangeMotion:
        """Of an arm that moves as signals say."""
        R_FB = np.swapaxes(kinematics.forward(model, signals.q)[:, :3, :3], 1, 2)
        twist, acceleration = kinematics.motion(model, signals.q, signals.qd, signals.qdd)
        acceleration[:, 2] += model.gravity
        return cls(R_FB, twist[:, 3:], acceleration[:, 3:], acceleration[:, :3])

    def at(self, point: np.ndarray) -> np.ndarray:
        """(n, 3) acceleration less gravity of a point (3,) in the flange frame, in flange axes, m/s^2.

        R_FB (a_F - g + alpha x r + omega x (omega x r)) with r = R_BF point (thesis equation 5.9).
        """
        omega, alpha = self.omega_in_flange, self.alpha_in_flange
        turning = spatial.cross(alpha, point) + spatial.cross(omega, spatial.cross(omega, point))
        return self._acceleration_in_flange + turning

    @cached_property
    def omega_in_flange(self) -> np.ndarray:
        """(n, 3) rad/s in flange axes."""
        return self.into_flange(self.omega)

    @cached_property
    def alpha_in_flange(self) -> np.ndarray:
        """(n, 3) rad/s^2 in flange axes."""
        return self.into_flange(self.alpha)

    @cached_property
    def _acceleration_in_flange(self) -> np.ndarray:
        return self.into_flange(self.acceleration)

    def into_flange(self, vectors: np.ndarray) -> np.ndarray:
        """(n, 3) vectors in base axes, in flange axes."""
        return (self.R_FB @ vectors[:, :, None])[:, :, 0]


def sensed_wrench(motion: FlangeMotion, wrench: np.ndarray, load: Load, p_FS: np.ndarray) -> np.ndarray:
    """(n, 6) force and moment on the sensor about its origin in its axes (the flange's), N and Nm.

    The wrench of contacts and pushes, and what the load beyond the sensor does to it by weight and inertia::

        f = m (g - a_C),    n = c x f - (I alpha + omega x I omega)    about the flange

    Args:
        motion: of the flange.
        wrench: (n, 6) of contacts and pushes on the tool, at the flange in base axes.
        load: what hangs on the sensor.
        p_FS: (3,) the sensor's origin in the flange frame, m.
    """
    in_flange = spatial.rotate_wrench(motion.R_FB, wrench)
    if load.mass > 0.0:
        force = -load.mass * motion.at(load.center)
        omega, alpha = motion.omega_in_flange, motion.alpha_in_flange
        # Row by row: one product of matrices rounds by the number of rows.
        turning = load.inertia @ np.stack([alpha, omega], axis=2)
        spin = turning[:, :, 0] + spatial.cross(omega, turning[:, :, 1])
        in_flange = in_flange + np.concatenate([force, spatial.cross(load.center, force) - spin], axis=1)
    return spatial.shift_wrench(in_flange, p_FS)
