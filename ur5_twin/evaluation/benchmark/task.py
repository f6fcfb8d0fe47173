"""One task: a scenario of one seed with one arm, simulated once, and every estimator on it."""

from __future__ import annotations

import inspect
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.errors import TwinError
from ur5_twin.estimation.detection import Thresholds
from ur5_twin.estimation.registry import BUILT_IN, factory
from ur5_twin.evaluation import truths
from ur5_twin.evaluation.benchmark import preparation
from ur5_twin.evaluation.benchmark.arms import generator, with_arm
from ur5_twin.evaluation.benchmark.keys import digest, of_file, source_digest
from ur5_twin.evaluation.benchmark.suite import Level, Suite
from ur5_twin.evaluation.benchmark.variation import varied
from ur5_twin.evaluation.estimate_report import judge
from ur5_twin.evaluation.scores import NEAR_SINGULARITY, Truth, regimes_of, score, summary, told
from ur5_twin.recording.table import Recording
from ur5_twin.scenario import Scenario, Sensors, load_scenario
from ur5_twin.twin.scenario_run import ScenarioRun


@dataclass(frozen=True)
class Task:
    """Independent of every other task, and small: any process that sees the nominal model's files can do it.

    Attributes:
        key: of all that shapes its result (``keys``).
        scenario: a name or the path of a file.
        level_name, level: how far the arm deviates.
        seed: of arm, variation and noise.
        estimators: names.
        nominal: folder of the identified drives.
    """

    key: str
    scenario: str
    level_name: str
    level: Level
    seed: int
    estimators: tuple[str, ...]
    nominal: Path


def tasks_of(suite: Suite, nominal: Path) -> tuple[Task, ...]:
    """All tasks of a suite, those that need an estimator's or a scenario's file keyed by its content."""
    estimators = {name: None if name in BUILT_IN else _code_of(name) for name in suite.estimators}
    drives = {path.name: of_file(path) for path in sorted(nominal.glob("*.toml"))}
    contents = {name: _content(load_scenario(name)) for name in suite.scenarios}
    numbers = {name: msgspec.to_builtins(level) | {"source": ""} for name, level in suite.levels.items()}
    made = []
    # Seed by seed, so that what is done of a suite that was stopped is a smaller suite.
    for seed, name, (level_name, level) in product(suite.seeds, suite.scenarios, suite.levels.items()):
        about = {
            "scenario": [Path(name).stem, contents[name]],
            "level": [level_name, numbers[level_name]],
            "seed": seed,
            "estimators": estimators,
            "nominal": drives,
            "source": source_digest(),
        }
        made.append(Task(digest(about), name, level_name, level, seed, suite.estimators, nominal))
    return tuple(made)


def _content(scenario: Scenario) -> list[str]:
    """Digests of a scenario's file and of the files that it names."""
    others = [getattr(item, "path", None) for item in (*scenario.motions, *scenario.pushes)]
    return [of_file(path) for path in (scenario.path, *others) if path is not None and path.is_file()]


def _code_of(name: str) -> str:
    """Digest of the code of an estimator of somebody else's: its file, or the module of an installed package."""
    path = name.rpartition(":")[0]
    if path.endswith(".py"):
        return of_file(Path(path))
    return of_file(Path(inspect.getfile(inspect.unwrap(factory(name)))))  # type: ignore[arg-type]


def simulate(task: Task) -> Recording:
    """The task's run, with the lab's sensors."""
    scenario = load_scenario(task.scenario)
    scenario = with_arm(varied(scenario, task.seed), task.level, task.seed)
    scenario = replace(scenario, sensors=Sensors("lab", scenario.sensors.late_packages))
    noise = int(generator(task.seed, "noise", scenario.name).integers(2**31))
    return ScenarioRun(scenario, seed=noise).finish()


def at_flange(truth: Truth, arm: ArmModel, q: np.ndarray, at_tool: np.ndarray) -> Truth:
    """The truth as an estimator at the flange is asked for it (``protocol.Estimate``).

    A contact beyond the tool counts as the wrench at the flange with the same joint torques, J^-T tau_ext, and as
    unknown near a singularity, where there is none.

    Args:
        truth: with the contacts' own wrenches, moved to the flange.
        arm: for its kinematics.
        q: (n, 6) rad.
        at_tool: (n,) see ``truths.at_tool``.
    """
    rows = np.flatnonzero(truth.touched & ~at_tool)
    if not len(rows):
        return truth
    J = kinematics.jacobian(arm, q[rows])
    regular = np.linalg.svd(J, compute_uv=False)[:, -1] >= NEAR_SINGULARITY
    wrench = truth.wrench.copy()
    wrench[rows] = np.nan
    transposed = np.swapaxes(J[regular], 1, 2)
    wrench[rows[regular]] = np.linalg.solve(transposed, truth.tau_ext[rows[regular]][..., None])[..., 0]
    return replace(truth, wrench=wrench)


def run(task: Task) -> dict[str, Any]:
    """Simulate, estimate, score. Plain data: ``result``, the same wherever it runs, and ``microseconds`` per sample.

    A run that cannot be simulated, or whose estimates cannot be had, has ``failure`` in its result instead of scores.
    """
    about = {"scenario": Path(task.scenario).stem, "level": task.level_name, "seed": task.seed}
    try:
        recording = simulate(task)
        nominal = preparation.nominal(task.nominal, load_scenario(task.scenario).arm.tool)
        at_tool = truths.at_tool(recording)
        truth = at_flange(truths.against_truth(recording), nominal.arm, recording.robot["truth_q"], at_tool)
        judged = judge(recording, task.estimators, nominal, truth, at_tool)
    except TwinError as error:
        return {"result": {**about, "failure": str(error)}, "microseconds": {}}
    thresholds, scores = Thresholds.of(nominal.settings), {}
    for name, found in judged.estimates.items():
        regimes = regimes_of(truth, recording.robot["target_qd"], found.sigma_min, at_tool)
        alarms = told(found.time, found.contact, truth, thresholds)
        scores[name] = {
            **score(found, truth, regimes, thresholds),
            "detection": {**summary(alarms), "delays_s": list(alarms.delays), "hours": alarms.hours},
        }
    result = {**about, "rows": len(recording.robot), "estimators": scores}
    return {"result": result, "microseconds": judged.microseconds}
