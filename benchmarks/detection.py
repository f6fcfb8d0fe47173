"""How soon contacts are told and how often imagined ones are: 10 N steps at the flange, and hours of free motion.

    python benchmarks/detection.py [--hours 1] [--steps 200] [--level large] [--jobs 2] [--out out/detection]

Free motion is the scenario free_motion, of another seed each time: other speeds, another arm, other noise. Steps of
10 N in all directions act on the same motion for 0.6 s each, some while the arm stands. Thresholds are swept on the
probability of contact and on the size of the force; an alarm ends at half the threshold. Seeds are none of the suites'.
Goes on with what the folder holds. Prints the tables of docs/benchmark.md as Markdown and draws trade_off.png.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from absl import logging

from ur5_twin.cli.common import quiet_engine
from ur5_twin.estimation.detection import ContactDetector, Thresholds
from ur5_twin.estimation.nominal import PERIOD
from ur5_twin.evaluation import truths
from ur5_twin.evaluation.benchmark import preparation
from ur5_twin.evaluation.benchmark.arms import generator, with_arm
from ur5_twin.evaluation.benchmark.executor import Executor, Processes, Serial
from ur5_twin.evaluation.benchmark.keys import digest, of_file, source_digest
from ur5_twin.evaluation.benchmark.store import Store
from ur5_twin.evaluation.benchmark.suite import Level, load_suite
from ur5_twin.evaluation.benchmark.variation import varied
from ur5_twin.evaluation.estimate_report import judge
from ur5_twin.evaluation.tables import markdown
from ur5_twin.scenario import Push, Scenario, load_scenario
from ur5_twin.terminal import progress
from ur5_twin.twin.scenario_run import ScenarioRun
from ur5_twin.views import paper
from ur5_twin.views.style import ESTIMATES

#: The three best of ``ur5-twin benchmark`` at level large.
BEST = ("friction_kalman", "disturbance_kalman", "recursive_least_squares")
#: Seeds that no suite has.
FIRST_SEED = 100_000
#: The step: N, s; and how far apart they begin, s. The motion takes some 53 s.
STEP, LASTS, APART, FIRST, LAST = 10.0, 0.6, (2.0, 3.5), 2.0, 46.0
#: Thresholds on the probability, and on the force in N.
PROBABILITIES = (0.01, 0.03, 0.1, 0.3, 0.5, 0.8, 0.95, 0.99, 0.999, 0.999999)
FORCES = (3.0, 5.0, 7.5, 10.0, 12.5, 15.0, 20.0, 25.0, 30.0, 40.0)
#: As ``[detection]`` of models/estimators.toml has them, s.
RISE, FALL = 0.016, 0.1


class Work(NamedTuple):
    """One run: free, or with steps."""

    key: str
    seed: int
    steps: bool
    level: Level
    estimators: tuple[str, ...]
    nominal: Path


def scenario_of(work: Work) -> Scenario:
    of = with_arm(varied(load_scenario("free_motion"), work.seed), work.level, work.seed)
    if not work.steps:
        return of
    rng, at, pushes = generator(work.seed, "steps"), FIRST, []
    while at < LAST:
        direction = rng.normal(size=3)
        peak = np.concatenate([STEP * direction / np.linalg.norm(direction), np.zeros(3)])
        pushes.append(Push("tool", np.zeros(3), False, "step", at, LASTS, 0.0, peak))
        at += float(rng.uniform(*APART))
    return replace(of, pushes=tuple(pushes))


def do(work: Work) -> dict[str, Any]:
    """Per estimator, kind of level and threshold what ``counted`` gives."""
    scenario = scenario_of(work)
    recording = ScenarioRun(scenario, seed=work.seed).finish()
    truth = truths.against_truth(recording)
    judged = judge(recording, work.estimators, preparation.nominal(work.nominal, scenario.arm.tool), truth)
    found: dict[str, Any] = {}
    for name, estimates in judged.estimates.items():
        levels = {
            "probability": (estimates.contact, PROBABILITIES),
            "force": (np.linalg.norm(estimates.wrench[:, :3], axis=1), FORCES),
        }
        found[name] = {
            kind: [counted(truth.time, level, truth.touched, Thresholds(on, on / 2.0, RISE, FALL)) for on in thresholds]
            for kind, (level, thresholds) in levels.items()
        }
    return found


def counted(time: np.ndarray, level: np.ndarray, touched: np.ndarray, thresholds: Thresholds) -> dict[str, Any]:
    """Alarms that begin while a step acts, with their delay, and those that begin while nothing does.

    An alarm that goes on from before tells nothing of a step, unlike in ``evaluation.scores``; a threshold in the noise
    would else tell all of them.
    """
    detector = ContactDetector(thresholds)
    alarm = np.zeros(len(level), dtype=bool)
    # What never gets there needs no detector: most thresholds of most hours.
    if (level >= thresholds.on).any():
        alarm[:] = [detector.update(t, x) for t, x in zip(time.tolist(), level.tolist(), strict=True)]
    begins = rises(alarm)
    starts, ends = rises(touched), rises(~touched)
    delays = []
    for start in starts:
        end = min((row for row in ends if row > start), default=len(time))
        within = begins[(begins >= start) & (begins < end)]
        if len(within):
            delays.append(float(time[within[0]] - time[start]))
    return {
        "touches": len(starts),
        "delays": delays,
        "false": int((~touched[begins]).sum()),
        "alarmed": float(alarm[~touched].mean()),
        "hours": float((~touched).sum()) * PERIOD / 3600.0,
    }


def rises(of: np.ndarray) -> np.ndarray:
    """Rows at which something begins that was not so in the row before."""
    return np.flatnonzero(of[1:] & ~of[:-1]) + 1


def sum_up(records: list[dict[str, Any]], name: str, kind: str, k: int) -> dict[str, Any]:
    parts = [record[name][kind][k] for record in records]
    delays = [delay for part in parts for delay in part["delays"]]
    touches, hours = sum(part["touches"] for part in parts), sum(part["hours"] for part in parts)
    return {
        "found": len(delays) / touches if touches else math.nan,
        "median": float(np.median(delays)) if delays else math.nan,
        "late": float(np.percentile(delays, 95)) if delays else math.nan,
        "hourly": sum(part["false"] for part in parts) / hours,
        "alarmed": sum(part["alarmed"] * part["hours"] for part in parts) / hours,
        "touches": touches,
        "hours": hours,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=1.0, help="of free motion")
    parser.add_argument("--steps", type=int, default=200, help="at least so many")
    parser.add_argument("--level", default="large", help="how far the arm deviates (models/suites.toml)")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--estimator", action="append", default=[], help="default: the three best")
    parser.add_argument("--out", type=Path, default=Path("out/detection"))
    options = parser.parse_args()
    logging.set_verbosity(logging.ERROR)
    estimators = tuple(options.estimator) or BEST
    level = load_suite("full").levels[options.level]
    store, nominal = Store(options.out), preparation.prepare(options.out)

    about = [of_file(path) for path in sorted(nominal.glob("*.toml"))]
    about += [source_digest(), of_file(Path(__file__)), options.level, *estimators]

    def work(seed: int, steps: bool) -> Work:
        return Work(digest([about, seed, steps]), seed, steps, level, estimators, nominal)

    # 53 s of free motion a run, 16 steps a run at the least.
    free = [work(FIRST_SEED + k, False) for k in range(math.ceil(options.hours * 3600 / 53))]
    pushed = [work(2 * FIRST_SEED + k, True) for k in range(math.ceil(options.steps / 13))]
    executor: Executor = Serial() if options.jobs == 1 else Processes(options.jobs, quiet_engine)
    every = [*pushed, *free]
    done = store.done(item.key for item in every)
    left = [item for item in every if item.key not in done]
    with progress("runs", len(every)) as advance:
        for count, (item, record) in enumerate(executor.run(do, left), start=len(done) + 1):
            store.write(item.key, record)
            advance(count)
    records = [[store.read(item.key) for item in items] for items in (free, pushed)]
    show(records[0], records[1], estimators, options.out)


def show(free: list[dict[str, Any]], pushed: list[dict[str, Any]], estimators: tuple[str, ...], out: Path) -> None:
    figure = paper.new_figure(12.0, 5.0, "10 N steps told, against alarms without a contact")
    panels = figure.subplots(1, 2, gridspec_kw={"left": 0.07, "right": 0.98, "bottom": 0.13, "top": 0.78})
    for kind, thresholds, style in (("probability", PROBABILITIES, "o-"), ("force", FORCES, "s--")):
        rows = []
        for name, colour in zip(estimators, ESTIMATES, strict=False):
            untouched = [sum_up(free, name, kind, k) for k in range(len(thresholds))]
            told_of = [sum_up(pushed, name, kind, k) for k in range(len(thresholds))]
            # An alarm that never came is drawn at half of one.
            hourly = [max(item["hourly"], 0.5 / item["hours"]) for item in untouched]
            for panel, key, scale in zip(panels, ("found", "median"), (1.0, 1e3), strict=True):
                values = [scale * item[key] for item in told_of]
                panel.plot(hourly, values, style, color=colour, markersize=4, linewidth=1.1, label=f"{name}, {kind}")
            for threshold, no, yes in zip(thresholds, untouched, told_of, strict=True):
                said = f"{threshold:g}" if kind == "probability" else f"{threshold:g} N"
                late = f"{1e3 * yes['median']:.0f} / {1e3 * yes['late']:.0f}" if yes["found"] else "-"
                rows.append((name, said, f"{yes['found']:.2f}", late, f"{no['hourly']:.1f}", f"{no['alarmed']:.3f}"))
        head = (
            "estimator",
            f"threshold on {kind}",
            "found",
            "delay ms, median / 95 %",
            "false alarms an hour",
            "share of time alarmed",
        )
        hours, touches = sum_up(free, estimators[0], kind, 0), sum_up(pushed, estimators[0], kind, 0)
        print(f"{touches['touches']} steps, {hours['hours']:.2f} h of free motion:\n")
        print(markdown(head, rows, words=2) + "\n")
    for panel, title in zip(panels, ("share of steps told while they last", "median delay, ms"), strict=True):
        paper.dress(panel)
        paper.name(panel, title)
        panel.set_xscale("log")
        panel.set_xlabel("alarms an hour of free motion", fontsize=9)
    panels[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.06), ncols=4, fontsize=8, frameon=False)
    print(f"drawn: {paper.save(figure, out / 'trade_off.png')}")


if __name__ == "__main__":
    main()
