"""Pushes of known size put into the currents of real free motion, and what friction_kalman makes of them.

    python benchmarks/pushes_into_free_logs.py LOGS [--force N ...] [--moment NM ...] [--push S ...]
                                               [--doubt X ...] [--turned X ...] [--prior P ...]

LOGS is a folder with one folder per movement. Each of the five free logs is estimated with a current map of the other
four, so that drives, ripple and noise are real and unknown, while the pushes (any direction, seeded) are known exactly:
actual_current - slope J' w. Three kinds: up to 40 N and 2 s at the flange by hand; up to 60 N and 6 s of one who leans;
up to 60 N and 4 s at up to 0.25 m from the flange along each axis, as on the forearm. Prints error, coverage and what
saying nothing would cost with the settings of models/estimators.toml, and with each value given in place of one.
At rest these pushes do not turn the friction of joints round, as a real one does: for that there is only the twin. No
log with a force sensor takes part.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from lab_runs import FREE

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

TOOL = "xsens_mti"
#: Of the pushes, N, s, and how far from the flange along each axis, m.
PUSHES = {
    "hand": ((5.0, 40.0), (0.3, 2.0), 0.0),
    "leaning": ((5.0, 60.0), (0.3, 6.0), 0.0),
    "elsewhere": ((10.0, 60.0), (0.3, 4.0), 0.25),
}
#: A row counts as pushed from here on, N.
PUSHED = 3.0
NINETY = 1.6449
#: Settings that can be tried, and what gives them.
KEYS = {
    "force_n": "force",
    "moment_nm": "moment",
    "push_s": "push",
    "doubt": "doubt",
    "turned": "turned",
    "prior_contact": "prior",
}


class Case(NamedTuple):
    """A log with a map of the others, (n, 6, 6) J' and (n, 6) slope, and for each kind its pushes (n, 6)."""

    recording: Recording
    nominal: NominalModel
    transposed: np.ndarray
    slope: np.ndarray
    wrenches: dict[str, np.ndarray]


def pushes(time: np.ndarray, kind: str, rng: np.random.Generator) -> np.ndarray:
    """(n, 6) pushes one after the other, 1.5 to 4 s apart, held between a rise and a fall, with some 0.05 Nm."""
    sizes, lengths, lever = PUSHES[kind]
    wrench = np.zeros((len(time), 6))
    at = time[0] + 1.0
    while at < time[-1] - 1.0:
        lasts, size, direction = np.exp(rng.uniform(*np.log(lengths))), rng.uniform(*sizes), rng.normal(size=3)
        force = size * direction / np.linalg.norm(direction)
        moment = 0.05 * rng.normal(size=3) + np.cross(lever * rng.uniform(-1.0, 1.0, 3), force)
        axes = np.concatenate([force, moment])
        edge = min(rng.uniform(0.1, 0.5), lasts / 2.0)
        inside = np.clip(np.minimum(time - at, at + lasts - time) / edge, 0.0, 1.0)
        wrench += (np.sin(0.5 * np.pi * inside) ** 2)[:, None] * axes
        at += lasts + rng.uniform(1.5, 4.0)
    return wrench


def prepared(folder: Path, seed: int) -> list[Case]:
    model = load_model("plant", TOOL)
    logs = [read(folder / f"Movement_{name}", repair=True) for name in FREE]
    rides = [terms.ride(log, model) for log in logs]
    rngs = {kind: np.random.default_rng(seed) for kind in PUSHES}
    cases = []
    for log, ride in zip(logs, rides, strict=True):
        others = [of for of in rides if of is not ride]
        unseen = drive.with_residuals(drive.fit_drive(others), drive.FREE, others)
        nominal = replace(load_nominal(tool=TOOL), current_map=unseen)
        expected, slope = ExpectedCurrent(nominal), []
        before = None
        for sample in samples_of(log):
            expected.update(sample, 0.0 if before is None else sample.time - before)
            before = sample.time
            slope.append(expected.slope.copy())
        transposed = np.swapaxes(kinematics.jacobian(model, log.robot["actual_q"]), 1, 2)
        wrenches = {kind: pushes(log.robot.time, kind, rng) for kind, rng in rngs.items()}
        cases.append(Case(log, nominal, transposed, np.array(slope), wrenches))
    return cases


def judged(cases: Sequence[Case], kind: str, setting: dict[str, float]) -> list[str]:
    errors, touched, holds, nothing = [], [], [], []
    for case in cases:
        settings = case.nominal.settings
        spec = msgspec.structs.replace(settings.friction_kalman, **setting)
        nominal = replace(case.nominal, settings=msgspec.structs.replace(settings, friction_kalman=spec))
        wrench, robot = case.wrenches[kind], case.recording.robot
        current = robot["actual_current"] - case.slope * np.einsum("nij,nj->ni", case.transposed, wrench)
        pushed = case.recording.with_table(replace(robot, columns={**robot.columns, "actual_current": current}))
        found = estimate(FrictionKalman(nominal), samples_of(pushed))
        error = np.abs(found.wrench - wrench)
        rows = np.abs(wrench[:, :3]).max(axis=1) > PUSHED
        deviation = np.sqrt(np.einsum("nii->ni", found.covariance))
        errors.append(error)
        touched.append(error[rows])
        holds.append((error < NINETY * deviation)[rows])
        nothing.append(np.abs(wrench)[rows])
    every, while_pushed, silent, inside = (
        np.concatenate(part).mean(axis=0) for part in (errors, touched, nothing, holds)
    )
    return [
        kind,
        " / ".join(f"{value:g}" for value in setting.values()),
        *(" ".join(f"{value:.2f}" for value in part[:3]) for part in (every, while_pushed, silent)),
        *(" ".join(f"{value:.2f}" for value in part[3:]) for part in (every, while_pushed)),
        f"{inside[:3].min():.2f} {inside[3:].min():.2f}",
        f"{((every[:3].mean() + every[3:].mean() / 0.2) / 2):.2f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, help="a folder with one folder per movement")
    spec = load_nominal().settings.friction_kalman
    shipped = {key: getattr(spec, key) for key in KEYS}
    for key, option in KEYS.items():
        parser.add_argument(f"--{option}", type=float, nargs="+", default=[], help=key)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    cases = prepared(options.logs, options.seed)
    others = [{**shipped, key: value} for key, option in KEYS.items() for value in getattr(options, option)]
    settings = [shipped, *others]
    rows = [judged(cases, kind, setting) for kind in PUSHES for setting in settings]
    head = (
        "pushes",
        " / ".join(KEYS.values()),
        "MAE N",
        "while pushed N",
        "saying nothing N",
        "MAE Nm",
        "while pushed Nm",
        "90 % intervals hold while pushed, least force and moment",
        "error N",
    )
    print(markdown(head, rows, words=2))


if __name__ == "__main__":
    main()
