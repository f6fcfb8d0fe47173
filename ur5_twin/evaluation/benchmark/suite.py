"""Suites: what a benchmark runs, from ``models/suites.toml`` or a file of the same layout."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import msgspec

from ur5_twin.arm import files
from ur5_twin.arm.files import NonNegative, Strict
from ur5_twin.errors import BenchmarkError, unknown
from ur5_twin.estimation.registry import estimator_names, factory
from ur5_twin.scenario import load_scenario

#: Where the levels and suites that ship are.
SHIPPED = "suites.toml"
_Share = Annotated[float, msgspec.Meta(ge=0, lt=1)]


class Level(Strict, frozen=True):
    """How far the simulated arm may be from the identified one; shares unless the name has a unit.

    ``coldest_s`` is the shortest motion before a run, of which the drives' warmth follows; ``inf``: always warm.
    """

    source: str
    friction: _Share
    torque_constant: _Share
    link_mass: _Share
    link_center: _Share
    ripple_phase_rad: NonNegative
    extra_mass_kg: NonNegative
    extra_mass_height_mm: NonNegative
    coldest_s: NonNegative


class SuiteSpec(Strict, frozen=True, kw_only=True):
    title: str
    scenarios: tuple[str, ...]
    levels: tuple[str, ...]
    seeds: Annotated[int, msgspec.Meta(ge=1)]
    first_seed: Annotated[int, msgspec.Meta(ge=0)] = 0
    estimators: tuple[str, ...] = ()


class SuitesFile(Strict, frozen=True, kw_only=True):
    level: dict[str, Level] = msgspec.field(default_factory=dict)
    suite: dict[str, SuiteSpec]


@dataclass(frozen=True)
class Suite:
    """What a benchmark runs.

    Attributes:
        name, title: of the suite.
        scenarios: names, or paths of files.
        levels: of the arm's deviation, by name.
        seeds: each one arm and one variation of every scenario.
        estimators: names, or ``path/to/file.py:Class``.
    """

    name: str
    title: str
    scenarios: tuple[str, ...]
    levels: dict[str, Level]
    seeds: tuple[int, ...]
    estimators: tuple[str, ...]

    def with_options(self, seeds: int | None = None, estimators: tuple[str, ...] = ()) -> Suite:
        """The suite with another number of seeds, or for other estimators.

        Raises:
            BenchmarkError: no seed; EstimationError: an estimator is unknown.
        """
        changed = self
        if seeds is not None:
            if seeds < 1:
                raise BenchmarkError(f"{seeds} seeds: at least one")
            changed = replace(changed, seeds=tuple(range(self.seeds[0], self.seeds[0] + seeds)))
        if estimators:
            changed = replace(changed, estimators=tuple(dict.fromkeys(estimators)))
        _check(changed)
        return changed


def load_suite(name: str | Path = "quick") -> Suite:
    """A suite by name, or from a ``.toml`` file that holds one.

    Scenario files that it names lie beside it.

    Raises:
        BenchmarkError: the suite or a level in it is unknown; ModelError: the file is wrong; ScenarioError,
        EstimationError: it names a scenario or an estimator that cannot be had.
    """
    shipped = files.read(files.model_path(SHIPPED), SuitesFile)
    if str(name).endswith(".toml"):
        path = Path(name)
        given = files.read(path, SuitesFile)
        if len(given.suite) != 1:
            raise BenchmarkError(f"{path.name}: one [suite.NAME] in a file of your own, not {len(given.suite)}")
        key, beside = next(iter(given.suite)), path.parent
    elif str(name) in shipped.suite:
        given, key, beside = shipped, str(name), Path()
    else:
        raise BenchmarkError(unknown("suite", str(name), shipped.suite) + ", or give the path of a .toml file")
    spec, known = given.suite[key], shipped.level | given.level
    for level in spec.levels:
        if level not in known:
            raise BenchmarkError(f"suite {key}: " + unknown("level", level, known))
    suite = Suite(
        key,
        spec.title,
        tuple(str(beside / item) if item.endswith(".toml") else item for item in spec.scenarios),
        {level: known[level] for level in spec.levels},
        tuple(range(spec.first_seed, spec.first_seed + spec.seeds)),
        spec.estimators or estimator_names(),
    )
    _check(suite)
    return suite


def _check(suite: Suite) -> None:
    """Names that cannot be had are known before anything runs."""
    for what, items in (("scenarios", suite.scenarios), ("levels", suite.levels), ("estimators", suite.estimators)):
        if not items:
            raise BenchmarkError(f"suite {suite.name}: no {what}")
        if len(set(items)) != len(items):
            raise BenchmarkError(f"suite {suite.name}: {what} has a name twice")
    for name in suite.scenarios:
        load_scenario(name)
    for name in suite.estimators:
        factory(name)
