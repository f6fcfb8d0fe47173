"""Pushes of known size put into the currents of real free motion, and what friction_kalman makes of them.

    python benchmarks/pushes_into_free_logs.py LOGS [--pushes hand|leaning] [--force N ...] [--push S ...]
                                               [--lasting N ...] [--lasts S ...]

LOGS is a folder with one folder per movement. Each of the five free logs is estimated with a current map of the other
four, so that drives, ripple and noise are real and unknown, while the pushes (up to 40 N and 2 s by hand, up to 60 N
and 6 s by one who leans, any direction, seeded) are known exactly: actual_current - slope J' w. Prints, for each
setting of the filter's expected push, error, coverage and what saying nothing would cost. The settings in
models/estimators.toml are chosen by it; no log with a force sensor takes part.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import load_model
from ur5_twin.drives import terms
from ur5_twin.estimation.expected_current import ExpectedCurrent
from ur5_twin.estimation.friction_kalman import FrictionKalman
from ur5_twin.estimation.nominal import NominalModel, load_nominal
from ur5_twin.estimation.samples import estimate, samples_of
from ur5_twin.evaluation.tables import markdown
from ur5_twin.identification import drive
from ur5_twin.recording import read
from ur5_twin.recording.table import Recording

FREE = (
    "No3_Acc",
    "No4_Acc",
    "No5_Acc_slow_no_disturbance",
    "No6_Acc_slow_Verify_Model",
    "No9_Singularity_Free_NoDist",
)
TOOL = "xsens_mti"
#: Of the pushes, N and s: by hand, and up to a hand that leans or a tool that presses.
PUSHES = {"hand": ((5.0, 40.0), (0.3, 2.0)), "leaning": ((5.0, 60.0), (0.3, 6.0))}
#: A row counts as pushed from here on, N.
PUSHED = 3.0
NINETY = 1.6449
KEYS = ("force_n", "push_s", "lasting_force_n", "lasting_s")
#: Moments of a lasting push, Nm, where there is one.
LASTING_MOMENT = 0.5


class Case(NamedTuple):
    recording: Recording
    nominal: NominalModel
    wrench: np.ndarray


def pushes(time: np.ndarray, kind: str, rng: np.random.Generator) -> np.ndarray:
    """(n, 6) pushes one after the other, 1.5 to 4 s apart, held between a rise and a fall, with some 0.05 Nm."""
    sizes, lengths = PUSHES[kind]
    wrench = np.zeros((len(time), 6))
    at = time[0] + 1.0
    while at < time[-1] - 1.0:
        lasts, size, direction = np.exp(rng.uniform(*np.log(lengths))), rng.uniform(*sizes), rng.normal(size=3)
        axes = np.concatenate([size * direction / np.linalg.norm(direction), 0.05 * rng.normal(size=3)])
        edge = min(rng.uniform(0.1, 0.5), lasts / 2.0)
        inside = np.clip(np.minimum(time - at, at + lasts - time) / edge, 0.0, 1.0)
        wrench += (np.sin(0.5 * np.pi * inside) ** 2)[:, None] * axes
        at += lasts + rng.uniform(1.5, 4.0)
    return wrench


def prepared(folder: Path, kind: str, seed: int) -> list[Case]:
    model = load_model("plant", TOOL)
    logs = [read(folder / f"Movement_{name}", repair=True) for name in FREE]
    rides = [terms.ride(log, model) for log in logs]
    rng = np.random.default_rng(seed)
    cases = []
    for log, ride in zip(logs, rides, strict=True):
        others = [of for of in rides if of is not ride]
        unseen = drive.with_residuals(drive.fit_drive(others), drive.FREE, others)
        nominal = replace(load_nominal(tool=TOOL), current_map=unseen)
        wrench = pushes(log.robot.time, kind, rng)
        torque = np.einsum("nij,ni->nj", kinematics.jacobian(model, log.robot["actual_q"]), wrench)
        expected, slope = ExpectedCurrent(nominal), []
        before = None
        for sample in samples_of(log):
            expected.update(sample, 0.0 if before is None else sample.time - before)
            before = sample.time
            slope.append(expected.slope.copy())
        pushed = log.robot["actual_current"] - np.array(slope) * torque
        robot = replace(log.robot, columns={**log.robot.columns, "actual_current": pushed})
        cases.append(Case(log.with_table(robot), nominal, wrench))
    return cases


def judged(cases: Sequence[Case], *setting: float) -> list[str]:
    errors, pushed_errors, covered, nothing = [], [], [], []
    for case in cases:
        settings = case.nominal.settings
        spec = msgspec.structs.replace(
            settings.friction_kalman,
            lasting_moment_nm=LASTING_MOMENT if setting[2] else 0.0,
            **dict(zip(KEYS, setting, strict=True)),
        )
        nominal = replace(case.nominal, settings=msgspec.structs.replace(settings, friction_kalman=spec))
        found = estimate(FrictionKalman(nominal), samples_of(case.recording))
        error = np.abs(found.wrench - case.wrench)
        rows = np.abs(case.wrench[:, :3]).max(axis=1) > PUSHED
        deviation = np.sqrt(np.einsum("nii->ni", found.covariance))
        errors.append(error.mean(axis=0))
        pushed_errors.append(error[rows].mean(axis=0))
        covered.append((error < NINETY * deviation).mean(axis=0))
        nothing.append(np.abs(case.wrench)[rows].mean(axis=0))
    parts = [np.mean(part, axis=0) for part in (errors, pushed_errors, nothing, covered)]
    return [
        " / ".join(f"{value:g}" for value in setting),
        *(" ".join(f"{value:.2f}" for value in part[:3]) for part in parts),
        " ".join(f"{value:.2f}" for value in parts[0][3:]),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, help="a folder with one folder per movement")
    parser.add_argument("--pushes", choices=list(PUSHES), default="hand")
    parser.add_argument("--force", type=float, nargs="+", default=[8.0, 12.0, 18.0], help="of quick pushes, N")
    parser.add_argument("--push", type=float, nargs="+", default=[0.1, 0.2, 0.3], help="their length, s")
    parser.add_argument("--lasting", type=float, nargs="+", default=[0.0, 10.0, 20.0, 40.0], help="of lasting ones, N")
    parser.add_argument("--lasts", type=float, nargs="+", default=[3.0], help="how long, s")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    cases = prepared(options.logs, options.pushes, options.seed)
    rows = [judged(cases, *setting) for setting in product(options.force, options.push, options.lasting, options.lasts)]
    head = (
        "N / s / lasting N / s",
        "MAE N",
        "MAE while pushed N",
        "saying nothing N",
        "90 % intervals hold",
        "moment MAE Nm",
    )
    print(markdown(head, rows))


if __name__ == "__main__":
    main()
