"""The force sensor's readings, and the controller's estimate, as wrenches on the arm.

The sensor reads what its surroundings do to it, so its reading, less its bias, is the wrench ON the arm; the
controller's actual_TCP_force is what the arm does to its surroundings, the motors' torque beyond what the motion needs
(``control.tcp_force``). At standstill the lab's logs tell: a push moves a joint the way the reading says before the
servo brings it back (docs/servo.md), and the motor's current answers against it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ur5_twin import spatial
from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import FT_SENSOR, ArmModel, Tool
from ur5_twin.errors import RecordingError
from ur5_twin.recording.table import Recording, Table

#: The sensor's reading of this long from its beginning is taken for its bias, s.
TARE_TIME = 0.3
#: How late the lab's force sensor is beside its robot, s (docs/servo.md).
FT_DELAY = 0.075


def sensor_bias(recording: Recording) -> np.ndarray:
    """(6,) mean of the force sensor's first 0.3 s in its own axes; zero if there is no sensor."""
    table = recording.tables.get("ft")
    if table is None or "ft_wrench" not in table:
        return np.zeros(6)
    known = np.isfinite(table["ft_wrench"]).all(axis=1)
    if not known.any():
        return np.zeros(6)
    time, values = table.time[known], table["ft_wrench"][known]
    return values[time <= time[0] + TARE_TIME].mean(axis=0)


def on_arm(ft_wrench: np.ndarray, X_BF: np.ndarray, tool: Tool | None, bias: np.ndarray) -> np.ndarray:
    """(n, 6) the wrench on the arm at the flange in base axes that the sensor's readings stand for.

    Args:
        ft_wrench: (n, 6) readings, sensor axes.
        X_BF: (n, 4, 4) the flange's pose at each reading.
        tool: what carries the force sensor; without one the moments are about the sensor's own origin.
        bias: (6,) what the sensor reads without load, in its axes.
    """
    on_sensor = ft_wrench - bias
    if tool is not None and FT_SENSOR in tool.sensors:
        on_sensor = spatial.shift_wrench(on_sensor, -tool.sensors[FT_SENSOR])
    return spatial.rotate_wrench(X_BF[:, :3, :3], on_sensor)


def measured_wrench(recording: Recording, arm: ArmModel, delay: float = FT_DELAY) -> tuple[Table, np.ndarray]:
    """What the force sensor read, tared, for each row of the robot's table.

    Args:
        recording: with ``ft_wrench``.
        arm: with the tool that carries the sensor; without one the moments are about the sensor's own origin.
        delay: s by which the sensor's rows are late beside the robot's.

    Returns:
        The aligned table, and (n, 6) the wrench on the arm at the flange in base axes, N and Nm; NaN where the sensor
        is silent.

    Raises:
        RecordingError: the log holds no reading of a force sensor.
    """
    table = recording.tables.get("ft")
    if table is None or "ft_wrench" not in table or not np.isfinite(table["ft_wrench"]).any():
        raise RecordingError(f"{recording.source}: no ft_wrench; the log has no force sensor's readings")
    aligned = recording.with_table(replace(table, time=table.time - delay)).aligned()
    X_BF = kinematics.forward(arm, aligned["actual_q"])
    return aligned, on_arm(aligned["ft_wrench"], X_BF, arm.tool, sensor_bias(recording))
