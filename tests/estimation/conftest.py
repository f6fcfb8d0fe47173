"""Runs of the twin that several of these tests look at, and made-up samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ur5_twin.arm.drive import NO_RIPPLE
from ur5_twin.arm.friction import FRICTIONLESS
from ur5_twin.control.program import plan
from ur5_twin.estimation import NominalModel, Sample, load_nominal
from ur5_twin.recording import Recording
from ur5_twin.scenario import Scenario, load_scenario
from ur5_twin.scenario.program import program_of
from ur5_twin.sensing import load_sensors
from ur5_twin.twin.cell import PERIOD, Cell
from ur5_twin.twin.scenario_run import ScenarioRun
from ur5_twin.twin.setup import setup_of
from ur5_twin.twin.telemetry import Telemetry


@pytest.fixture(scope="session")
def nominal() -> NominalModel:
    """The plant as it is believed, with the tool that the scenarios bear, and noise as in the lab."""
    return load_nominal("plant", "ati_gamma")


@pytest.fixture(scope="session")
def exact() -> NominalModel:
    """What is believed of ``frictionless``: exactly what it is, measured without noise."""
    nominal = load_nominal("plant", "ati_gamma", sensors="ideal")
    return replace(nominal, drives=replace(nominal.drives, friction=FRICTIONLESS, ripple=NO_RIPPLE))


@pytest.fixture(scope="session")
def frictionless() -> Recording:
    """Pushes on a moving arm without friction and ripple, seen without fault."""
    scenario = load_scenario("push_moving")
    setup = setup_of(scenario)
    setup = replace(setup, drives=replace(setup.drives, friction=FRICTIONLESS, ripple=NO_RIPPLE))
    cell = Cell(setup)
    rows = plan(setup.controller, scenario.q_start, program_of(scenario), period=PERIOD).rows
    telemetry = Telemetry(setup, cell.geoms, load_sensors("ideal"), np.random.default_rng(0))
    for piece in cell.advance(rows[1:1800]):
        telemetry.observe(piece)
    return telemetry.recording("frictionless")


@pytest.fixture(scope="session")
def run_of() -> Callable[..., Recording]:
    """Runs of the shipped scenarios with a sensors' preset, each simulated once."""
    done: dict[tuple[str, str], Recording] = {}

    def run(name: str, preset: str = "lab") -> Recording:
        key = (name, preset)
        if key not in done:
            done[key] = finish(load_scenario(name), preset)
        return done[key]

    return run


def finish(scenario: Scenario, preset: str) -> Recording:
    return ScenarioRun(replace(scenario, sensors=replace(scenario.sensors, preset=preset))).finish()


@pytest.fixture(scope="session")
def wandering(nominal: NominalModel) -> list[Sample]:
    """Four seconds of made-up signals of the right size, with steps of 6 to 12 ms: no arm moves so."""
    rng = np.random.default_rng(8)
    n = 500
    time = np.cumsum(rng.uniform(0.006, 0.012, n))
    rate = rng.uniform(0.3, 1.0, (3, 6))
    turn = time[:, None] * rate[0] * 2.0
    q = rng.uniform(-2.0, 2.0, 6) + 0.4 * np.sin(turn)
    qd, qdd = 0.8 * rate[0] * np.cos(turn), -1.6 * rate[0] ** 2 * np.sin(turn)
    current = rng.normal(size=6) + np.cumsum(0.05 * rng.normal(size=(n, 6)), axis=0)
    nothing = np.full(6, np.nan), np.full(3, np.nan), np.full(3, np.nan)
    return [
        Sample(float(time[k]), q[k], qd[k], qdd[k], current[k], 10.0 * current[k], q[k], qd[k], current[k], *nothing)
        for k in range(n)
    ]
