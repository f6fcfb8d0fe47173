"""The controller's current law, on made-up torques and on what the real controller said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ur5_twin.arm.drive import load_manufacturer_drive
from ur5_twin.control.target_current import driving_share, load_target_current_law
from ur5_twin.recording import read


def test_branches() -> None:
    torque = np.array([5.0, -5.0, 5.0, -5.0, 0.0, 5.0])
    qd = np.array([0.1, -0.1, -0.1, 0.1, 0.1, 0.0])
    assert driving_share(torque, qd).tolist() == [1.0, 1.0, 0.0, 0.0, 0.5, 0.5]


def test_viscous_ratios_are_those_of_table_4_1() -> None:
    law = load_target_current_law()
    ratio = law.viscous_backdriven / law.viscous_driving
    printed = load_manufacturer_drive()
    # Temperatures that step within a log blur the two branches a little.
    assert np.allclose(ratio, printed.viscous_friction_backdrive / printed.viscous_friction, rtol=2e-3)


def test_standstill_current_of_every_log(lab_logs: Path) -> None:
    """At rest the law has no friction and no temperature: it holds to the digits of its torque constants."""
    law = load_target_current_law()
    for folder in sorted(lab_logs.glob("Movement_*")):
        robot = read(folder).robot
        still = (robot["target_qd"] == 0).all(axis=1)
        # The last tick of a move rounds to no velocity in the log, but its friction still stands in the current.
        still[1:] &= still[:-1]
        error = law.current(robot["target_moment"], robot["target_qd"]) - robot["target_current"]
        # Four digits of k at up to 6 A.
        assert np.abs(error[still]).max() < 1e-3, folder.name


@pytest.mark.parametrize("movement", ["Movement_No5_Acc_slow_w_disturbance", "Movement_No9_Singularity_Free_NoDist"])
def test_moving_current(lab_logs: Path, movement: str) -> None:
    """In motion the drive temperature is unknown: 20 % of a viscous current of at most 1 A."""
    law = load_target_current_law()
    robot = read(lab_logs / movement).robot
    error = law.current(robot["target_moment"], robot["target_qd"]) - robot["target_current"]
    assert np.abs(error).mean(axis=0).max() < 0.02
