"""A recording while it is made: nothing that reached the file is lost, wherever it is cut."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.errors import RecordingError
from ur5_twin.recording import read
from ur5_twin.recording.journal import JOURNAL_FILE, Journal, read_journal

ROBOT = {"actual_q": 6, "actual_qd": 6}


def rows(first: int, n: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    time = 0.008 * np.arange(first, first + n)
    values = np.sin(time[:, None] + np.arange(6) / 3)
    return time, {"actual_q": values, "actual_qd": values + 1.0 / 3.0}


def written(path: Path) -> Path:
    with Journal(path, source="monday") as journal:
        journal.begin("robot", ROBOT, 100.0)
        journal.begin("ft", {"ft_wrench": 6}, 100.25)
        for k in range(20):
            journal.append("robot", *rows(5 * k, 5))
            journal.append("ft", np.array([0.01 * k]), {"ft_wrench": np.full((1, 6), float(k))})
            if k % 7 == 6:
                journal.flush()
        journal.note("robot", "lost 3 packages")
    return path


def test_what_is_written_is_read_bit_for_bit(tmp_path: Path) -> None:
    recording = read(written(tmp_path / JOURNAL_FILE))
    time, columns = rows(0, 100)
    np.testing.assert_array_equal(recording.robot.time, time)
    for name, values in columns.items():
        np.testing.assert_array_equal(recording.robot[name], values)
    np.testing.assert_array_equal(recording.tables["ft"]["ft_wrench"][:, 0], np.arange(20.0))
    assert recording.offset("ft") == 0.25
    assert (recording.source, recording.format) == ("monday", "journal")
    assert [note.what for note in recording.notes] == ["lost 3 packages"]
    assert read(tmp_path).robot.time[-1] == time[-1]


def test_cut_anywhere_it_gives_what_was_whole(tmp_path: Path) -> None:
    raw = written(tmp_path / "whole").read_bytes()
    seen = 0
    cut = tmp_path / "cut"
    for end in range(len(raw)):
        cut.write_bytes(raw[:end])
        try:
            recording = read_journal(cut)
        except RecordingError:
            # Nothing of the robot's was whole yet.
            assert seen == 0
            continue
        assert len(recording.robot) >= seen
        seen = len(recording.robot)
        np.testing.assert_array_equal(recording.robot.time, 0.008 * np.arange(seen))
    assert seen == 100


def test_a_flipped_bit_ends_what_is_read(tmp_path: Path) -> None:
    path = written(tmp_path / "journal")
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 1
    path.write_bytes(raw)
    recording = read_journal(path)
    assert 0 < len(recording.robot) < 100
    assert "left out" in recording.notes[-1].what


_WRITER = """
import sys, time
import numpy as np
from ur5_twin.recording.journal import Journal
journal = Journal(sys.argv[1], source="killed")
journal.begin("robot", {"actual_q": 6})
k = 0
while True:
    journal.append("robot", np.array([0.002 * k]), {"actual_q": np.full((1, 6), float(k))})
    k += 1
    if k % 500 == 0:
        print(k, flush=True)
        time.sleep(0.05)
"""


def test_a_killed_writer_leaves_a_readable_file(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    writer = subprocess.Popen([sys.executable, "-c", _WRITER, str(path)], stdout=subprocess.PIPE, text=True)
    assert writer.stdout is not None
    began = time.monotonic()
    count = 0
    for line in writer.stdout:
        count = int(line)
        # While it is written it can be read.
        if time.monotonic() - began > 1.5 and len(read_journal(path).robot) > 0:
            break
    os.kill(writer.pid, signal.SIGKILL)
    writer.wait()
    recording = read_journal(path)
    values = recording.robot["actual_q"][:, 0]
    np.testing.assert_array_equal(values, np.arange(len(values)))
    # Half a second of its rows, and what it wrote after the last line.
    assert count - len(values) < 20_000


def test_misuse_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "journal")
    with pytest.raises(RecordingError, match="there is a recording already"):
        Journal(path, source="again")
    with Journal(tmp_path / "other", source="other") as journal:
        with pytest.raises(RecordingError, match="'robot' has not begun"):
            journal.append("robot", *rows(0, 1))
        journal.begin("robot", ROBOT)
        with pytest.raises(RecordingError, match="began with other columns"):
            journal.append("robot", np.zeros(1), {"actual_q": np.zeros((1, 6))})
        with pytest.raises(RecordingError, match="has begun already"):
            journal.begin("robot", ROBOT)
    with pytest.raises(RecordingError, match="no row of the robot"):
        read_journal(tmp_path / "other")
    (tmp_path / "text").write_text("hello")
    with pytest.raises(RecordingError, match="not a journal"):
        read_journal(tmp_path / "text")
