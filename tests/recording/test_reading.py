"""Which format a path is in, and what is said of a path in none."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from ur5_twin.errors import RecordingError
from ur5_twin.recording import Recording, read, write_lab_csv, write_parquet


@pytest.fixture
def movement(made_recording: Recording, tmp_path: Path) -> Path:
    return write_lab_csv(made_recording, tmp_path / "logs" / "Movement_No1")


def test_the_movement_or_its_csv_files(movement: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert read(movement).source == "Movement_No1"
    assert read(str(movement / "csv_files")).source == "Movement_No1"
    monkeypatch.chdir(movement / "csv_files")
    assert read(".").source == "Movement_No1"


def test_a_log_in_a_replays_folder_is_still_the_log(movement: Path, made_recording: Recording) -> None:
    write_parquet(made_recording, movement / "recording.parquet")
    assert read(movement).source == "Movement_No1"


@pytest.mark.parametrize("name", ["log_q_actual.csv", "log_force_sensor.csv", "start_time.csv", "renamed.csv"])
def test_one_file_of_a_lab_folder(movement: Path, name: str) -> None:
    if name == "renamed.csv":
        (movement / "csv_files" / "log_q_actual.csv").rename(movement / name)
        path = movement / name
    else:
        path = movement / "csv_files" / name
    with pytest.raises(
        RecordingError, match=rf"{name}: rows of numbers without a header.*give the folder that holds them"
    ):
        read(path)


def test_no_such_path(tmp_path: Path) -> None:
    with pytest.raises(
        RecordingError, match="nothing: no such file or folder; give a folder of the lab's CSV files, a CSV"
    ):
        read(tmp_path / "nothing")


def test_folder_of_movements(movement: Path) -> None:
    with pytest.raises(RecordingError, match="a folder of 1 movements, not one; give one of them, 'Movement_No1'"):
        read(movement.parent)


@pytest.mark.parametrize(
    ("files", "what"),
    [
        ([], "no CSV and no Parquet file in this folder"),
        (["report.md"], "no CSV and no Parquet file in this folder"),
        (["robot_data.csv"], "if 'robot_data.csv' is the log, give that file"),
        (
            ["csv_files/other.csv"],
            r"no file of the lab's layout \(log_q_actual.csv, ...\) in this folder, only other.csv",
        ),
    ],
)
def test_folder_without_a_log(tmp_path: Path, files: list[str], what: str) -> None:
    for file in files:
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_text("x")
    with pytest.raises(RecordingError, match=what):
        read(tmp_path)


@pytest.mark.parametrize("repair", [False, True])
@pytest.mark.parametrize("content", [b"\x00\x01\x02\x03" * 50, b"\x89PNG\r\n\x1a\n" + bytes(60)])
def test_binary_file(tmp_path: Path, content: bytes, repair: bool) -> None:
    (tmp_path / "log.csv").write_bytes(content)
    with pytest.raises(RecordingError, match=r"log\.csv: not a log but binary data"):
        read(tmp_path / "log.csv", repair=repair)


@pytest.mark.parametrize("content", ["", "hello", "a,b,c\n1,2,3\n", "{}"])
def test_another_text_file(tmp_path: Path, content: str) -> None:
    (tmp_path / "log.csv").write_text(content)
    with pytest.raises(RecordingError, match=r"log\.csv(, row 1)?: (the file is empty|no column 'timestamp')"):
        read(tmp_path / "log.csv")


def test_importing_the_package_is_cheap() -> None:
    code = "import sys, ur5_twin.recording; print({'polars', 'scipy', 'mujoco', 'matplotlib'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
