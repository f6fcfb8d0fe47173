"""The estimators on the lab's pushes and on the twin's: mean absolute error of the wrench (docs/estimators.md).

    python benchmarks/estimators_table.py [LOGS] [--scenario push_moving] [--scenario push_x]

LOGS is the folder of kufieta2014. The lab's truth is its force sensor, tared, 75 ms late; the twin's is exact, and its
nominal model is the plant itself, so that only noise and what a real robot does not publish are in the way.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from ur5_twin.arm import kinematics
from ur5_twin.estimation import NominalModel, Sample, create, estimate, estimator_names, load_nominal, samples_of
from ur5_twin.estimation.registry import NOT_CAUSAL, whole_log
from ur5_twin.recording import force_sensor, read
from ur5_twin.scenario import load_scenario
from ur5_twin.twin.scenario_run import ScenarioRun

_LOGS = ("Movement_No9_Singularity_Free_ForceSensor", "Movement_No10_Standstill_ForceSensor_All")
#: Rows by which the lab's force sensor comes late.
_LATE = 9


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, nargs="?", help="folder of the lab's logs")
    parser.add_argument("--scenario", action="append", default=[], help="a scenario that ships")
    options = parser.parse_args()
    for name in _LOGS if options.logs else ():
        recording = read(options.logs / name, repair=True)
        nominal, aligned = load_nominal("plant", "ati_gamma"), recording.aligned()
        X_BF = kinematics.forward(nominal.arm, aligned["actual_q"])
        wrench = force_sensor.on_arm(aligned["ft_wrench"], X_BF, nominal.arm.tool, force_sensor.sensor_bias(recording))
        truth = np.concatenate([wrench[_LATE:], np.full((_LATE, 6), np.nan)])
        table(name, nominal, list(samples_of(recording)), truth)
    for name in options.scenario:
        scenario = load_scenario(name)
        recording = ScenarioRun(scenario).finish()
        nominal = load_nominal("plant", scenario.arm.tool)
        table(f"twin, {name}", nominal, list(samples_of(recording)), recording.robot["truth_wrench"])


def table(title: str, nominal: NominalModel, samples: list[Sample], truth: np.ndarray) -> None:
    known = np.isfinite(truth).all(axis=1)
    print(
        f"\n{title}\n\n| estimator | Fx N | Fy N | Fz N | Mx Nm | My Nm | Mz Nm |\n|---|---:|---:|---:|---:|---:|---:|"
    )
    row("none at all", np.abs(truth[known]).mean(axis=0))
    for name in estimator_names():
        found = estimate(create(name, nominal), samples).wrench
        row(name, np.abs(found - truth)[known].mean(axis=0))
    for name in NOT_CAUSAL:
        found = np.array([answer.wrench for answer in whole_log(name)(nominal, samples)])
        row(f"{name}, not causal", np.abs(found - truth)[known].mean(axis=0))


def row(name: str, values: np.ndarray) -> None:
    print(f"| {name} | " + " | ".join(f"{value:.2f}" for value in values) + " |")


if __name__ == "__main__":
    main()
