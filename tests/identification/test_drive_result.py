"""``identify drive``: the file it writes is one that the twin takes, and says where it comes from."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.arm.drive import LinearDrive, load_joint_drives
from ur5_twin.arm.parameters import load_model
from ur5_twin.drives import terms
from ur5_twin.drives.current_map import CurrentMap, Residual, load_drive_map
from ur5_twin.errors import IdentificationError, ModelError
from ur5_twin.identification import drive, drive_plant, drive_result, results, thesis_drive
from ur5_twin.identification.drive import HeldOut, Study
from ur5_twin.recording import read
from ur5_twin.recording.table import Recording
from ur5_twin.resources import data_dir


@pytest.fixture(scope="module")
def log(lab_logs: Path) -> Recording:
    return read(lab_logs / "Movement_No9_Singularity_Free_NoDist", repair=True)


def tried(fit: CurrentMap) -> CurrentMap:
    """The map with made-up errors, each number another."""
    return replace(fit, residuals=tuple(Residual(*(0.1 * j + 0.01 * i for i in range(9))) for j in range(1, 7)))


def test_a_map_that_was_tried_on_no_log_is_not_written(log: Recording) -> None:
    ride = terms.ride(log, load_model("plant"))
    free = drive.fit_drive([ride])
    with pytest.raises(ModelError, match="how it errs"):
        drive_result.drive_result(drive_plant.fit_plant([ride]), free, free, None, [log], "x")


def test_the_files_are_ones_that_the_twin_takes(log: Recording, tmp_path: Path) -> None:
    ride = terms.ride(log, load_model("plant"))
    plant, free = drive_plant.fit_plant([ride]), tried(drive.fit_drive([ride]))
    following = tried(drive.fit_drive([ride], drive.FOLLOWING))
    command = "ur5-twin identify drive LOG"
    results.write(drive_result.drive_result(plant, free, following, None, [log], command), tmp_path)
    drives = load_joint_drives(tmp_path / drive_result.FILE)
    # Two digits in the file.
    np.testing.assert_allclose(drives.torque_constant, plant.torque_constant, atol=0.0051)
    np.testing.assert_allclose(drives.ripple.amplitude, plant.amplitude, atol=0.00051)
    assert drives.source == f"{command}, on {log.source}"
    for file, fit in ((drive_result.MAP, free), (drive_result.CHOSEN, following)):
        found = load_drive_map(tmp_path / file)
        assert isinstance(found, CurrentMap)
        assert found.shapes == fit.shapes
        np.testing.assert_allclose(found.residuals, fit.residuals, rtol=0.005)  # three digits
        # Six digits in the file.
        np.testing.assert_allclose(found.current(ride), fit.current(ride), atol=1e-4)
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert report["provenance"]["command"] == command
    assert "one log cannot check itself" in (tmp_path / "report.md").read_text(encoding="utf-8")


def test_the_thesis_method_writes_a_drive(log: Recording, tmp_path: Path) -> None:
    fit = thesis_drive.fit_two_step([log], load_model("c"))
    results.write(drive_result.two_step_result(fit, [], [log], "x"), tmp_path)
    found = load_drive_map(tmp_path / drive_result.MAP)
    assert isinstance(found, LinearDrive)
    # Four digits in the file.
    np.testing.assert_allclose(found.torque_constant, fit.drive.torque_constant, atol=5.1e-5)


def test_terms_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    text = (data_dir("models") / "current_maps.toml").read_text(encoding="utf-8")
    mine = tmp_path / "mine.toml"
    mine.write_text(text[: text.index("[lab_following]")].replace('"viscous"', '"sticky"', 1), encoding="utf-8")
    with pytest.raises(ModelError, match="joint 1's terms"):
        load_drive_map(mine)
    with pytest.raises(ModelError, match="did you mean 'lab'"):
        load_drive_map("labb")


def test_what_the_log_does_not_tell_is_null(log: Recording, tmp_path: Path) -> None:
    ride = terms.ride(log, load_model("plant"))
    free, one, none = tried(drive.fit_drive([ride])), np.ones(6), np.full(6, np.nan)
    item = [HeldOut("run", one, none, one, 2 * one, none, 2 * one)]
    study = Study(item, item, item, item, item, item, drive.FREE)
    result = drive_result.drive_result(drive_plant.fit_plant([ride]), free, free, study, [log], "x")
    text = results.write(result, tmp_path)
    tables = {table["title"]: table for table in json.loads((tmp_path / "report.json").read_text())["tables"]}
    head = "Mean absolute error of actual_current, each log by a fit on all the others: "
    assert tables[f"{head}whole log, over target_current's, without the servo"]["values"] == [[0.5] * 6]
    assert tables[f"{head}at rest, without the servo"]["values"] == [[None] * 6]
    assert "| run | 0.500 |" in text


def test_an_arm_that_stands_still_tells_nothing(lab_logs: Path) -> None:
    standing = read(lab_logs / "Movement_No10_Standstill_ForceSensor_Fx", repair=True)
    with pytest.raises(IdentificationError, match="slides for less than 1 s"):
        drive_plant.fit_plant([terms.ride(standing, load_model("plant"))])
