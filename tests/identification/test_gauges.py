"""The gauges of a force sensor, found in its own readings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ur5_twin.errors import IdentificationError
from ur5_twin.identification.gauges import fit_gauges
from ur5_twin.recording import read
from ur5_twin.recording.table import Recording, Table
from ur5_twin.sensing import load_sensors

GAUGES = load_sensors("lab").ft.gauges
FORCE_LOGS = ("No10_Standstill_ForceSensor_Fx", "No10_Standstill_ForceSensor_All", "No9_Singularity_Free_ForceSensor")


def made(wrench: np.ndarray) -> Recording:
    robot = Table("robot", np.arange(2) * 0.008, {})
    return Recording(
        {"robot": robot, "ft": Table("ft", np.arange(len(wrench)) / 207.66, {"ft_wrench": wrench})}, "m", "t"
    )


def relation(found: np.ndarray, known: np.ndarray) -> np.ndarray:
    """How the found gauges' counts make up the known ones': whole numbers if both have the same readings."""
    return np.linalg.solve(known, found)


def test_known_gauges_are_found_again() -> None:
    """Up to order and sign, from a minute of rest and pushes written with six decimals."""
    rng = np.random.default_rng(0)
    # Tilted against the axes and each other, as three beams at 120 degrees are.
    known = np.array(GAUGES) @ np.diag([1.0, 1.1, 0.9, 1.05, 0.95, 1.0])
    pushes = np.cumsum(rng.normal(size=(6000, 6)), axis=0) * (np.arange(6000) > 4000)[:, None] * 20.0
    readings = np.round(np.round(rng.normal(scale=0.5, size=(6000, 6)) + 300.0 + pushes) @ known.T, 6)
    fit = fit_gauges([made(readings)])
    mixed = relation(fit.matrix, known)
    # 6000 readings of six decimals tell a column of some 1e-3 N to 1e-8; the bound leaves room for small moments.
    np.testing.assert_allclose(mixed, np.round(mixed), atol=1e-3)
    np.testing.assert_array_equal(np.sort(np.abs(np.round(mixed)), axis=0)[-2:], [[0.0] * 6, [1.0] * 6])


def test_readings_with_steps_of_their_own_have_no_gauges() -> None:
    readings = np.random.default_rng(1).normal(size=(2000, 6))
    with pytest.raises(IdentificationError, match="no whole counts"):
        fit_gauges([made(readings)])


def test_a_log_without_a_force_sensor() -> None:
    with pytest.raises(IdentificationError, match="no whole counts"):
        fit_gauges([Recording({"robot": Table("robot", np.arange(2) * 0.008, {})}, "made", "test")])


@pytest.mark.parametrize("logs", [FORCE_LOGS, *((name,) for name in FORCE_LOGS)])
def test_the_labs_sensor_has_the_same_gauges_in_every_log(lab_logs: Path, logs: tuple[str, ...]) -> None:
    """Each log by itself gives the whole numbers' columns that models/sensors.toml holds."""
    fit = fit_gauges([read(lab_logs / f"Movement_{name}", repair=True) for name in logs])
    assert GAUGES is not None
    mixed = relation(fit.matrix, GAUGES)
    # sensors.toml has seven to nine digits: a hundredth of a count.
    np.testing.assert_allclose(mixed, np.round(mixed), atol=0.01)
    # The same sums of whole numbers: neither contains fewer than the other.
    assert abs(np.linalg.det(mixed)) == pytest.approx(1.0, abs=0.01)
    # Six decimals are a thousandth of a count; 1500 counts of bias times the columns' errors leave some thousandths.
    assert fit.off.max() < 0.02
