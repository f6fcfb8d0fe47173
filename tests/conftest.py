"""Fixtures that several folders of tests use."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ur5_twin import cli
from ur5_twin.recording import COLUMN_WIDTHS, Recording, Table

_REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture
def run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """The command line in an empty folder: its arguments in; exit code, stdout and stderr out."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["ur5-twin", *map(str, arguments)])
        with pytest.raises(SystemExit) as stopped:
            cli.main()
        captured = capsys.readouterr()
        assert isinstance(stopped.value.code, int)
        return stopped.value.code, captured.out, captured.err

    return call


@pytest.fixture(scope="session")
def lab_logs() -> Path:
    """The folder kufieta2014 of the lab's logs; the test is skipped where there is none."""
    root = Path(os.environ.get("UR5_TWIN_LAB_LOGS", _REPOSITORY.parent / "shared" / "lab_logs"))
    for folder in (root / "kufieta2014", root):
        if (folder / "Movement_No6_Acc_slow_Verify_Model").is_dir():
            return folder
    pytest.skip(f"no lab logs in {root}: run 'ur5-twin fetch kufieta2014' and set UR5_TWIN_LAB_LOGS to its folder")


@pytest.fixture(scope="session")
def made_recording() -> Recording:
    """A small recording of three devices, made up, with all signals of the lab's layout and their six decimals."""
    rng = np.random.default_rng(2014)

    def signal(n: int, width: int) -> np.ndarray:
        return np.round(np.cumsum(rng.normal(scale=0.01, size=(n, width)), axis=0) + rng.normal(size=width), 6)

    robot = {
        name: signal(40, width) for name, width in COLUMN_WIDTHS.items() if name.startswith(("target_", "actual_"))
    }
    imu = {name: signal(85, 3) for name in ("imu_acc", "imu_gyro", "imu_mag")}
    return Recording(
        {
            "robot": Table("robot", np.round(np.arange(40) * 0.008, 6), robot, 1386689097.8),
            "ft": Table(
                "ft", np.round(0.0013 + np.arange(66) * 0.004842, 6), {"ft_wrench": signal(66, 6)}, 1386689097.794387
            ),
            "imu": Table("imu", np.round(0.006 + np.arange(85) * 0.00375, 3), imu),
        },
        source="made",
        format="lab_csv",
    )
