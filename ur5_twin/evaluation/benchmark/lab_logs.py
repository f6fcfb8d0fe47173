"""Whether the twin ranks estimators as the real arm does: the lab's pushed logs, and the twin on the same motions.

The twin follows a log's targets while the wrench that the log's force sensor measured acts on its flange. On the real
runs estimators believe in the drives identified from the lab's free logs, on the twin's in those identified from the
twin's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import kendalltau

from ur5_twin.errors import BenchmarkError
from ur5_twin.estimation.nominal import load_nominal
from ur5_twin.evaluation import truths
from ur5_twin.evaluation.benchmark import preparation
from ur5_twin.evaluation.benchmark.leaderboard import error
from ur5_twin.evaluation.benchmark.run import Finished
from ur5_twin.evaluation.estimate_report import judge
from ur5_twin.evaluation.metrics import mean_absolute
from ur5_twin.evaluation.scores import Truth
from ur5_twin.recording import read
from ur5_twin.recording.table import Recording
from ur5_twin.sensing import load_sensors
from ur5_twin.twin.measured_push import MeasuredPush
from ur5_twin.twin.retrace import retrace

#: The runs with pushes and a force sensor.
PUSHED = (
    "Movement_No9_Singularity_Free_ForceSensor",
    "Movement_No10_Standstill_ForceSensor_All",
    "Movement_No10_Standstill_ForceSensor_Fx",
)
_TOOL = "ati_gamma"


def read_logs(folder: Path) -> list[Recording]:
    """The pushed logs of a folder of the lab's.

    Raises:
        BenchmarkError: one is missing; RecordingError: one cannot be read.
    """
    missing = [name for name in PUSHED if not (folder / name).is_dir()]
    if missing:
        raise BenchmarkError(f"{folder} has no {missing[0]}; 'ur5-twin fetch kufieta2014' gets all of them")
    return [read(folder / name, repair=True) for name in PUSHED]


def compare(
    logs: Sequence[Recording],
    estimators: Sequence[str],
    finished: Finished,
    progress: Callable[[int], object] = lambda done: None,
) -> dict[str, Any]:
    """Errors on the real runs and on the twin's, and how well the orders agree.

    - ``real``, ``twin``: ``<log>.<estimator>``: ``leaderboard.error``, N.
    - ``ranking``: by the mean over the real logs.
    - ``kendall_tau``: of that order with the twin's on the same motions (``same motions``) and with each level's of the
      suite. Less than two estimators have none.

    Args:
        logs: of ``read_logs``.
        estimators: names.
        finished: the suite.
        progress: called with the number of logs done.
    """
    real_nominal = load_nominal(tool=_TOOL)
    twin_nominal = preparation.nominal(finished.nominal, _TOOL)
    real, twin = {}, {}
    for done, log in enumerate(logs, start=1):
        truth = truths.against_sensor(log, real_nominal.arm)
        real[log.source] = _errors(log, estimators, real_nominal, truth)
        pushed = retrace(log, load_sensors("lab"), pushes=(MeasuredPush(truth.time, truth.wrench),))
        twin[log.source] = _errors(pushed, estimators, twin_nominal, truths.against_truth(pushed))
        progress(done)
    mean = {name: float(np.mean([found[name] for found in real.values()])) for name in next(iter(real.values()))}
    on_twin = {name: float(np.mean([found[name] for found in twin.values()])) for name in mean}
    orders = {"same motions": on_twin}
    for level, found in finished.board["levels"].items():
        orders[f"level {level}"] = {
            name.rpartition(":")[2]: item["error_n"] for name, item in found["estimators"].items()
        }
    taus = {} if len(mean) < 2 else {name: tau(mean, order) for name, order in orders.items()}
    return {"real": real, "twin": twin, "ranking": sorted(mean, key=mean.__getitem__), "kendall_tau": taus}


def tau(one: dict[str, float], other: dict[str, float]) -> float:
    """Kendall's tau-b of two orders of the same estimators, 1 for the same order, -1 for the opposite one."""
    found: Any = kendalltau([one[name] for name in one], [other[name] for name in one])
    return float(found.statistic)


def _errors(recording: Recording, estimators: Sequence[str], nominal: Any, truth: Truth) -> dict[str, float]:
    found = {}
    for name, estimates in judge(recording, estimators, nominal, truth).estimates.items():
        value = error(mean_absolute(truth.wrench, estimates.wrench).tolist())
        assert value is not None
        found[name] = value
    return found
