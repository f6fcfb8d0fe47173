"""A live run: what is said beside the robot is what is said of the recording afterwards."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.errors import RecordingError, WireError
from ur5_twin.estimation import create, estimate, samples_of
from ur5_twin.evaluation.estimate_report import estimate_columns
from ur5_twin.live.run import Beside, run
from ur5_twin.live.session import Session
from ur5_twin.live.watch import STAMP
from ur5_twin.recording import read
from ur5_twin.recording.journal import read_journal
from ur5_twin.sources.device import Rows
from ur5_twin.twin.live import LiveTwin
from ur5_twin.twin.replay import replay

TROUBLE = {"broken": (40, 41, 333), "twice": (7, 200), "lost": (90, 91, 150, 300), "restart": 400}


def recorded(folder: Path, pieces: list[Rows], estimators=None, twin: LiveTwin | None = None) -> Session:
    session = Session("robot", estimators=estimators, twin=twin, folder=folder)
    for piece in pieces:
        session.take([piece])
    session.finish()
    return session


@pytest.mark.parametrize("name", ["friction_kalman", "momentum_observer", "direct", "controller"])
@pytest.mark.parametrize("trouble", [{}, TROUBLE], ids=["sound", "trouble"])
def test_the_live_estimate_is_the_offline_estimate(tmp_path: Path, spoken, nominal, name: str, trouble: dict) -> None:
    recorded(tmp_path, spoken(**trouble), {name: create(name, nominal)})
    log = read(tmp_path)
    offline = estimate_columns(name, estimate(create(name, nominal), samples_of(log)))
    for column, values in offline.items():
        np.testing.assert_array_equal(log.robot[column], values, column)


@pytest.mark.parametrize("trouble", [{}, TROUBLE], ids=["sound", "trouble"])
@pytest.mark.parametrize("mode", ["servo", "shadow"])
def test_the_twin_beside_the_robot_is_the_replay_of_the_recording(
    tmp_path: Path, spoken, settings, trouble: dict, mode
) -> None:
    from dataclasses import replace

    settings = replace(settings, mode=mode)
    recorded(tmp_path, spoken(**trouble), twin=LiveTwin(settings))
    log = read(tmp_path)
    again = replay(log, settings).robot
    columns = [name for name in log.robot.columns if name.startswith("sim_")]
    assert {"sim_actual_q", "sim_moment", "sim_actual_current", "sim_target_moment"} <= set(columns)
    for name in columns:
        np.testing.assert_array_equal(log.robot[name], again[name], name)


def test_what_was_wrong_is_in_the_recording_s_notes(tmp_path: Path, spoken, settings) -> None:
    session = recorded(tmp_path, spoken(**TROUBLE), twin=LiveTwin(settings))
    counts = session.watch.counts
    assert (counts.lost, counts.repeated, counts.broken, counts.jumps) == (4 + 3, 2, 3, 1)
    log = read(tmp_path)
    said = " ".join(map(str, log.notes))
    for words in ("7 ticks of the controller", "2 rows with the stamp", "3 rows with a number", "1 jumps"):
        assert words in said
    assert (np.diff(log.robot.time) > 0).all()
    assert np.diff(log.robot[STAMP][:, 0]).min() < -90.0
    assert session.status().restarts == 1


def test_a_run_that_is_killed_leaves_all_that_was_taken(tmp_path: Path, spoken, nominal) -> None:
    session = Session("robot", estimators={"direct": create("direct", nominal)}, folder=tmp_path)
    pieces = spoken(200)
    for piece in pieces:
        session.take([piece])
    # Nothing is closed: as a process leaves it that ends here.
    log = read(tmp_path)
    assert len(log.robot) == 200
    assert "est_direct_wrench" in log.robot
    session.close()


def test_an_orderly_end_leaves_one_file_with_everything(tmp_path: Path, spoken) -> None:
    recorded(tmp_path, spoken(100))
    assert [path.name for path in tmp_path.iterdir()] == ["recording.parquet"]
    assert read(tmp_path).robot.host_start is not None


def test_without_a_folder_only_the_ring_is_kept(spoken) -> None:
    session = Session("robot", seconds=0.4)
    for piece in spoken(300):
        session.take([piece])
    assert session.finish() is None
    assert session.ring is not None
    assert len(session.ring) == 50


class Fragile:
    """An estimator that fails in the middle."""

    def __init__(self, inner) -> None:
        self._inner, self._left = inner, 100

    def update(self, sample):
        self._left -= 1
        if not self._left:
            raise ZeroDivisionError("my mistake")
        return self._inner.update(sample)


def test_an_estimator_that_fails_does_not_end_the_recording(tmp_path: Path, spoken, nominal) -> None:
    estimators = {"mine": Fragile(create("direct", nominal)), "direct": create("direct", nominal)}
    session = recorded(tmp_path, spoken(300), estimators)
    robot = read(tmp_path).robot
    assert len(robot) == 300
    assert np.isnan(robot["est_mine_wrench"][-1]).all()
    assert np.isfinite(robot["est_direct_wrench"]).all()
    assert any("my mistake" in note.what for note in session.notes)


def test_a_target_that_no_arm_can_follow_does_not_end_the_run(tmp_path: Path, spoken, settings) -> None:
    pieces = spoken(300)
    for piece in pieces[20:]:
        piece.columns["target_q"][:] += 0.5
    twin = LiveTwin(settings)
    recorded(tmp_path, pieces, twin=twin)
    assert twin.failures == 1
    robot = read(tmp_path).robot
    assert np.isnan(robot["sim_actual_q"]).any(axis=1).sum() == 1
    assert len(robot) == 300


def test_rows_that_lack_a_signal_are_refused_by_name(spoken) -> None:
    piece = spoken(10)[0]
    del piece.columns["actual_current"]
    with pytest.raises(WireError, match="actual_current"):
        Session("robot").take([piece])


def test_a_run_without_rows_says_so(tmp_path: Path) -> None:
    with pytest.raises(WireError, match="no sound row"):
        Session("robot", folder=tmp_path).finish()


def test_a_journal_is_never_written_over(tmp_path: Path, spoken) -> None:
    first = Session("robot", folder=tmp_path)
    first.take(spoken(10))
    with pytest.raises(RecordingError, match="never written over"):
        Session("robot", folder=tmp_path).take(spoken(10))
    first.close()
    assert len(read_journal(tmp_path / "recording.journal").robot) == 10


class Told:
    """A source that has said all it will, and a view that remembers."""

    device = "robot"

    def __init__(self, pieces: list[Rows], stop: threading.Event) -> None:
        self._pieces, self._stop, self.seen, self.closed = list(pieces), stop, 0, []

    def start(self) -> None: ...

    def rows(self) -> list[Rows]:
        if len(self._pieces) <= 5:
            self._stop.set()
        return [self._pieces.pop(0)] if self._pieces and not self.closed else [self._pieces.pop() for _ in self._pieces]

    def news(self) -> list[str]:
        return []

    def close(self) -> None:
        self.closed.append("source")
        self._pieces = self._pieces[::-1]

    def show(self, table) -> None:
        self.seen += len(table)


def test_what_the_source_still_has_when_it_stops_is_kept(tmp_path: Path, spoken) -> None:
    stop = threading.Event()
    told = Told(spoken(140), stop)
    session = Session("robot", folder=tmp_path)
    view = Told([], stop)
    run(told, session, [view], stop=stop)
    session.finish()
    assert told.closed == ["source"]
    assert view.closed == ["source"]
    kept = len(read(tmp_path).robot)
    assert kept == view.seen
    assert kept >= 140 - 7 * 3


def test_a_view_that_hangs_holds_nobody_up(tmp_path: Path, spoken, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ur5_twin.live.run._PATIENCE", 0.1)
    stop, free = threading.Event(), threading.Event()

    class Hanging:
        def show(self, table) -> None:
            free.wait()

        def close(self) -> None: ...

    session = Session("robot", folder=tmp_path)
    run(Told(spoken(140), stop), session, [Beside(Hanging())], stop=stop)
    free.set()
    session.finish()
    assert len(read(tmp_path).robot) > 100


def test_a_view_beside_shows_all_rows_in_order(spoken) -> None:
    stop = threading.Event()
    view = Told([], stop)
    run(Told(spoken(140), stop), Session("robot"), [Beside(view)], stop=stop)
    assert view.closed == ["source"]
    assert view.seen >= 119
