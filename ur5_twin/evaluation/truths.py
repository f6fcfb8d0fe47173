"""What an estimate of a log is compared with: the twin's truth, or what the lab's force sensor read."""

from __future__ import annotations

import numpy as np

from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import FT_SENSOR, ArmModel
from ur5_twin.errors import EstimationError
from ur5_twin.evaluation import contacts
from ur5_twin.evaluation.scores import TOUCHED, Truth
from ur5_twin.recording import force_sensor
from ur5_twin.recording.table import Recording

#: Link 7 of the contact table.
_TOOL = len(contacts.LINKS)


def against_truth(recording: Recording) -> Truth:
    """The truth of a simulated run.

    Raises:
        EstimationError: the recording holds none.
    """
    robot = recording.robot
    if "truth_wrench" not in robot or "truth_tau_ext" not in robot:
        raise EstimationError(
            f"{recording.source}: no truth_wrench; only a run of the twin knows it, and writes it to recording.parquet"
        )
    touched = contacts.acting(contacts.touches(recording), len(robot))
    return Truth("truth", robot.time, robot["truth_wrench"], robot["truth_tau_ext"], touched)


def against_zero(recording: Recording) -> Truth:
    """Nothing touches the arm: every estimate is a phantom."""
    n = len(recording.robot)
    return Truth("zero", recording.robot.time, np.zeros((n, 6)), np.zeros((n, 6)), np.zeros(n, dtype=bool))


def at_tool(recording: Recording) -> np.ndarray:
    """(n,) whether all that touches the arm of a simulated run touches it at its tool or last link."""
    away = [touch for touch in contacts.touches(recording) if touch.link < _TOOL - 1]
    return ~contacts.acting(away, len(recording.robot))


def against_sensor(recording: Recording, arm: ArmModel, delay: float = force_sensor.FT_DELAY) -> Truth:
    """What the force sensor read, tared over its first 0.3 s, at the flange in base axes; NaN where it is silent.

    The weight of what hangs beyond the sensor is taken for part of the bias. Joint torques are J' of that wrench.

    Args:
        recording: with ``ft_wrench``.
        arm: with the tool that carries the sensor.
        delay: s by which the sensor's rows are late beside the robot's (docs/servo.md).

    Raises:
        RecordingError: no force sensor in the log; EstimationError: none on the arm's tool.
    """
    aligned, wrench = force_sensor.measured_wrench(recording, arm, delay)
    if arm.tool is None or FT_SENSOR not in arm.tool.sensors:
        raise EstimationError(f"nobody said where the force sensor sits: give a tool that has it (--tool {FT_SENSOR})")
    tau_ext = np.einsum("nij,ni->nj", kinematics.jacobian(arm, aligned["actual_q"]), wrench)
    # A sensor's noise is no touch, and a touch that swings through zero goes on.
    touched = np.linalg.norm(np.nan_to_num(wrench[:, :3]), axis=1) > TOUCHED
    return Truth("ft", aligned.time, wrench, tau_ext, touched)
