"""A benchmark from suite to leaderboard: prepare, do what is not done, sum up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ur5_twin.errors import BenchmarkError
from ur5_twin.evaluation.benchmark import preparation, task
from ur5_twin.evaluation.benchmark.executor import Executor, Serial
from ur5_twin.evaluation.benchmark.keys import source_digest
from ur5_twin.evaluation.benchmark.leaderboard import leaderboard
from ur5_twin.evaluation.benchmark.store import Store
from ur5_twin.evaluation.benchmark.suite import Suite
from ur5_twin.evaluation.reporting import versions


@dataclass(frozen=True)
class Finished:
    """What a benchmark leaves.

    Attributes:
        board: the leaderboard (``leaderboard.leaderboard``).
        microseconds: median time of a sample by estimator, as measured while the tasks ran; no part of the board.
        nominal: folder of the identified drives.
    """

    board: dict[str, Any]
    microseconds: dict[str, float]
    nominal: Path


def run(
    suite: Suite,
    folder: Path,
    executor: Executor | None = None,
    *,
    resume: bool = False,
    preparing: Callable[[int], object] = lambda done: None,
    progress: Callable[[int, int], object] = lambda done, of: None,
) -> Finished:
    """Run a suite.

    Every finished task is on disk before the next one counts; what is killed goes on with ``resume``.

    Args:
        suite: what runs.
        folder: of the results, made if needed.
        executor: who does the tasks; here, one after the other, if not given.
        resume: take what is done from the folder. Results of another suite, version or model file are left alone.
        preparing: called with the steps of the preparation done, of ``preparation.STEPS``.
        progress: called with the number of tasks done, and of how many.

    Raises:
        BenchmarkError: the folder holds results and ``resume`` is not given.
    """
    store = Store(folder)
    if folder.exists() and not folder.is_dir():
        raise BenchmarkError(f"--out {folder} is a file; give a folder")
    if len(store) and not resume:
        raise BenchmarkError(
            f"{folder} holds {len(store)} finished runs: go on with them by --resume, or name another folder by --out"
        )
    nominal = preparation.prepare(folder, preparing)
    tasks = task.tasks_of(suite, nominal)
    done = store.done(item.key for item in tasks)
    progress(len(done), len(tasks))
    left = [item for item in tasks if item.key not in done]
    count = len(done)
    for item, record in (executor or Serial()).run(task.run, left):
        store.write(item.key, record)
        count += 1
        progress(count, len(tasks))
    records = {item.key: store.read(item.key) for item in tasks}
    times: dict[str, list[float]] = {}
    for record in records.values():
        for name, value in record["microseconds"].items():
            times.setdefault(name, []).append(value)
    board = leaderboard(((key, record["result"]) for key, record in records.items()), _about(suite))
    return Finished(board, {name: float(np.median(values)) for name, values in times.items()}, nominal)


def _about(suite: Suite) -> dict[str, Any]:
    return {
        "name": suite.name,
        "title": suite.title,
        "scenarios": [Path(name).stem for name in suite.scenarios],
        "levels": {name: msgspec.to_builtins(level) for name, level in suite.levels.items()},
        "seeds": list(suite.seeds),
        "estimators": list(suite.estimators),
        "source": source_digest(),
        "versions": versions(),
    }
