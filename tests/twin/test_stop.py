"""A collision: the controller gives up its path, and the twin begins again where the arm is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ur5_twin.arm.drive import load_drive, load_joint_drives
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.gains import load_gains
from ur5_twin.control.held import given_up
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.recording.table import Recording
from ur5_twin.scenario import load_scenario
from ur5_twin.twin.live import LiveTwin
from ur5_twin.twin.replay import ReplaySettings, replay
from ur5_twin.twin.scenario_run import ScenarioRun


@pytest.fixture(scope="module")
def collision() -> Recording:
    """1 m/s into a block: a protective stop, and targets that jump from the path to where the arm is."""
    return ScenarioRun(load_scenario("collide_100"), 0).finish()


def settings(mode: str, *, joints: bool) -> ReplaySettings:
    model = load_model("controller")
    made = ReplaySettings(model, load_model("plant"), load_gains("servo"), load_drive(), load_target_current_law())
    return replace(made, mode=mode, joints=load_joint_drives() if joints else None)


@pytest.mark.parametrize(("mode", "joints"), [("servo", False), ("servo", True), ("shadow", False)])
def test_the_twin_begins_again_where_a_path_was_given_up(collision: Recording, mode: str, joints: bool) -> None:
    of = settings(mode, joints=joints)
    replayed = replay(collision, of)
    robot = replayed.robot
    jump = int(np.argmax(np.abs(np.diff(robot["target_q"], axis=0)).max(axis=1))) + 1
    assert np.abs(robot["target_q"][jump] - robot["target_q"][jump - 1]).max() > 0.1
    unknown = np.isnan(robot["sim_actual_q"]).any(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(unknown), [jump])
    assert any("the controller gave up its path 1 times" in str(note) for note in replayed.notes)
    # It goes on from where the arm is, which still swings at 1 rad/s, and not from 0.16 rad beyond.
    assert np.abs(robot["sim_actual_q"] - robot["actual_q"])[jump + 1].max() < 0.02
    # Row by row, as beside a running robot, it is the same.
    live, columns = LiveTwin(of), {}
    names = ("target_q", "target_qd", "target_qdd", "actual_q", "actual_qd", "actual_current")
    for rows in np.array_split(np.arange(len(robot)), 40):
        said = live.follow(robot.time[rows], {name: robot[name][rows] for name in names})
        for name, values in said.items():
            columns.setdefault(name, []).append(values)
    for name in ("sim_actual_q", "sim_actual_qd", "sim_moment"):
        np.testing.assert_array_equal(np.concatenate(columns[name]), robot[name], name)
    assert live.failures == 0
    assert live.restarts == 1


def test_only_a_jump_to_the_arm_is_a_path_given_up() -> None:
    before, arm = np.zeros(6), np.full(6, 0.2)
    assert given_up(before, arm, arm)
    assert given_up(before, arm + 1e-3, arm)
    # Nowhere near the arm, as targets in degrees would be, or no jump.
    assert not given_up(before, np.full(6, 0.4), arm)
    assert not given_up(before, np.full(6, 0.01), np.full(6, 0.01))
