"""Estimators on one recording: their estimates, and what a report says of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ur5_twin.estimation.detection import Thresholds
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.protocol import Sample
from ur5_twin.estimation.registry import NOT_CAUSAL, create, whole_log
from ur5_twin.estimation.samples import Estimates, estimate, samples_of, stacked
from ur5_twin.evaluation.reporting import closing, short_number, versions
from ur5_twin.evaluation.scores import Truth, regimes_of, score
from ur5_twin.evaluation.tables import markdown
from ur5_twin.recording.table import Recording
from ur5_twin.spatial import WRENCH_AXES


@dataclass(frozen=True)
class Judged:
    """Estimators and what they are compared with.

    Attributes:
        recording: what they ran on.
        nominal: what they were made from.
        estimates: by name, row for row with the robot's table.
        microseconds: by name, mean time of a sample here and now.
        truth: row for row; None if there is nothing to compare with.
        at_tool: see ``scores.regimes_of``.
    """

    recording: Recording
    nominal: NominalModel
    estimates: dict[str, Estimates]
    microseconds: dict[str, float]
    truth: Truth | None
    at_tool: np.ndarray | None


def judge(
    recording: Recording,
    names: Sequence[str],
    nominal: NominalModel,
    truth: Truth | None,
    at_tool: np.ndarray | None = None,
    progress: Callable[[int], object] = lambda done: None,
) -> Judged:
    """Run estimators over a recording.

    Args:
        recording: with what a robot publishes.
        names: of estimators (``registry.factory``) or methods for whole logs (``registry.NOT_CAUSAL``).
        nominal: what each is made from.
        truth: what they are compared with.
        at_tool: see ``scores.regimes_of``.
        progress: called with the number of estimators done.

    Raises:
        EstimationError: a name is unknown or the recording lacks a signal that every estimator needs.
    """
    samples = list(samples_of(recording))
    estimates, took = {}, {}
    for done, name in enumerate(names, start=1):
        key = name.rpartition(":")[2]
        run = _runner(name, nominal)
        run(samples[:2])  # the compiler's share is no sample's
        began = time.perf_counter()
        found = run(samples)
        took[key] = 1e6 * (time.perf_counter() - began) / max(len(samples), 1)
        estimates[key] = replace(found, time=recording.robot.time)
        progress(done)
    return Judged(recording, nominal, estimates, took, truth, at_tool)


def _runner(name: str, nominal: NominalModel) -> Callable[[Sequence[Sample]], Estimates]:
    if name in NOT_CAUSAL:
        method = whole_log(name)
        return lambda samples: stacked([sample.time for sample in samples], method(nominal, samples))
    return lambda samples: estimate(create(name, nominal), samples)


def with_columns(judged: Judged) -> Recording:
    """The recording with ``est_<name>_wrench``, ``_tau_ext``, ``_deviation`` and ``_contact`` in its robot table.

    ``_deviation`` is the standard deviation of the wrench's six numbers.
    """
    columns = dict(judged.recording.robot.columns)
    for name, found in judged.estimates.items():
        columns |= estimate_columns(name, found)
    return judged.recording.with_table(replace(judged.recording.robot, columns=columns))


def estimate_columns(name: str, found: Estimates) -> dict[str, np.ndarray]:
    """An estimator's answers as columns of a robot table (``with_columns``)."""
    return {
        f"est_{name}_wrench": found.wrench,
        f"est_{name}_tau_ext": found.tau_ext,
        f"est_{name}_deviation": deviation(found),
        f"est_{name}_contact": found.contact[:, None],
    }


def deviation(estimates: Estimates) -> np.ndarray:
    """(n, 6) standard deviations of the wrench, N and Nm."""
    return np.sqrt(np.maximum(np.einsum("nii->ni", estimates.covariance), 0.0))


def summarise_estimates(judged: Judged) -> dict[str, Any]:
    """The report as plain data; every number is finite, null stands where there is none.

    - ``against``: ``ft``, ``truth``, ``zero`` or null; ``rows`` of the log.
    - ``wrench.<estimator>``: what ``scores.score`` gives, if there is something to compare with, and
      ``percentile_99``: of the size of each axis of the estimate over all rows, three in N and three in Nm;
      ``estimate_mean``: its mean size; ``causal``; ``microseconds_per_sample`` on this machine.
    """
    robot, truth = judged.recording.robot, judged.truth
    thresholds = Thresholds.of(judged.nominal.settings)
    section: dict[str, Any] = {}
    for name, found in judged.estimates.items():
        scores = {}
        if truth is not None:
            regimes = regimes_of(truth, robot["target_qd"], found.sigma_min, judged.at_tool)
            scores = score(found, truth, regimes, thresholds)
        size = np.abs(found.wrench)
        section[name] = {
            **scores,
            "estimate_mean": size.mean(axis=0).tolist(),
            "percentile_99": np.percentile(size, 99, axis=0).tolist(),
            "causal": name not in NOT_CAUSAL,
            "microseconds_per_sample": judged.microseconds[name],
        }
    arm = judged.nominal.arm
    return {
        "source": judged.recording.source,
        "against": None if truth is None else truth.what,
        "rows": len(robot),
        "duration_s": float(robot.time[-1] - robot.time[0]),
        "nominal": {
            "model": arm.name,
            "tool": arm.tool.name if arm.tool else "none",
            "current_map": judged.nominal.current_map.source,
            "joints": judged.nominal.drives.source,
            "drive": judged.nominal.linear.source,
        },
        "wrench": section,
        "versions": versions(),
    }


def estimate_rows(report: dict[str, Any], key: str) -> list[tuple[str, ...]]:
    """One line an estimator of six numbers, in the order of the report."""
    return [
        (name, *(short_number(value) if value is not None else "-" for value in found[key]))
        for name, found in report["wrench"].items()
        if found.get(key) is not None
    ]


def render_estimates(report: dict[str, Any], figures: Sequence[Any]) -> str:
    """The report for people; ``figures`` are linked relative to the report's folder."""
    against = {
        "ft": "the force sensor, tared over its first 0.3 s, at the flange in base axes",
        "truth": "the twin's truth",
        "zero": "zero, as nothing touches the arm: all that is estimated is a phantom",
    }.get(report["against"])
    nominal = report["nominal"]
    lines = [
        f"# Force estimates of {report['source']}",
        "",
        f"{report['rows']:,} rows, {report['duration_s']:.1f} s. The estimators believe in model "
        f"**{nominal['model']}**, tool **{nominal['tool']}**.",
        "",
        f"Compared with {against}." if against else "There is nothing to compare with.",
    ]
    tables = (
        ("mae", "Mean absolute error, N and Nm"),
        ("max", "Largest error, N and Nm"),
        ("correlation", "Correlation"),
        ("coverage_90", "Share of rows in which the truth lies in the stated 90 % interval"),
        ("percentile_99", "99th percentile of the estimate's size, N and Nm"),
    )
    for key, title in tables:
        rows = estimate_rows(report, key)
        if rows:
            lines += ["", f"{title}:", "", markdown(("estimator", *WRENCH_AXES), rows)]
    if report["against"]:
        lines += ["", *_regimes(report), "", *_detection(report)]
    lines += ["", "Time of a sample here and now, microseconds:", ""]
    costs = [(name, f"{found['microseconds_per_sample']:.0f}") for name, found in report["wrench"].items()]
    lines.append(markdown(("estimator", "time"), costs))
    late = [name for name, found in report["wrench"].items() if not found["causal"]]
    if late:
        lines += ["", f"Not causal, each row knows what comes after it: {', '.join(late)}."]
    return "\n".join(lines + closing(report, list(figures)))


def _regimes(report: dict[str, Any]) -> list[str]:
    """Mean of the force's and of the moment's three MAEs, regime by regime."""
    names = list(next(iter(report["wrench"].values()))["regimes"])
    rows = []
    for name, found in report["wrench"].items():
        cells = []
        for regime in names:
            mae = found["regimes"][regime]["mae"]
            cells.append("-" if mae is None else f"{np.mean(mae[:3]):.2f} / {np.mean(mae[3:]):.2f}")
        rows.append((name, *cells))
    head = ("estimator", *(name.replace("_", " ") for name in names))
    return ["Mean absolute error by regime, mean over the axes, N / Nm:", "", markdown(head, rows)]


def _detection(report: dict[str, Any]) -> list[str]:
    rows = []
    for name, found in report["wrench"].items():
        item = found["detection"]
        delay = "-" if item["delay_s"] is None else " / ".join(f"{1e3 * value:.0f}" for value in item["delay_s"])
        hourly = item["false_alarms_per_hour"]
        rows.append(
            (
                name,
                f"{item['found']} of {item['touches']}",
                str(item["missed"]),
                delay,
                str(item["false_alarms"]),
                "-" if hourly is None else f"{hourly:.0f}",
            )
        )
    head = ("estimator", "found", "missed", "delay ms, median / 95 %", "false alarms", "an hour")
    return ["Contacts by the detector on the probability of contact:", "", markdown(head, rows)]
