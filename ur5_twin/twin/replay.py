"""Replay: a recording through the twin, row by row, and the predictions written beside what was measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ur5_twin.arm import kinematics
from ur5_twin.arm.drive import JointDrives, LinearDrive
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import FT_SENSOR, ArmModel
from ur5_twin.control.gains import Gains
from ur5_twin.control.target_current import TargetCurrentLaw
from ur5_twin.drives import terms
from ur5_twin.drives.current_map import CurrentMap
from ur5_twin.errors import ReplayError, SimulationError
from ur5_twin.recording import force_sensor
from ur5_twin.recording.table import Note, Recording
from ur5_twin.sources.recorded import RecordedSource
from ur5_twin.twin.closed_loop import ClosedLoop
from ur5_twin.twin.lockstep import LONGEST_GAP, ServoTwin, ShadowTwin

Mode = Literal["servo", "shadow"]
MODES: tuple[Mode, ...] = ("servo", "shadow")
WrenchSource = Literal["none", "measured"]
#: Rows between two calls of a progress callback.
_PROGRESS_EVERY = 250
#: Steps of a target that are worth a word in the report, rad.
_WORTH_A_NOTE = 1e-4
#: Share of rows that a replay may begin again at.
_MOST_RESTARTS = 0.1
#: Where this module's notes say they are from.
_NOTED_BY = "twin"


@dataclass(frozen=True)
class ReplaySettings:
    """What the twin believes and does.

    Attributes:
        model: what the real controller believes, its payload as tool: predicts target_moment and target_current.
        plant: the model that is simulated, with the tool it carries; in shadow replay the torque that a motion needs.
        gains: PD gains of the closed loop.
        drive: map to actual_current: linear, from the twin's torque and velocity, or the drives' current map, from the
            log's targets and the angle of the joints.
        target_current: law from target_moment and target_qd to target_current.
        mode: ``servo`` or ``shadow``.
        joints: the simulated arm's motors and gears; None for motors that give what the controller asks for, without
            friction.
        wrench: what pushes the simulated arm: nothing, or the wrench that the log's force sensor ``measured``, by the
            sensor's place on the plant's tool.
        ft_delay: s by which the force sensor's rows are late beside the robot's.
    """

    model: ArmModel
    plant: ArmModel
    gains: Gains
    drive: LinearDrive | CurrentMap
    target_current: TargetCurrentLaw
    mode: Mode = "servo"
    joints: JointDrives | None = None
    wrench: WrenchSource = "none"
    ft_delay: float = 0.0


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
        (the motors' torque), actual_current (by the drive) and, where the log has targets,
        target_moment (inverse dynamics of the target motion) and target_current.

    Raises:
        ReplayError: a needed signal is missing, the clock does not increase or the simulation fails.
    """
    simulated = settings.mode == "servo" and settings.joints is not None
    source = RecordedSource(recording, _measured_wrench(recording, settings), held=simulated)
    if settings.mode == "servo" and source.missing_targets:
        raise ReplayError(
            f"{recording.source}: servo replay follows targets, and the log has no "
            f"{', '.join(source.missing_targets)}; use --mode shadow (mode='shadow')"
        )
    loop, twin = new_twin(settings)
    q, qd, moment, current = (np.empty((len(source), 6)) for _ in range(4))
    for row, sample in enumerate(source):
        try:
            said = twin.tick(sample)
        except (ReplayError, SimulationError) as error:
            raise ReplayError(f"{recording.source}, row {row + 1}: {error}") from None
        q[row], qd[row], moment[row] = said.q, said.qd, said.moment
        if simulated:
            current[row] = said.current
        if progress is not None and row % _PROGRESS_EVERY == 0:
            progress(row)
    if progress is not None:
        progress(len(source))

    robot = recording.robot
    predicted = {
        "sim_actual_q": q,
        "sim_actual_qd": qd,
        "sim_actual_TCP_pose": kinematics.tcp_pose(settings.model, q),
        "sim_moment": moment,
        "sim_actual_current": current if simulated else _current(recording, settings, moment, q, qd),
    }
    if not source.missing_targets:
        targets = (robot["target_q"], robot["target_qd"], robot["target_qdd"])
        predicted |= target_columns(Dynamics(settings.model), settings.target_current, *targets)
    begun_again = np.isin(robot.time, twin.restarts)
    given_up = np.isin(robot.time, twin.stops)
    if begun_again.mean() > _MOST_RESTARTS:
        raise ReplayError(
            f"{recording.source}: the robot is silent for more than {LONGEST_GAP} s before {begun_again.sum()} of "
            f"{len(robot)} rows, so there is nothing to replay in between; is its time in seconds?"
        )
    # Where the twin begins again it is where the log is, by definition.
    for name in ("sim_actual_q", "sim_actual_qd", "sim_actual_TCP_pose"):
        predicted[name][begun_again | given_up] = np.nan
    earlier = {name: values for name, values in robot.columns.items() if not name.startswith("sim_")}
    kept = [note for note in recording.notes if note.where != _NOTED_BY]
    table = replace(robot, columns={**earlier, **predicted})
    notes = _notes(source, settings.mode, loop, twin.restarts, twin.stops)
    at_limit = (np.abs(moment) >= settings.model.limits.torque).any(axis=1)
    if settings.mode == "servo" and at_limit.any():
        what = f"a motor of the twin is at its torque limit in {at_limit.sum():,} of {len(robot):,} rows"
        notes.append(Note(_NOTED_BY, what))
    return replace(recording, tables={**recording.tables, "robot": table}, notes=(*kept, *notes))


def _current(
    recording: Recording, settings: ReplaySettings, moment: np.ndarray, q: np.ndarray, qd: np.ndarray
) -> np.ndarray:
    """actual_current (n, 6) in A by the drive; q, qd and moment are the twin's."""
    servo = settings.mode == "servo"
    if isinstance(settings.drive, LinearDrive):
        return settings.drive.current(moment, qd if servo else recording.robot["actual_qd"])
    arm = settings.drive.rigid().with_tool(settings.plant.tool)
    return settings.drive.current(
        terms.ride(recording, arm, settings.target_current, motion=(q, qd) if servo else None)
    )


def new_twin(settings: ReplaySettings) -> tuple[ClosedLoop, ServoTwin | ShadowTwin]:
    """The simulated arm, and the twin that moves it, at its beginning."""
    loop = _loop(settings)
    return loop, ServoTwin(loop) if settings.mode == "servo" else ShadowTwin(loop, settings.plant)


def target_columns(
    model: Dynamics, law: TargetCurrentLaw, target_q: np.ndarray, target_qd: np.ndarray, target_qdd: np.ndarray
) -> dict[str, np.ndarray]:
    """What the controller's model says of targets (n, 6): ``sim_target_moment`` and ``sim_target_current``."""
    moment = model.inverse(target_q, target_qd, target_qdd)
    return {"sim_target_moment": moment, "sim_target_current": law.current(moment, target_qd)}


def _loop(settings: ReplaySettings) -> ClosedLoop:
    if settings.joints is not None and settings.mode == "servo":
        # As in the lab: the controller knows the payload it was told of, the arm carries what it carries.
        return ClosedLoop(
            settings.model, settings.plant, settings.gains, law=settings.target_current, drives=settings.joints
        )
    # The simulated loop knows its tool: with the thesis' soft gains one that it does not know would pull it off by
    # centimetres, which the real servo does not let happen.
    return ClosedLoop(settings.model.with_tool(settings.plant.tool), settings.plant, settings.gains)


def _measured_wrench(recording: Recording, settings: ReplaySettings) -> np.ndarray | None:
    """(n, 6) the wrench that the log's force sensor measured, for each row of the robot's table."""
    if settings.wrench == "none":
        return None
    if settings.mode != "servo":
        raise ReplayError("a measured wrench pushes the closed loop: use --mode servo (mode='servo')")
    tool = settings.plant.tool
    if tool is None or FT_SENSOR not in tool.sensors:
        raise ReplayError(
            f"--wrench measured needs to know where the force sensor sits: give a tool with {FT_SENSOR} "
            f"(--tool {FT_SENSOR})"
        )
    # Before the sensor's first and after its last reading nothing is known to push.
    return np.nan_to_num(force_sensor.measured_wrench(recording, settings.plant, settings.ft_delay)[1], nan=0.0)


def _notes(
    source: RecordedSource, mode: Mode, loop: ClosedLoop, restarts: list[float], stops: list[float]
) -> list[Note]:
    """What a reader of the report should know of this run."""
    said = []
    if restarts:
        said.append(
            f"the robot was silent for more than {LONGEST_GAP} s {len(restarts)} times, first before "
            f"{restarts[0]:.3f} s: the twin began again from the log there"
        )
    if stops:
        said.append(
            f"the controller gave up its path {len(stops)} times, as in a protective stop, first at {stops[0]:.3f} s: "
            "its targets jump to where the arm is, and the twin began again from the log there"
        )
    if mode == "servo" and loop.largest_step.max() > _WORTH_A_NOTE:
        steps = ", ".join(f"{step * 1e3:.2g}" for step in loop.largest_step)
        speeds = ", ".join(f"{step:.2g}" for step in loop.largest_qd_step)
        said.append(
            f"the targets step instead of moving, by up to [{steps}] mrad and [{speeds}] rad/s from one sample to the "
            "next: the twin was set over with them"
        )
    if source.missing_targets:
        said.append(
            f"the log has no {', '.join(source.missing_targets)}: the acceleration is the slope of actual_qd, and "
            "target_moment and target_current are not predicted"
        )
    return [Note(_NOTED_BY, what) for what in said]
