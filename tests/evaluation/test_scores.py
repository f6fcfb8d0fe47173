"""Scores against numbers computed by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ur5_twin.arm.parameters import load_model
from ur5_twin.errors import EstimationError, RecordingError
from ur5_twin.estimation.detection import Thresholds
from ur5_twin.estimation.samples import Estimates
from ur5_twin.evaluation import truths
from ur5_twin.evaluation.scores import Truth, detection, regimes_of, score
from ur5_twin.recording import Recording, Table, read

TIME = np.arange(1000) * 0.008
AT_ONCE = Thresholds(on=0.9, off=0.5, rise=0.0, fall=0.0)


def truth(force: np.ndarray) -> Truth:
    """A force along x, N."""
    wrench = np.zeros((len(TIME), 6))
    wrench[:, 0] = force
    return Truth("truth", TIME, wrench, 0.5 * wrench, np.abs(force) > 3.0)


def estimates(wrench: np.ndarray, contact: np.ndarray | None = None) -> Estimates:
    n = len(TIME)
    level = np.zeros(n) if contact is None else contact
    return Estimates(TIME, 0.5 * wrench, wrench, np.tile(4.0 * np.eye(6), (n, 1, 1)), level, np.full(n, 0.5))


def test_errors_by_hand() -> None:
    of = truth(np.where(TIME < 4.0, 0.0, 10.0))
    wrench = of.wrench.copy()
    wrench[:, 0] += np.where(np.arange(1000) % 2 == 0, 1.0, 3.5)
    wrench[10, 1] = -7.0
    found = score(estimates(wrench), of, {"pushed": of.touched}, AT_ONCE)
    assert found["rows"] == 1000
    assert found["mae"][0] == pytest.approx(2.25)
    assert found["bias"][0] == pytest.approx(2.25)
    assert found["rmse"][0] == pytest.approx(np.sqrt((1.0 + 3.5**2) / 2))
    assert found["max"][:2] == pytest.approx([3.5, 7.0])
    # Two standard deviations of 1: 1.0 lies within 1.645 of them, 3.5 beyond 1.645 and 1.96 of two.
    assert found["coverage_90"][0] == pytest.approx(0.5)
    assert found["coverage_95"][0] == pytest.approx(1.0)
    assert found["tau_mae_nm"][0] == pytest.approx(1.125)
    assert found["correlation"][1] is None
    assert found["regimes"]["pushed"]["rows"] == 500
    assert found["regimes"]["pushed"]["max"][1] == pytest.approx(0.0)


def test_a_regime_without_rows_has_no_numbers() -> None:
    found = score(
        estimates(np.zeros((1000, 6))), truth(np.zeros(1000)), {"pushed": np.zeros(1000, dtype=bool)}, AT_ONCE
    )
    assert found["regimes"]["pushed"]["mae"] is None
    assert found["detection"]["delay_s"] is None


def test_contacts_found_missed_and_imagined() -> None:
    force, level = np.zeros(1000), np.zeros(1000)
    for first, last, size in ((100, 200, 20.0), (300, 400, 20.0), (500, 600, 5.0)):
        force[first:last] = size
    level[110:205] = 1.0  # 0.08 s late
    level[700:710] = 1.0  # nothing there
    level[710:720] = 0.7  # between both thresholds: the same alarm
    found = detection(TIME, level, truth(force), AT_ONCE)
    assert found["touches"] == 3
    assert found["found"] == 1
    assert found["missed"] == 1  # the one of 5 N is none to be missed
    assert found["delay_s"] == pytest.approx([0.08, 0.08])
    assert found["false_alarms"] == 1
    hours = (1000 - 300 - 1) * 0.008 / 3600.0
    assert found["false_alarms_per_hour"] == pytest.approx(1.0 / hours)


def test_an_alarm_that_was_on_before_finds_nothing() -> None:
    force, level = np.zeros(1000), np.zeros(1000)
    force[300:400] = force[600:700] = 20.0
    level[200:450] = 1.0  # 0.8 s before the first touch
    level[590:700] = 1.0  # 0.08 s before the second one
    found = detection(TIME, level, truth(force), AT_ONCE)
    assert (found["found"], found["missed"], found["false_alarms"]) == (1, 1, 1)
    assert found["delay_s"] == [0.0, 0.0]


def test_a_touch_interrupted_for_a_moment_is_one() -> None:
    force = np.zeros(1000)
    force[100:200] = force[210:300] = 20.0
    assert detection(TIME, np.zeros(1000), truth(force), AT_ONCE)["touches"] == 1


def test_regimes() -> None:
    qd = np.zeros((1000, 6))
    qd[200:400, 2], qd[400:600, 2] = 0.5, -0.5
    sigma = np.where(TIME < 1.0, 0.05, 0.5)
    rows = regimes_of(truth(np.zeros(1000)), qd, sigma, np.ones(1000, dtype=bool))
    assert rows["still"].sum() == 600
    assert rows["moving"].sum() == 400
    # 0.25 s to each side of the turn at row 400.
    assert rows["reversing"].sum() == 63
    assert rows["near_singularity"].sum() == 125
    assert not rows["beyond_tool"].any()


def test_what_there_is_to_compare_with(lab_logs: Path) -> None:
    pushed = read(lab_logs / "Movement_No10_Standstill_ForceSensor_Fx", repair=True)
    of = truths.against_sensor(pushed, load_model("plant", "ati_gamma"))
    # 60 N and more by hand, along y of the base.
    assert np.nanmax(np.abs(of.wrench[:, 1])) > 50.0
    assert not of.touched[:100].any()
    with pytest.raises(EstimationError, match="--tool ati_gamma"):
        truths.against_sensor(pushed, load_model("plant"))
    with pytest.raises(EstimationError, match="no truth_wrench"):
        truths.against_truth(pushed)
    bare = Recording({"robot": Table("robot", TIME, {"actual_q": np.zeros((1000, 6))})}, "bare", "test")
    with pytest.raises(RecordingError, match="no ft_wrench"):
        truths.against_sensor(bare, load_model("plant", "ati_gamma"))
    assert not truths.against_zero(bare).wrench.any()
