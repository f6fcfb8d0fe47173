"""Results of tasks summed up: errors, coverage and detection of each estimator, and their order.

Means over rows are pooled: each row of each run counts once. Nothing here depends on the order in which tasks ended.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ur5_twin.evaluation.benchmark.keys import digest

#: Lever that turns moments into forces for the order, m: 0.4 Nm of error then count as 2 N.
LEVER = 0.2
#: What is pooled over rows: as a mean, and as a root of a mean of squares.
_MEANS, _ROOTS = ("mae", "bias", "coverage_90", "coverage_95"), ("rmse",)


def leaderboard(records: Iterable[tuple[str, dict[str, Any]]], suite: dict[str, Any]) -> dict[str, Any]:
    """The leaderboard as plain data.

    - ``suite``: as given; ``key``: of all tasks in it; ``failed``: runs that could not be had, and why.
    - ``levels.<level>.ranking``: estimators by ``error_n``, the best first.
    - ``levels.<level>.estimators.<name>``: ``error_n``, see ``error``; ``mae``, ``rmse``, ``bias``, ``coverage_90``,
      ``coverage_95``: three numbers in N and three in Nm (none for coverage); ``largest``; ``regimes`` and
      ``scenarios``: the same of their rows; ``detection``: ``delay_s`` median and 95th percentile, null where nothing
      is found; ``touches``, ``found``, ``missed``, ``false_alarms``, ``false_alarms_per_hour``.

    Args:
        records: key and result of each task.
        suite: what ran, for the reader.
    """
    results = [(key, result) for key, result in sorted(records, key=lambda item: item[0])]
    kept = [result for _, result in results if "failure" not in result]
    failed = [
        {name: result[name] for name in ("scenario", "level", "seed", "failure")}
        for _, result in results
        if "failure" in result
    ]
    levels = {}
    for level in suite["levels"]:
        of_level = [result for result in kept if result["level"] == level]
        if of_level:
            levels[level] = _level(of_level)
    return {
        "suite": suite,
        "key": digest([key for key, _ in results]),
        "runs": len(kept),
        "failed": sorted(failed, key=lambda item: (item["scenario"], item["level"], item["seed"])),
        "levels": levels,
    }


def _level(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    names = list(results[0]["estimators"])
    estimators = {}
    for name in names:
        mine = [(result["scenario"], result["estimators"][name]) for result in results]
        scores = [item for _, item in mine]
        regimes = sorted({regime for item in scores for regime in item["regimes"]})
        scenarios = sorted({scenario for scenario, _ in mine})
        whole = pooled(scores)
        estimators[name] = {
            "error_n": error(whole["mae"]),
            **whole,
            "regimes": {r: pooled([item["regimes"][r] for item in scores if r in item["regimes"]]) for r in regimes},
            "scenarios": {s: pooled([item for scenario, item in mine if scenario == s]) for s in scenarios},
            "detection": _detection([item["detection"] for item in scores]),
        }
    # An estimator that says nothing finite anywhere comes last.
    order = sorted(names, key=lambda name: (estimators[name]["error_n"] is None, estimators[name]["error_n"], name))
    return {"ranking": order, "estimators": estimators}


def error(mae: Sequence[float] | None) -> float | None:
    """One number for the order, N: mean of three force errors and of three moment errors over 0.2 m."""
    if mae is None:
        return None
    return float(np.mean([*mae[:3], *(value / LEVER for value in mae[3:])]))


def pooled(scores: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Scores of several runs as if their rows were one run's; null where there are no rows."""
    scores = [item for item in scores if item["rows"]]
    rows = sum(item["rows"] for item in scores)
    if not rows:
        return {"rows": 0, **dict.fromkeys((*_MEANS, *_ROOTS, "largest"))}
    share = np.array([item["rows"] for item in scores])[:, None] / rows
    found: dict[str, Any] = {"rows": rows}
    for name in _MEANS:
        found[name] = (share * [item[name] for item in scores]).sum(axis=0).tolist()
    for name in _ROOTS:
        found[name] = np.sqrt((share * np.square([item[name] for item in scores])).sum(axis=0)).tolist()
    found["largest"] = np.max([item["max"] for item in scores], axis=0).tolist()
    return found


def _detection(found: Sequence[dict[str, Any]]) -> dict[str, Any]:
    delays = [delay for item in found for delay in item["delays_s"]]
    counts = {name: sum(item[name] for item in found) for name in ("touches", "found", "missed", "false_alarms")}
    hours = sum(item["hours"] for item in found)
    return {
        **counts,
        "delay_s": None if not delays else [float(np.median(delays)), float(np.percentile(delays, 95))],
        "hours_untouched": hours,
        "false_alarms_per_hour": counts["false_alarms"] / hours if hours > 0 else None,
    }
