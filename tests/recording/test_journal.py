"""The journal: readable wherever its writer was stopped."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ur5_twin.errors import RecordingError
from ur5_twin.recording import Note, Recording, read
from ur5_twin.recording.journal import MAGIC, Journal, read_journal


def written(path: Path, recording: Recording, rows: int = 8) -> Path:
    """A recording written a few rows of each device at a time."""
    starts = {name: table.host_start for name, table in recording.tables.items()}
    with Journal(path, source=recording.source, host_start=starts) as journal:
        for first in range(0, max(len(table) for table in recording.tables.values()), rows):
            part = slice(first, first + rows)
            for name, table in recording.tables.items():
                columns = {column: values[part] for column, values in table.columns.items()}
                journal.append(name, table.time[part], columns)
        journal.note(Note("here", "all is well"))
    return path


def test_what_was_appended_is_read_back_to_the_bit(tmp_path: Path, made_recording: Recording) -> None:
    again = read(written(tmp_path / "run.journal", made_recording))
    assert again.source == made_recording.source
    assert [note.what for note in again.notes] == ["all is well"]
    for name, table in made_recording.tables.items():
        np.testing.assert_array_equal(again.tables[name].time, table.time)
        assert again.tables[name].host_start == table.host_start
        for column, values in table.columns.items():
            np.testing.assert_array_equal(again.tables[name][column], values, column)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(share=st.floats(0.0, 1.0))
def test_cut_off_anywhere_it_gives_what_was_whole(tmp_path: Path, made_recording: Recording, share: float) -> None:
    path = tmp_path / "run.journal"
    if not path.exists():
        written(path, made_recording)
    whole = path.read_bytes()
    cut = tmp_path / "cut.journal"
    cut.write_bytes(whole[: round(share * len(whole))])
    if share < 0.2:
        # Perhaps before the first rows of the robot.
        with suppress(RecordingError):
            read_journal(cut)
        return
    found = read_journal(cut)
    for name, table in found.tables.items():
        n = len(table)
        np.testing.assert_array_equal(table.time, made_recording.tables[name].time[:n])
        assert n % 8 == 0 or n == len(made_recording.tables[name])
        for column, values in table.columns.items():
            np.testing.assert_array_equal(values, made_recording.tables[name][column][:n])


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(at=st.floats(0.0, 0.999), what=st.integers(1, 255))
def test_a_damaged_byte_ends_it_there_or_is_refused(
    tmp_path: Path, made_recording: Recording, at: float, what: int
) -> None:
    path = tmp_path / "run.journal"
    if not path.exists():
        written(path, made_recording)
    raw = bytearray(path.read_bytes())
    raw[int(at * len(raw))] ^= what
    damaged = tmp_path / "damaged.journal"
    damaged.write_bytes(raw)
    try:
        found = read_journal(damaged)
    except RecordingError:
        return
    robot = made_recording.robot
    np.testing.assert_array_equal(found.robot.time, robot.time[: len(found.robot)])


def test_columns_stay_the_same(tmp_path: Path) -> None:
    with Journal(tmp_path / "run.journal", source="x") as journal:
        journal.append("robot", np.zeros(1), {"actual_q": np.zeros((1, 6))})
        with pytest.raises(RecordingError, match="actual_qd"):
            journal.append("robot", np.ones(1), {"actual_qd": np.zeros((1, 6))})


def test_one_number_a_row_may_be_flat(tmp_path: Path) -> None:
    path = tmp_path / "run.journal"
    with Journal(path, source="x") as journal:
        journal.append("robot", np.arange(3.0), {"actual_q": np.ones((3, 6)), "robot_mode": np.arange(3)})
    np.testing.assert_array_equal(read_journal(path).robot["robot_mode"], [[0.0], [1.0], [2.0]])


def test_it_is_never_written_over_and_says_when_it_is_closed(tmp_path: Path) -> None:
    path = tmp_path / "run.journal"
    journal = Journal(path, source="x")
    with pytest.raises(RecordingError, match="never written over"):
        Journal(path, source="x")
    journal.close()
    with pytest.raises(RecordingError, match="closed"):
        journal.append("robot", np.zeros(1), {"actual_q": np.zeros((1, 6))})


def test_a_journal_without_rows_is_refused(tmp_path: Path) -> None:
    Journal(tmp_path / "run.journal", source="x").close()
    with pytest.raises(RecordingError, match="before the first row"):
        read(tmp_path / "run.journal")
    (tmp_path / "other").write_bytes(MAGIC[:-1] + b"x" * 50)
    with pytest.raises(RecordingError, match="no journal"):
        read_journal(tmp_path / "other")
