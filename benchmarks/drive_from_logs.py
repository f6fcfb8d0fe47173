"""What the lab logs say about the map from torque and motion to current, and about the gears' ripple.

    python benchmarks/drive_from_logs.py LOGS

LOGS is a folder with one folder per movement. Prints the tables of docs/drive.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import tomli_w
from lab_runs import FREE

from ur5_twin.arm.parameters import load_model
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.drives import terms
from ur5_twin.drives.current_map import CurrentMap
from ur5_twin.evaluation.tables import JOINT_COLUMNS, markdown
from ur5_twin.identification import drive, drive_plant
from ur5_twin.recording import read

TOOL = "xsens_mti"
#: Rows of a window at constant speed, 0.38 s.
WINDOW = 48
#: Two and a half steps of the encoder (9.6 urad): windows whose position ripples less say little, rad.
LEAST_RIPPLE = 2.5e-5


def numbers(values: np.ndarray, digits: int) -> list[str]:
    return ["-" if np.isnan(value) else f"{value:.{digits}f}" for value in values]


def answer_to_ripple(rides: Sequence[terms.Ride], fit: CurrentMap, order: int, joint: int) -> list[str]:
    """How position error and current share the ripple of one order: amplitudes, stiffness, coherence."""
    constant = load_target_current_law().torque_constant[joint]
    errors, torques, speeds = [], [], []
    for of in rides:
        rest = of.current[:, joint] - fit.current(of)[:, joint]
        steady = np.flatnonzero(of.moving[:, joint] & (np.abs(of.qdd[:, joint]) < 1e-6))
        for run in np.split(steady, np.flatnonzero(np.diff(steady) > 1) + 1):
            for start in range(0, len(run) - WINDOW + 1, WINDOW):
                rows = run[start : start + WINDOW]
                time = of.time[rows] - of.time[rows].mean()
                if np.abs(np.diff(time) - 0.008).max() > 1e-3:
                    continue
                speed = order * np.abs(of.qd[rows, joint].mean())
                wave = np.hanning(WINDOW) * np.exp(-1j * speed * time) / (0.25 * WINDOW)
                x, y = (v - np.polyval(np.polyfit(time, v, 2), time) for v in (of.error[rows, joint], rest[rows]))
                if abs(wave @ x) > LEAST_RIPPLE:
                    errors.append(wave @ x)
                    torques.append(constant * (wave @ y))
                    speeds.append(speed)
    if len(errors) < 3:
        return [str(joint + 1), str(order), str(len(errors)), "-", "-", "-", "-"]
    e, t = np.array(errors), np.array(torques)
    coherence, stiffness = 0.0, 0.0
    # Phase turns with speed: averaged within bands of 16 rad/s.
    bands = np.round(np.array(speeds) / 16.0)
    for band in np.unique(bands):
        m = bands == band
        cross = abs(np.vdot(e[m], t[m]))
        coherence += m.sum() * cross / np.sqrt((np.abs(e[m]) ** 2).sum() * (np.abs(t[m]) ** 2).sum())
        stiffness += m.sum() * cross / (np.abs(e[m]) ** 2).sum()
    return [
        str(joint + 1),
        str(order),
        str(len(e)),
        f"{1e3 * np.abs(e).mean():.3f}",
        f"{np.abs(t).mean():.2f}",
        f"{stiffness / len(e):.0f}",
        f"{coherence / len(e):.2f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, help="a folder with one folder per movement")
    options = parser.parse_args()
    missing = [name for name in FREE if not (options.logs / f"Movement_{name}").is_dir()]
    if missing:
        parser.error(f"no Movement_{missing[0]} in {options.logs}")
    model = load_model("plant", TOOL)
    rides = [terms.ride(read(options.logs / f"Movement_{name}", repair=True), model) for name in FREE]

    for candidates, title in ((drive.FREE, "without the servo"), (drive.FOLLOWING, "with the servo")):
        rows = []
        for of in drive.held_out(rides, candidates):
            parts = (
                ("moving", of.moving, 3),
                ("moving, controller's", of.own_moving, 3),
                ("at rest", of.resting, 3),
                ("at rest, controller's", of.own_resting, 3),
                ("whole log, ratio", of.ratio, 2),
            )
            rows += [(of.source.removeprefix("Movement_"), name, *numbers(v, digits)) for name, v, digits in parts]
        print(f"MAE of the current in A by a fit on the other logs, {title}:\n")
        print(markdown(("log", "", *JOINT_COLUMNS), rows, words=2) + "\n")

    smooth = [candidate._replace(shape=candidate.shape._replace(orders=())) for candidate in drive.FREE]
    rows = []
    for k, of in enumerate(rides):
        rest = [r for i, r in enumerate(rides) if i != k]
        for name, shapes in (("with ripple", drive.FREE), ("without", smooth)):
            fit = drive.fit_drive(rest, shapes)
            error = np.abs(fit.current(of) - of.current).mean(axis=0)
            rows.append((of.source.removeprefix("Movement_"), name, *numbers(error, 3)))
    print("what the ripple is worth, whole log, without the servo, A:\n")
    print(markdown(("log", "", *JOINT_COLUMNS), rows, words=2) + "\n")

    fit = drive.fit_drive(rides, smooth)
    rows = [answer_to_ripple(rides, fit, 202 if j < 3 else 404, j) for j in range(6)]
    print("the ripple in position error and current, windows of 0.38 s at constant speed:\n")
    head = ("joint", "order", "windows", "error mrad", "torque Nm", "torque per error Nm/rad", "coherence")
    print(markdown(head, rows) + "\n")

    plant = drive_plant.fit_plant(rides)
    print("the plant's numbers:\n")
    source = "benchmarks/drive_from_logs.py on the free-motion logs of kufieta2014"
    print(tomli_w.dumps({"plant": plant.table(source)}))
    print("standard errors of the ripple's amplitude, Nm:\n")
    rows = [(str(int(n[0])), *numbers(s, 3)) for n, s in zip(plant.order, plant.amplitude_errors, strict=True)]
    print(markdown(("order", *JOINT_COLUMNS), rows) + "\n")
    print("standard errors of the friction's coefficients, in the current (1/Nm A, A, A, A/Nm, A, A s/rad):\n")
    names = ("1/k", "coulomb +", "coulomb -", "load", "stribeck", "viscous")
    print(markdown(("", *JOINT_COLUMNS), [(n, *numbers(e, 4)) for n, e in zip(names, plant.errors, strict=True)]))


if __name__ == "__main__":
    main()
