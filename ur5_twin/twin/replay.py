"""Replay: a recording through the twin, row by row, and the predictions written beside what was measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ur5_twin.arm import kinematics
from ur5_twin.arm.drive import LinearDrive
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.control.gains import PDGains
from ur5_twin.control.target_current import TargetCurrentLaw
from ur5_twin.errors import ReplayError
from ur5_twin.recording.table import Note, Recording
from ur5_twin.sources.recorded import RecordedSource
from ur5_twin.twin.lockstep import ClosedLoop, ServoTwin, ShadowTwin

Mode = Literal["servo", "shadow"]
MODES: tuple[Mode, ...] = ("servo", "shadow")
#: Rows between two calls of a progress callback.
_PROGRESS_EVERY = 250
#: Steps of a target that are worth a word in the report, rad.
_WORTH_A_NOTE = 1e-4


@dataclass(frozen=True)
class ReplaySettings:
    """What the twin believes and does.

    Attributes:
        model: the model the controller linearises with; target_moment and, in shadow replay, the needed torque too.
        plant: the model that is simulated.
        gains: PD gains of the closed loop.
        drive: map from torque and velocity to actual_current.
        target_current: law from target_moment and target_qd to target_current.
        mode: ``servo`` or ``shadow``.
    """

    model: ArmModel
    plant: ArmModel
    gains: PDGains
    drive: LinearDrive
    target_current: TargetCurrentLaw
    mode: Mode = "servo"


def replay(
    recording: Recording, settings: ReplaySettings, progress: Callable[[int], object] | None = None
) -> Recording:
    """Run the twin beside a recording.

    Args:
        recording: what the robot reported.
        settings: what the twin believes and does.
        progress: called now and then with the number of rows done so far.

    Returns:
        The recording with ``sim_<signal>`` columns in its robot table: actual_q, actual_qd, actual_TCP_pose, moment
        (the motors' torque), actual_current (of that torque, through the drive) and, where the log has targets,
        target_moment (inverse dynamics of the target motion) and target_current.

    Raises:
        ReplayError: a needed signal is missing, the clock does not increase or the simulation fails.
    """
    source = RecordedSource(recording)
    loop = ClosedLoop(settings.model, settings.plant, settings.gains)
    twin = ServoTwin(loop) if settings.mode == "servo" else ShadowTwin(loop, settings.model)
    q, qd, moment = (np.empty((len(source), 6)) for _ in range(3))
    for row, sample in enumerate(source):
        try:
            q[row], qd[row], moment[row] = twin.tick(sample)
        except ReplayError as error:
            raise ReplayError(f"{recording.source}, row {row + 1}: {error}") from None
        if progress is not None and row % _PROGRESS_EVERY == 0:
            progress(row)
    if progress is not None:
        progress(len(source))

    robot = recording.robot
    motion_qd = qd if settings.mode == "servo" else robot["actual_qd"]
    predicted = {
        "sim_actual_q": q,
        "sim_actual_qd": qd,
        "sim_actual_TCP_pose": kinematics.tcp_pose(settings.model, q),
        "sim_moment": moment,
        "sim_actual_current": settings.drive.current(moment, motion_qd),
    }
    if source.has_targets:
        target_moment = Dynamics(settings.model).inverse(robot["target_q"], robot["target_qd"], robot["target_qdd"])
        predicted["sim_target_moment"] = target_moment
        predicted["sim_target_current"] = settings.target_current.current(target_moment, robot["target_qd"])
    notes = [
        Note("twin", f"the robot was silent before {at:.3f} s for too long to bridge: the twin began again there")
        for at in twin.restarts
    ]
    if settings.mode == "servo" and loop.largest_step.max() > _WORTH_A_NOTE:
        steps = ", ".join(f"{step * 1e3:.2g}" for step in loop.largest_step)
        what = f"the targets step by up to [{steps}] mrad where no motion is asked for: the twin was set over with them"
        notes.append(Note("twin", what))
    return recording.with_table(robot.with_columns(predicted)).with_notes(notes)
