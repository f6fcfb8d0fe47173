"""A log's motion once more in the cell: what the twin's devices would have written in the lab's place."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ur5_twin.arm.drive import load_joint_drives
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.gains import load_gains
from ur5_twin.control.held import commanded
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.errors import SimulationError
from ur5_twin.recording.carried import carried_tool
from ur5_twin.recording.table import Recording
from ur5_twin.sensing import SensorSuite
from ur5_twin.sources.recorded import RecordedSource
from ur5_twin.twin.cell import Cell, Push, Setup
from ur5_twin.twin.closed_loop import Limits
from ur5_twin.twin.telemetry import Telemetry


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
    setup = Setup(
        controller=load_model("controller"),
        plant=load_model("plant", carried_tool(recording)),
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
