"""Gauges of the force sensor that wrote some logs, in the layout of models/sensors.toml.

python benchmarks/force_sensor_gauges.py LOG...
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from ur5_twin.identification.gauges import fit_gauges
from ur5_twin.recording import read


def main(paths: list[str]) -> None:
    recordings = [read(Path(path), repair=True) for path in paths]
    fit = fit_gauges(recordings)
    print("gauges = [")
    for row in fit.matrix:
        print("  [" + ", ".join(f"{value:.7g}" for value in row) + "],")
    print("]")
    print(f"{fit.readings} readings; from whole counts they are off by {fit.off.max():.4f} at most (root mean square)")
    for recording in recordings:
        values = recording.tables["ft"]["ft_wrench"]
        counts = np.round(values @ np.linalg.inv(fit.matrix).T)
        repeated = np.all(np.diff(counts, axis=0) == 0, axis=1)
        print(f"{recording.source}: {repeated.mean():.3f} of the rows repeat, first counts {counts[0].astype(int)}")


if __name__ == "__main__":
    main(sys.argv[1:])
