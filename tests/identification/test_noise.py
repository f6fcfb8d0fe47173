"""Noise measured from logs, and that of the simulated devices beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ur5_twin.errors import IdentificationError
from ur5_twin.identification.noise import measure, rows
from ur5_twin.recording import read
from ur5_twin.recording.table import Recording, Table
from ur5_twin.sensing import load_sensors
from ur5_twin.twin.retrace import retrace


def made(n: int = 3000) -> Recording:
    """Ten seconds of rest, then motion, with noise of known size and steps."""
    rng = np.random.default_rng(5)
    t = np.arange(n) * 0.008
    moving = t > 10.0
    qd = np.where(moving, 0.5 * np.sin(0.7 * (t - 10.0)), 0.0)[:, None] * np.ones(6)
    noise = np.where(moving[:, None], 0.05, 0.01) * rng.standard_normal((n, 6))
    columns = {
        "target_qd": qd,
        "actual_qd": qd,
        "actual_q": np.cumsum(qd, axis=0) * 0.008,
        "actual_current": np.round((1.0 + 2.0 * qd + noise) / 0.002) * 0.002,
    }
    return Recording({"robot": Table("robot", t, columns, 0.0)}, "made", "test")


def test_noise_of_known_size_is_found_at_rest_and_in_motion() -> None:
    noise = measure(made()).signals["actual_current"]
    # A parabola through 13 rows takes 17 % of white noise's power with it; some 1,200 rows know a deviation to 2 %.
    np.testing.assert_allclose(noise.still, 0.01 * np.sqrt(1 - 0.17), rtol=0.08)
    np.testing.assert_allclose(noise.moving, 0.05 * np.sqrt(1 - 0.17), rtol=0.08)
    np.testing.assert_allclose(noise.step, 0.002, rtol=1e-3)
    assert np.abs(noise.kurtosis).max() < 0.5


def test_clocks_are_measured() -> None:
    rng = np.random.default_rng(1)
    values = rng.standard_normal((4000, 6))
    again = np.flatnonzero(rng.random(4000) < 0.1)
    values[again[1:]] = values[again[1:] - 1]
    ft = Table("ft", np.arange(4000) / 207.76, {"ft_wrench": values * 1e-3}, 0.0)
    clock = measure(made().with_table(ft)).clocks["ft"]
    assert clock.rate == pytest.approx(207.76)
    # One in ten, less those whose predecessor changes too: 0.09 of 1,900 rows, known to 0.0066; four times that.
    assert clock.repeated == pytest.approx(0.09, abs=0.026)
    assert clock.jitter < 1e-9


def test_a_log_without_rest_cannot_tell() -> None:
    recording = made()
    robot = recording.robot.with_columns({"target_qd": np.ones((len(recording.robot), 6))})
    with pytest.raises(IdentificationError, match="rests for 0 rows"):
        measure(recording.with_table(robot))


def test_the_twin_s_devices_are_as_noisy_as_the_lab_s(lab_logs: Path) -> None:
    recording = read(lab_logs / "Movement_No9_Singularity_Free_NoDist", repair=True)
    measured, simulated = measure(recording), measure(retrace(recording, load_sensors()))
    current, twin = measured.signals["actual_current"], simulated.signals["actual_current"]
    # One log against numbers that were set on five: joint 1 holds still here at half its usual noise.
    assert np.median(twin.still / current.still) == pytest.approx(1.0, abs=0.25)
    np.testing.assert_allclose(twin.moving, current.moving, rtol=0.6)
    np.testing.assert_allclose(twin.step, current.step, rtol=0.01)
    assert {name for name, *_ in rows([measured], [simulated])} >= {"actual_q", "actual_qd", "actual_current"}


def test_the_ripple_s_peak_stands_where_the_lab_s_stands(lab_logs: Path) -> None:
    """Joint 6's current in motion: the largest peak of both spectra above 10 Hz, within two bins of 1 Hz."""
    recording = read(lab_logs / "Movement_No4_Acc", repair=True)
    noises = [measure(recording), measure(retrace(recording, load_sensors()))]
    peaks = []
    for noise in noises:
        figures = noise.signals["actual_current"]
        above = figures.frequency > 10.0
        peaks.append(figures.frequency[above][np.argmax(figures.spectrum_moving[above, 5])])
    assert abs(peaks[0] - peaks[1]) < 2.0


def test_the_same_seed_retraces_the_same(lab_logs: Path) -> None:
    recording = read(lab_logs / "Movement_No10_Standstill_ForceSensor_Fx", repair=True)
    first, again, other = (retrace(recording, load_sensors(), seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.robot["actual_current"], again.robot["actual_current"])
    np.testing.assert_array_equal(first.tables["ft"]["ft_wrench"], again.tables["ft"]["ft_wrench"])
    assert (first.robot["actual_current"] != other.robot["actual_current"]).any()
    np.testing.assert_array_equal(first.robot["truth_q"], other.robot["truth_q"])
