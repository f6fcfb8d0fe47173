"""Force estimates on the real logs: the thesis' tables 6.1 and 6.2, every estimator on pushed logs and on free ones.

    python benchmarks/force_tables.py LOGS

LOGS is a folder with one folder per movement. Prints the tables of docs/estimate.md as Markdown.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from lab_runs import FREE, PUSHED, THESIS_RUN

from ur5_twin import spatial
from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import load_model
from ur5_twin.drives import terms
from ur5_twin.drives.current_map import CurrentMap
from ur5_twin.estimation import create, estimate, estimator_names, load_nominal, samples_of
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.registry import whole_log
from ur5_twin.estimation.samples import Estimates, stacked
from ur5_twin.evaluation.scores import Truth
from ur5_twin.evaluation.tables import markdown
from ur5_twin.evaluation.truths import against_sensor
from ur5_twin.identification import drive
from ur5_twin.recording import read
from ur5_twin.recording.table import Recording

OURS = "friction_kalman"
HEAD = ("", "Fx N", "Fy N", "Fz N", "Mx Nm", "My Nm", "Mz Nm")
#: Tables 6.1 and 6.2 as printed: mean and largest error of F^u, F and F*.
PRINTED = {
    "F^u": ([7.8240, 16.9189, 2.9237, 2.6154, 3.4000, 1.9967], [25.0072, 48.8422, 21.1399, 8.7412, 9.9929, 5.8017]),
    "F": ([37.8064, 52.3023, 10.0739, 3.1774, 3.8464, 1.4735], [139.499, 98.0112, 35.3182, 7.1011, 11.7200, 6.3418]),
    "F*": ([6.1571, 8.6588, 5.6363, 0.9955, 1.1750, 1.2271], [32.0353, 27.7541, 28.1711, 6.2946, 5.0910, 2.1928]),
}


def cells(values: np.ndarray | Sequence[float]) -> list[str]:
    return [f"{value:.2f}" for value in values]


def thesis_tables(recording: Recording, nominals: dict[str, NominalModel]) -> None:
    """In the thesis' way: the sensor's reading as it is, untared, neither late nor shifted, turned into the base."""
    nominal = nominals["ours"]
    aligned = recording.aligned()
    R_BF = kinematics.forward(nominal.arm, aligned["actual_q"])[:, :3, :3]
    reading = spatial.rotate_wrench(R_BF, aligned["ft_wrench"])
    samples = list(samples_of(recording))
    ours = {"F^u": {"ours": -aligned["actual_TCP_force"]}}
    for name, method in (("F", "direct_zero_phase"), ("F*", "direct_friction_zero_phase")):
        ours[name] = {
            who: stacked([], whole_log(method)(believed, samples)).wrench for who, believed in nominals.items()
        }
    for k, (title, of) in enumerate(
        (("Table 6.1, mean absolute error", np.nanmean), ("Table 6.2, largest", np.nanmax))
    ):
        rows = []
        for name, variants in ours.items():
            rows.append((f"{name}, thesis", *cells(PRINTED[name][k])))
            for who, found in variants.items():
                rows.append((f"{name}, {who}", *cells(of(np.abs(found - reading), axis=0))))
        print(f"{title}:\n\n{markdown(HEAD, rows)}\n")


def pushed_tables(name: str, recording: Recording, nominal: NominalModel, maps: dict[str, CurrentMap]) -> None:
    truth = against_sensor(recording, nominal.arm)
    runs: dict[str, Callable[[], Estimates]] = {
        key: lambda key=key: estimate(create(key, nominal), samples_of(recording)) for key in estimator_names()
    }
    for label, of in maps.items():
        changed = replace(nominal, current_map=of)
        runs[f"{OURS}, {label}"] = lambda changed=changed: estimate(create(OURS, changed), samples_of(recording))
    known = np.asarray(np.isfinite(truth.wrench).all(axis=1))
    touched = known & truth.touched
    rows = [("saying nothing", *error(np.zeros_like(truth.wrench), truth, known, touched))]
    rows += [(key, *error(run().wrench, truth, known, touched)) for key, run in runs.items()]
    print(f"{name}, {touched.sum() / known.sum():.0%} of the rows touched with more than 3 N:\n")
    print(markdown((*HEAD, "force while touched N", "correlation of the force"), rows) + "\n")


def error(found: np.ndarray, truth: Truth, known: np.ndarray, touched: np.ndarray) -> list[str]:
    off = np.abs(found - truth.wrench)
    alike = "-"
    if found.any():
        pairs = [np.corrcoef(found[known, a], truth.wrench[known, a])[0, 1] for a in range(3)]
        alike = " ".join(cells(pairs))
    return [*cells(off[known].mean(axis=0)), " ".join(cells(off[touched, :3].mean(axis=0))), alike]


def phantom_tables(logs: Sequence[Recording], maps: Sequence[CurrentMap], nominal: NominalModel) -> None:
    means, tails, own = [], [], []
    for name in estimator_names():
        sizes = []
        for log, unseen in zip(logs, maps, strict=True):
            found = np.abs(estimate(create(name, replace(nominal, current_map=unseen)), samples_of(log)).wrench)
            sizes.append((found.mean(axis=0), np.percentile(found, 99, axis=0)))
            if name == OURS:
                own.append((log.source.removeprefix("Movement_"), *map(cells, sizes[-1])))
        means.append((name, *cells(np.mean([mean for mean, _ in sizes], axis=0))))
        tails.append((name, *cells(np.mean([tail for _, tail in sizes], axis=0))))
    print(f"Phantom in free motion, mean of five logs' mean size:\n\n{markdown(HEAD, means)}\n")
    print(f"Mean of their 99th percentiles:\n\n{markdown(HEAD, tails)}\n")
    print(f"{OURS}, log by log, with a current map of the other four; mean size and 99th percentile:\n")
    rows = [(log, kind, *values) for log, *both in own for kind, values in zip(("mean", "99 %"), both, strict=True)]
    print(markdown(("log", *HEAD), rows, words=2))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, help="a folder with one folder per movement")
    options = parser.parse_args()
    logs = {name: read(options.logs / f"Movement_{name}", repair=True) for name in (*FREE, *PUSHED)}
    with_sensor, with_imu = load_nominal(tool="ati_gamma"), load_nominal(tool="xsens_mti")
    rides = [terms.ride(logs[name], load_model("plant", "xsens_mti")) for name in FREE]

    def without(k: int) -> CurrentMap:
        others = [ride for i, ride in enumerate(rides) if i != k]
        return drive.with_residuals(drive.fit_drive(others), drive.FREE, others)

    maps = [without(k) for k in range(len(FREE))]
    # As there: model C, and nothing known of the sensor at the flange.
    thesis_tables(logs[THESIS_RUN], {"ours": load_nominal("c"), "plant with rotors and sensor": with_sensor})
    for name in PUSHED:
        pushed_tables(name, logs[name], with_sensor, {"drives of other paths only": maps[-1]})
    phantom_tables([logs[name] for name in FREE], maps, with_imu)


if __name__ == "__main__":
    main()
