"""Tables 5.5 and 5.6 of the thesis, beside the same numbers from this twin.

    python benchmarks/thesis_tables.py LOGS

LOGS is a folder with one folder per movement. Both No5 runs are replayed with models A, B and C, each under its own
gains. Prints Markdown.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from ur5_twin.arm.drive import load_drive
from ur5_twin.arm.parameters import ArmModel, load_model
from ur5_twin.control.gains import load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.evaluation.metrics import mean_absolute
from ur5_twin.recording import read
from ur5_twin.recording.table import Recording
from ur5_twin.sources.recorded import RecordedSource
from ur5_twin.twin.closed_loop import ClosedLoop
from ur5_twin.twin.lockstep import ServoTwin
from ur5_twin.twin.replay import ReplaySettings, replay

RUNS = {"no disturbance": "Movement_No5_Acc_slow_no_disturbance", "disturbance": "Movement_No5_Acc_slow_w_disturbance"}

#: Thesis tables 5.5 (rad, rad/s) and 5.6 (Nm) as printed, joints 1 to 6.
PRINTED = {
    "actual_q": {
        "a": [0.0001, 0.0002, 0.0004, 0.0005, 0.0002, 0.0003],
        "b": [0.0001, 0.0002, 0.0004, 0.0004, 0.0002, 0.0003],
        "c": [0.0001, 0.0002, 0.0004, 0.0004, 0.0002, 0.0003],
    },
    "actual_qd": {
        "a": [0.0028, 0.0035, 0.0033, 0.0111, 0.0063, 0.0148],
        "b": [0.0028, 0.0035, 0.0033, 0.0110, 0.0063, 0.0148],
        "c": [0.0026, 0.0031, 0.0031, 0.0085, 0.0056, 0.0129],
    },
    "target_moment": {
        "a": [0.3227, 1.8140, 1.9529, 0.2119, 0.2387, 0.0333],
        "b": [0.2973, 0.6082, 1.1918, 0.0808, 0.0393, 0.0333],
        "c": [0.2959, 0.5860, 1.2439, 0.0837, 0.0411, 0.0348],
    },
}
TITLES = {
    "actual_q": ("Table 5.5, positions", "mrad", 1e3),
    "actual_qd": ("Table 5.5, velocities", "mrad/s", 1e3),
    "target_moment": ("Table 5.6, torques of the closed loop against target_moment", "Nm", 1.0),
}


def variants() -> dict[str, ArmModel]:
    """Models beside the printed ones that show where a difference comes from."""
    a, b, c = load_model("a"), load_model("b"), load_model("c")
    return {
        "a, link 4's centre 1.9 mm back along its z": with_center(a, 3, a.links[3].center - [0.0, 0.0, 1.9e-3]),
        "b, link 6's centre as table 4.2 has it": with_center(b, 5, c.links[5].center),
        "c, link 5's centre without its 1.8 mm": with_center(c, 4, c.links[4].center * [1.0, 0.0, 1.0]),
    }


def with_center(model: ArmModel, link: int, center: np.ndarray) -> ArmModel:
    """The same model with one link's mass centre (3,) in m moved."""
    links = list(model.links)
    links[link] = replace(links[link], center=np.asarray(center))
    return replace(model, links=tuple(links))


def errors(recording: Recording, model: ArmModel, gains: str) -> dict[str, np.ndarray]:
    """MAE (6,) of the three signals of the tables, the torque being the closed loop's."""
    settings = ReplaySettings(model, model, load_gains(gains), load_drive(), load_target_current_law())
    robot = replay(recording, settings).robot
    return {
        "actual_q": mean_absolute(robot["actual_q"], robot["sim_actual_q"]),
        "actual_qd": mean_absolute(robot["actual_qd"], robot["sim_actual_qd"]),
        "target_moment": mean_absolute(robot["target_moment"], robot["sim_moment"]),
    }


def positions_without_set_over(recording: Recording, model: str) -> np.ndarray:
    """MAE (6,) in rad of a loop that has to catch up with the target's steps by its gains."""
    arm, source = load_model(model), RecordedSource(recording)
    twin = ServoTwin(ClosedLoop(arm, arm, load_gains(f"thesis_{model}"), set_over=False))
    return mean_absolute(recording.robot["actual_q"], np.array([twin.tick(sample).q for sample in source]))


def row(*cells: object) -> str:
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, help="a folder with one folder per movement")
    options = parser.parse_args()
    logs = {name: read(options.logs / folder) for name, folder in RUNS.items()}
    ours = {
        (model, run): errors(log, load_model(model), f"thesis_{model}") for model in "abc" for run, log in logs.items()
    }
    changed = {
        (name, run): errors(log, model, f"thesis_{name[0]}")
        for name, model in variants().items()
        for run, log in logs.items()
    }
    for signal, (title, unit, scale) in TITLES.items():
        digits = 2 if unit == "mrad" else 1 if unit == "mrad/s" else 4
        print(f"### {title}, {unit}\n")
        print(row("model", "source", *(f"joint {j}" for j in range(1, 7))))
        print("|---|---|" + "---:|" * 6)
        for model in "abc":
            printed = np.array(PRINTED[signal][model]) * scale
            print(row(model.upper(), "thesis", *(f"{value:.{digits}f}" for value in printed)))
            for run in RUNS:
                mae = ours[model, run][signal] * scale
                cells = [f"{value:.{digits}f}" for value in mae]
                print(row(model.upper(), f"ours, {run}", *cells))
        if signal == "actual_q":
            for model in "abc":
                for run, log in logs.items():
                    mae = positions_without_set_over(log, model) * scale
                    name = f"ours, {run}, target's steps left to the gains"
                    print(row(model.upper(), name, *(f"{value:.{digits}f}" for value in mae)))
        if signal == "target_moment":
            for (name, run), found in changed.items():
                print(row(name.capitalize(), f"ours, {run}", *(f"{value:.{digits}f}" for value in found[signal])))
        print()


if __name__ == "__main__":
    main()
