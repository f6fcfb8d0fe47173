"""A log's motion once more in the cell: what the twin's devices would have written in the lab's place."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ur5_twin.arm.drive import load_joint_drives
from ur5_twin.arm.parameters import FT_SENSOR, IMU_SENSOR, load_model
from ur5_twin.control.gains import load_gains
from ur5_twin.control.held import commanded
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.errors import SimulationError
from ur5_twin.recording.table import Recording
from ur5_twin.sensing import SensorSuite
from ur5_twin.sources.recorded import RecordedSource
from ur5_twin.twin.cell import Cell, Push, Setup
from ur5_twin.twin.closed_loop import Limits
from ur5_twin.twin.telemetry import Telemetry


class MeasuredPush:
    """A wrench at the flange as it was measured, linear in between, none where it is not known.

    Args:
        time: (n,) s.
        wrench: (n, 6) on the arm in base axes, N and Nm.
    """

    body, point, turning = "tool", np.zeros(3), False

    def __init__(self, time: np.ndarray, wrench: np.ndarray) -> None:
        self._time, self._wrench = time, np.nan_to_num(wrench)

    def acts_within(self, start: float, end: float) -> bool:
        return bool(self._time[0] < end and self._time[-1] > start)

    def wrench(self, time: np.ndarray) -> np.ndarray:
        columns = [np.interp(time, self._time, column, left=0.0, right=0.0) for column in self._wrench.T]
        return np.stack(columns, axis=-1)


def retrace(recording: Recording, suite: SensorSuite, seed: int = 0, pushes: Sequence[Push] = ()) -> Recording:
    """Let the cell's arm follow a log's targets, untouched but for ``pushes``, with the sensors that the log has.

    Args:
        recording: with targets, at the robot's 8 ms.
        suite: the sensors.
        seed: of their noise.
        pushes: wrenches on the arm, on the log's clock.

    Raises:
        ReplayError: the log has no targets; SimulationError: the cell cannot follow them.
    """
    source = RecordedSource(recording)
    robot = recording.robot
    if source.missing_targets:
        raise SimulationError(f"{recording.source}: no {', '.join(source.missing_targets)}: there is nothing to follow")
    targets = commanded(np.stack([robot["target_q"], robot["target_qd"], robot["target_qdd"]], axis=1))
    carried = [name for name, device in ((FT_SENSOR, "ft"), (IMU_SENSOR, "imu")) if device in recording.tables]
    setup = Setup(
        controller=load_model("controller"),
        plant=load_model("plant", "+".join(carried) or "none"),
        gains=load_gains("servo"),
        law=load_target_current_law(),
        drives=load_joint_drives(),
        limits=Limits(math.inf, math.inf, math.inf),
        q_start=targets[0, 0],
        pushes=tuple(pushes),
    )
    cell = Cell(setup)
    telemetry = Telemetry(setup, cell.geoms, suite, np.random.default_rng(seed))
    for piece in cell.advance(targets[1:]):
        telemetry.observe(piece)
    if cell.failure is not None:
        raise SimulationError(f"{recording.source}: {cell.failure}")
    return telemetry.recording(recording.source)
