"""A recording while it is made: what its writer appended can be read, wherever the file ends."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ur5_twin.errors import RecordingError
from ur5_twin.recording import Note, Recording, read
from ur5_twin.recording.journal import MAGIC, MARK, Journal, read_journal
from ur5_twin.recording.reading import JOURNAL_FILE

ROWS = 9


def rows(first: int, n: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Rows of a robot, each its own."""
    time = 0.008 * np.arange(first, first + n)
    values = np.sin(time[:, None] + np.arange(6.0) / 3.0)
    return time, {"actual_q": values, "actual_qd": values + 1.0 / 3.0}


def write(path: Path) -> Path:
    """A journal of two devices, a few rows at a time, with notes between."""
    with Journal(path, source="monday", host_start={"robot": 100.0}) as journal:
        for k in range(ROWS // 3):
            journal.append("robot", *rows(3 * k, 3))
            journal.append("ft", np.array([0.01 * k]), {"ft_wrench": np.full((1, 6), float(k))}, host_start=100.25)
            if k == 1:
                journal.note(Note("robot", "connection lost for 0.3 s"))
    return path


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write(tmp_path_factory.mktemp("written") / "journal").read_bytes()


def assert_first_rows(recording: Recording) -> None:
    """Its rows are the first that were appended, to the bit."""
    time, columns = rows(0, len(recording.robot))
    np.testing.assert_array_equal(recording.robot.time, time)
    for name, values in columns.items():
        np.testing.assert_array_equal(recording.robot[name], values)
    if "ft" in recording.tables:
        ft = recording.tables["ft"]
        np.testing.assert_array_equal(ft["ft_wrench"], np.repeat(np.arange(len(ft), dtype=float)[:, None], 6, axis=1))


def test_what_is_appended_is_read_bit_for_bit(tmp_path: Path) -> None:
    recording = read(write(tmp_path / JOURNAL_FILE))
    assert len(recording.robot) == ROWS
    assert_first_rows(recording)
    assert recording.offset("ft") == 0.25
    assert (recording.source, recording.format) == ("monday", "journal")
    assert recording.notes == (Note("robot", "connection lost for 0.3 s"),)


def test_a_folder_that_holds_one_is_read(tmp_path: Path) -> None:
    write(tmp_path / JOURNAL_FILE)
    assert len(read(tmp_path).robot) == ROWS


def test_the_last_host_start_counts(tmp_path: Path) -> None:
    with Journal(tmp_path / "journal", source="x") as journal:
        journal.append("robot", *rows(0, 1))
        journal.append("ft", np.zeros(1), {"ft_wrench": np.zeros((1, 6))}, host_start=7.0)
        assert read_journal(journal.path).offset("ft") is None
        journal.set_host_start("robot", 3.0)
        assert read_journal(journal.path).offset("ft") == 4.0
        journal.set_host_start("robot", 2.5)
    assert read_journal(journal.path).offset("ft") == 4.5


def test_cut_at_every_byte_it_gives_what_was_whole(written: bytes, tmp_path: Path) -> None:
    path, seen = tmp_path / "cut", 0
    for end in range(len(written) + 1):
        path.write_bytes(written[:end])
        try:
            recording = read_journal(path)
        except RecordingError:
            assert seen == 0, f"what could be read up to byte {end - 1} can no longer"
            continue
        assert len(recording.robot) >= seen
        seen = len(recording.robot)
        assert_first_rows(recording)
        whole = end in ends(written)
        assert any("cut off" in note.what for note in recording.notes) is not whole
    assert seen == ROWS


def ends(raw: bytes) -> set[int]:
    """Where blocks end."""
    found, at = {len(MAGIC)}, len(MAGIC)
    while at < len(raw):
        at += len(MARK) + 8 + int.from_bytes(raw[at + len(MARK) : at + len(MARK) + 4], "little")
        found.add(at)
    return found


@settings(deadline=None, max_examples=60)
@given(place=st.integers(min_value=0), bit=st.integers(0, 7))
def test_a_flipped_bit_never_gives_wrong_rows(
    place: int, bit: int, written: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    raw = bytearray(written)
    raw[place % len(raw)] ^= 1 << bit
    path = tmp_path_factory.mktemp("flipped") / "journal"
    path.write_bytes(raw)
    last = max(end for end in ends(written) if end < len(written))
    if place % len(raw) < last:
        with pytest.raises(RecordingError, match=r"damaged|no journal"):
            read_journal(path)
    # The magic, the header or the robot's columns: without those it is no journal.
    robot = written.index(MARK, written.index(b'"actual_q"'))
    if place % len(raw) < robot:
        try:
            assert "robot" not in read_journal(path, repair=True).tables
        except RecordingError as error:
            assert re.search("no journal|before the first row", str(error))  # noqa: PT017
        return
    recording = read_journal(path, repair=True)
    found = recording.robot.time
    np.testing.assert_array_equal(found, np.intersect1d(found, rows(0, ROWS)[0]))
    assert len(found) >= ROWS - 3
    assert any(note.repaired for note in recording.notes)


@settings(deadline=None, max_examples=30)
@given(tail=st.binary(max_size=200))
def test_rubbish_behind_it_is_left_out(tail: bytes, written: bytes, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("tail") / "journal"
    path.write_bytes(written + tail)
    recording = read_journal(path)
    assert len(recording.robot) == ROWS
    assert len(recording.notes) == (2 if tail else 1)


_WRITER = """
import sys
import numpy as np
from ur5_twin.recording.journal import Journal
journal = Journal(sys.argv[1], source="killed")
k = 0
while True:
    journal.append("robot", np.arange(k, k + 5.0), {"actual_q": np.repeat(np.arange(k, k + 5.0), 6).reshape(5, 6)})
    k += 5
    print(k, flush=True)
"""


def test_a_killed_writer_loses_nothing_that_it_had_appended(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    writer = subprocess.Popen([sys.executable, "-c", _WRITER, str(path)], stdout=subprocess.PIPE, text=True)
    assert writer.stdout is not None
    for line in writer.stdout:
        # While it is written it can be read.
        if int(line) % 100 == 0:
            assert len(read_journal(path).robot) >= int(line)
        if int(line) >= 1000:
            break
    os.kill(writer.pid, signal.SIGKILL)
    said = [int(line) for line in writer.stdout if line.endswith("\n")]
    writer.wait()
    writer.stdout.close()
    values = read_journal(path).robot["actual_q"][:, 0]
    np.testing.assert_array_equal(values, np.arange(len(values)))
    assert len(values) >= max(said, default=1000)


def test_misuse_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "journal")
    with pytest.raises(RecordingError, match="exists already; a journal is never written over"):
        Journal(path, source="again")
    with Journal(tmp_path / "other", source="other") as journal:
        journal.append("robot", *rows(0, 0))
        journal.append("robot", *rows(0, 1))
        with pytest.raises(RecordingError, match=r"actual_q \(6\), actual_qd \(6\) before, now actual_q \(6\);"):
            journal.append("robot", np.zeros(1), {"actual_q": np.zeros((1, 6))})
        with pytest.raises(RecordingError, match="1 stamps of 'robot' but 2 rows of 'actual_q'"):
            journal.append("robot", np.zeros(1), {"actual_q": np.zeros((2, 6)), "actual_qd": np.zeros((1, 6))})
    journal.close()
    with pytest.raises(RecordingError, match="the journal is closed"):
        journal.append("robot", *rows(1, 1))
    assert len(read_journal(journal.path).robot) == 1


def test_one_number_a_row_may_be_flat(tmp_path: Path) -> None:
    with Journal(tmp_path / "journal", source="x") as journal:
        journal.append("robot", np.arange(3.0), {"robot_mode": np.full(3, 7.0), "nothing": np.empty((3, 0))})
    recording = read_journal(journal.path)
    np.testing.assert_array_equal(recording.robot["robot_mode"], np.full((3, 1), 7.0))
    assert recording.robot["nothing"].shape == (3, 0)


def test_what_is_none_is_said(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("hello")
    with pytest.raises(RecordingError, match="no journal of ours"):
        read_journal(tmp_path / "text")
    with Journal(tmp_path / "sensor", source="x") as journal:
        journal.append("ft", np.zeros(1), {"ft_wrench": np.zeros((1, 6))})
    assert list(read(tmp_path / "sensor").tables) == ["ft"]
    with pytest.raises(RecordingError, match=r"x: no robot table \(found: ft\)"):
        _ = read(tmp_path / "sensor").robot
    Journal(tmp_path / "empty", source="x").close()
    with pytest.raises(RecordingError, match="ends before the first row of any device"):
        read(tmp_path / "empty")
    with pytest.raises(RecordingError, match=r"nothing: cannot be read"):
        read_journal(tmp_path / "nothing")


def test_rows_are_checked_as_in_every_log(tmp_path: Path) -> None:
    with Journal(tmp_path / "journal", source="x") as journal:
        journal.append("robot", *rows(5, 3))
        journal.append("robot", *rows(2, 3))
    assert len(read_journal(journal.path).robot) == 6
    with pytest.raises(RecordingError, match="time runs backwards"):
        read(journal.path)
    assert len(read(journal.path, repair=True).robot) == 3
