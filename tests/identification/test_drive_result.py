"""``identify drive``: the file it writes is one that the twin takes, and says where it comes from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.arm.drive import load_joint_drives
from ur5_twin.arm.parameters import load_model
from ur5_twin.errors import IdentificationError
from ur5_twin.identification import drive_plant, drive_result, drive_terms, results
from ur5_twin.identification.drive import HeldOut
from ur5_twin.recording import read
from ur5_twin.recording.table import Recording


@pytest.fixture(scope="module")
def log(lab_logs: Path) -> Recording:
    return read(lab_logs / "Movement_No9_Singularity_Free_NoDist", repair=True)


def test_the_file_is_one_that_the_twin_takes(log: Recording, tmp_path: Path) -> None:
    plant = drive_plant.fit_plant([drive_terms.ride(log, load_model("plant"))])
    results.write(drive_result.drive_result(plant, [], [log], "ur5-twin identify drive LOG"), tmp_path)
    drives = load_joint_drives(tmp_path / drive_result.FILE)
    # Two digits in the file.
    np.testing.assert_allclose(drives.torque_constant, plant.torque_constant, atol=0.0051)
    np.testing.assert_allclose(drives.ripple.amplitude, plant.amplitude, atol=0.00051)
    assert drives.source == f"ur5-twin identify drive LOG, on {log.source}"
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert report["provenance"]["command"] == "ur5-twin identify drive LOG"
    assert "one log cannot check itself" in (tmp_path / "report.md").read_text(encoding="utf-8")


def test_what_the_log_does_not_tell_is_null(log: Recording, tmp_path: Path) -> None:
    plant = drive_plant.fit_plant([drive_terms.ride(log, load_model("plant"))])
    one, none = np.ones(6), np.full(6, np.nan)
    item = HeldOut("run", one, none, one, 2 * one, none, 2 * one)
    text = results.write(drive_result.drive_result(plant, [item], [log], "x"), tmp_path)
    tables = {table["title"]: table for table in json.loads((tmp_path / "report.json").read_text())["tables"]}
    head = "Mean absolute error of actual_current, each log by a fit on all the others, "
    assert tables[f"{head}all rows, over target_current's"]["values"] == [[0.5] * 6]
    assert tables[f"{head}at rest"]["values"] == [[None] * 6]
    assert "| run | 0.500 |" in text


def test_an_arm_that_stands_still_tells_nothing(lab_logs: Path) -> None:
    standing = read(lab_logs / "Movement_No10_Standstill_ForceSensor_Fx", repair=True)
    with pytest.raises(IdentificationError, match="slides for less than 1 s"):
        drive_plant.fit_plant([drive_terms.ride(standing, load_model("plant"))])
