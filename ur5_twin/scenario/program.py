"""From a scenario's motions to the commands that its controller gets."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ur5_twin import spatial
from ur5_twin.control import commands
from ur5_twin.control.commands import Command, Program, Sent
from ur5_twin.control.waypoints import read_waypoints
from ur5_twin.errors import ScenarioError
from ur5_twin.scenario.motions import Motion, MoveJ, MoveL, ServoJ, Wait, Waypoints
from ur5_twin.scenario.scenario import Scenario

#: An arm without motions stands; how long, the scenario's duration says.
_STANDING = (commands.Wait(0.0),)


def program_of(scenario: Scenario) -> Program | Sent:
    """What the controller is told: one program, or, for a waypoint file, moves sent one by one.

    Raises:
        ScenarioError: a file cannot be read, or a waypoint file is not the scenario's only motion.
    """
    for i, motion in enumerate(scenario.motions):
        if isinstance(motion, Waypoints):
            if len(scenario.motions) > 1:
                raise ScenarioError(
                    f"{scenario.path.name}: motion[{i}]: waypoints are sent from outside while the arm moves or not; "
                    "they must be the scenario's only motion"
                )
            waypoints = read_waypoints(motion.path, space=motion.space, wait=motion.wait)
            return waypoints.sent()
    return Program(tuple(_command(motion) for motion in scenario.motions) or _STANDING)


def _command(motion: Motion) -> Command:
    if isinstance(motion, MoveJ):
        return commands.MoveJ(tuple(motion.q), a=motion.acceleration, v=motion.speed, r=motion.blend)
    if isinstance(motion, MoveL):
        goal = commands.Pose(tuple(spatial.vector_from_pose(motion.X_BF)))
        return commands.MoveL(goal, a=motion.acceleration, v=motion.speed, r=motion.blend)
    if isinstance(motion, Wait):
        return commands.Wait(motion.duration)
    assert isinstance(motion, ServoJ)
    times, points = read_stream(motion.path)
    return commands.ServoJ(times, points, lookahead_time=motion.lookahead, gain=motion.gain)


def read_stream(path: Path) -> tuple[tuple[float, ...], tuple[tuple[float, ...], ...]]:
    """Times in s and joint positions in rad of a servoj file: seven numbers a line, commas or blanks between them.

    Raises:
        ScenarioError: the file cannot be read or a line is wrong; the message names file and line.
    """
    rows = []
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise ScenarioError(f"cannot read {path}: {error.strerror}") from None
    for number, line in enumerate(lines, start=1):
        content = line.split("#")[0].replace(",", " ").split()
        if not content:
            continue
        try:
            row = [float(word) for word in content]
        except ValueError:
            row = []
        if len(row) != 7 or not np.isfinite(row).all():
            raise ScenarioError(f"{path.name}, line {number}: '{line.strip()}' is not a time and six joint positions")
        rows.append(row)
    if not rows:
        raise ScenarioError(f"{path.name}: no set points; a line is a time in s and six joint positions in rad")
    return tuple(row[0] for row in rows), tuple(tuple(row[1:]) for row in rows)
