"""One simulated arm for each seed, somewhat other than the one the estimators know."""

from __future__ import annotations

from dataclasses import replace
from zlib import crc32

import numpy as np

from ur5_twin.arm import inertia
from ur5_twin.evaluation.benchmark.suite import Level
from ur5_twin.scenario import Mismatch, Payload, Scenario, Temperature

#: How much longer than the coldest an arm may have moved before a run, s: three of the drives' time constants.
_WARM = 2700.0


def generator(seed: int, *words: str) -> np.random.Generator:
    """Random numbers of their own for a seed and a purpose."""
    return np.random.default_rng([seed, *(crc32(word.encode()) for word in words)])


def with_arm(scenario: Scenario, level: Level, seed: int) -> Scenario:
    """The scenario with a seed's arm. The same seed deviates in the same directions at every level.

    What is forgotten at the flange hangs there from the first tick on, and the controller is not told.
    """
    rng = generator(seed, "arm")
    mass, center, friction, constant, phase = (rng.uniform(-1.0, 1.0, shape) for shape in (6, (6, 3), 6, 6, 6))
    extra, warmth = rng.uniform(0.0, 1.0, 2)
    centers = np.array([link.center for link in scenario.plant_model().links])
    mismatch = Mismatch(
        link_mass_scale=1.0 + level.link_mass * mass,
        link_center_shift=level.link_center * np.linalg.norm(centers, axis=1)[:, None] * center,
        friction_scale=1.0 + level.friction * friction,
        torque_constant_scale=1.0 + level.torque_constant * constant,
        ripple_phase=level.ripple_phase_rad * phase,
    )
    forgotten = Payload(
        0.0, level.extra_mass_kg * float(extra), np.array([0.0, 0.0, level.extra_mass_height_mm * 1e-3]),
        np.zeros((3, 3)), None,
    )  # fmt: skip
    payloads = scenario.payloads
    if forgotten.mass > 0.0:
        payloads = (forgotten, *(_together(forgotten, payload) for payload in payloads))
    return replace(
        scenario,
        mismatch=mismatch,
        payloads=payloads,
        temperature=Temperature(warm_for=level.coldest_s + _WARM * float(warmth)),
    )


def _together(forgotten: Payload, carried: Payload) -> Payload:
    if carried.mass == 0.0:
        return replace(carried, mass=forgotten.mass, center=forgotten.center, inertia=forgotten.inertia)
    mass, center, tensor = inertia.combine(
        np.array([forgotten.mass, carried.mass]),
        np.array([forgotten.center, carried.center]),
        np.array([forgotten.inertia, carried.inertia]),
    )
    return replace(carried, mass=float(mass), center=center, inertia=tensor)
