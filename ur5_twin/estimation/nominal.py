"""What an estimator believes of the arm: a model that may be wrong, and never the truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ur5_twin.arm import dynamics, kinematics
from ur5_twin.arm.drive import JointDrives, LinearDrive, drives_of, load_drive, load_joint_drives
from ur5_twin.arm.parameters import ArmModel, load_model
from ur5_twin.control.target_current import TargetCurrentLaw, load_target_current_law
from ur5_twin.drives.current_map import CurrentMap, load_current_map
from ur5_twin.estimation.settings import Settings, load_settings
from ur5_twin.sensing.specs import load_sensors

#: The robot's tick, s: 125 Hz.
PERIOD = 0.008


@dataclass(frozen=True)
class Noise:
    """Standard deviations of what is measured, each (6,).

    Attributes:
        current: of actual_current at rest, A.
        current_moving: what comes to it in motion, A, as white noise that does as much to an average.
        velocity: of actual_qd, rad/s.
    """

    current: np.ndarray
    current_moving: np.ndarray
    velocity: np.ndarray


@dataclass(frozen=True)
class NominalModel:
    """All that an estimator is made from.

    Attributes:
        arm: rigid bodies, rotors and gravity, with the tool that the estimator was told of.
        drives: torque constants, friction and ripple of the joints.
        law: the controller's own current law, which tells the drives' temperature.
        current_map: the drives as identified, from torque and motion to current, without the servo.
        linear: the thesis' map from current to torque, for the estimators that use no other.
        noise: of the signals.
        settings: gains and levels.
    """

    arm: ArmModel
    drives: JointDrives
    law: TargetCurrentLaw
    current_map: CurrentMap
    linear: LinearDrive
    noise: Noise
    settings: Settings

    @cached_property
    def packed(self) -> dynamics.Packed:
        """The rigid bodies for the compiled kernels."""
        return dynamics.pack(self.arm)

    @cached_property
    def dh(self) -> np.ndarray:
        """(6, 4) the kinematics for the compiled kernels."""
        return kinematics.pack_dh(self.arm)


def load_nominal(
    arm: str | Path = "plant",
    tool: str | None = None,
    joints: str | Path | None = None,
    *,
    drive: str | Path = "thesis",
    current_map: str | Path = "lab",
    sensors: str | Path = "lab",
    settings: Path | None = None,
) -> NominalModel:
    """A nominal model from files alone.

    Args:
        arm: rigid bodies (``load_model``).
        tool: what is bolted to the flange as far as the estimator was told (``load_tool``).
        joints: motors and gears (``load_joint_drives``), by default the arm model's own.
        current_map: the drives for ``friction_kalman`` (``load_current_map``).
        drive: map from current to torque of ``direct`` and ``direct_friction`` (``load_drive``).
        sensors: noise of the signals (``load_sensors``).
        settings: gains, by default ``models/estimators.toml``.

    Raises:
        ModelError: a name is unknown or a file is wrong.
    """
    model = load_model(arm, tool)
    suite = load_sensors(sensors)
    # White noise that low-passes to the same level: the sum of the autocorrelation of a first-order pole.
    spread = np.sqrt((1.0 + suite.current_pole) / (1.0 - suite.current_pole))
    return NominalModel(
        arm=model,
        drives=drives_of(model) if joints is None else load_joint_drives(joints),
        law=load_target_current_law(),
        current_map=load_current_map(current_map),
        linear=load_drive(drive),
        noise=Noise(
            current=np.hypot(_six(suite.current.noise), _six(suite.current.step) / np.sqrt(12.0)),
            current_moving=spread * _six(suite.current_moving),
            velocity=_six(suite.velocity.step) / np.sqrt(12.0),
        ),
        settings=load_settings(settings),
    )


def _six(value: object) -> np.ndarray:
    """A channel's number per joint; a fault it does not have is none."""
    return np.zeros(6) if value is None else np.broadcast_to(np.asarray(value, dtype=float), (6,)).copy()
