"""The twin beside a running robot: the same numbers as afterwards, and no bad line ends it."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.arm.drive import drives_of
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.gains import load_gains
from ur5_twin.control.held import Holding, commanded
from ur5_twin.errors import WireError
from ur5_twin.estimation.nominal import NominalModel, load_nominal
from ur5_twin.estimation.registry import create
from ur5_twin.estimation.samples import estimate, samples_of
from ur5_twin.live.clock import Clock
from ur5_twin.live.follow import Follower
from ur5_twin.live.ring import Ring
from ur5_twin.live.session import beats
from ur5_twin.recording import Recording, read
from ur5_twin.recording.journal import JOURNAL_FILE, Journal
from ur5_twin.sources.device import Row
from ur5_twin.sources.realtime import RealtimeSource
from ur5_twin.twin.replay import ReplaySettings, replay
from ur5_twin.wire.realtime_layout import SIZES, encode

NAMES = ("friction_kalman", "momentum_observer", "controller")


@pytest.fixture(scope="module")
def nominal() -> NominalModel:
    return load_nominal("plant", "none")


@pytest.fixture(scope="module")
def settings(nominal: NominalModel) -> ReplaySettings:
    plant = load_model("plant")
    return ReplaySettings(
        model=load_model("controller"),
        plant=plant,
        gains=load_gains("servo"),
        drive=nominal.current_map,
        target_current=nominal.law,
        joints=drives_of(plant),
    )


@pytest.fixture(scope="module")
def demo() -> Recording:
    return read(Path(__file__).parents[2] / "replay" / "demo")


def rows_of(recording: Recording, n: int, first: int = 0) -> list[Row]:
    robot = recording.robot
    return [
        Row(float(robot.time[k]), 1000.0 + float(robot.time[k]), {name: v[k] for name, v in robot.columns.items()})
        for k in range(first, first + n)
    ]


def follower(
    nominal: NominalModel, settings: ReplaySettings, recording: Recording, journal: Journal | None
) -> Follower:
    columns = {name: values.shape[1] for name, values in recording.robot.columns.items()}
    return Follower(columns, settings, {name: create(name, nominal) for name in NAMES}, journal)


def test_live_says_what_replay_and_estimate_say_afterwards(
    nominal: NominalModel, settings: ReplaySettings, demo: Recording, tmp_path: Path
) -> None:
    with Journal(tmp_path / JOURNAL_FILE, source="live") as journal:
        live = follower(nominal, settings, demo, journal)
        for row in rows_of(demo, 900):
            assert live.take(row) is not None
    recorded = read(tmp_path)
    for name in NAMES:
        offline = estimate(create(name, nominal), samples_of(recorded))
        np.testing.assert_array_equal(recorded.robot[f"est_{name}_wrench"], offline.wrench)
        np.testing.assert_array_equal(recorded.robot[f"est_{name}_tau_ext"], offline.tau_ext)
        np.testing.assert_array_equal(recorded.robot[f"est_{name}_contact"][:, 0], offline.contact)
    replayed = replay(recorded, settings)
    for name in ("sim_actual_q", "sim_actual_qd", "sim_moment", "sim_actual_current"):
        np.testing.assert_array_equal(recorded.robot[name], replayed.robot[name])
    np.testing.assert_allclose(recorded.robot["sim_actual_q"], recorded.robot["actual_q"], atol=3e-3)


def test_targets_are_held_on_line_as_afterwards(lab_logs: Path) -> None:
    robot = read(lab_logs / "Movement_No4_Acc", repair=True).robot
    targets = np.stack([robot[name] for name in ("target_q", "target_qd", "target_qdd")], axis=1)
    holding = Holding()
    np.testing.assert_array_equal([holding.update(row) for row in targets], commanded(targets))


def test_a_bad_line_is_counted_noted_and_survived(
    nominal: NominalModel, settings: ReplaySettings, demo: Recording
) -> None:
    live = follower(nominal, settings, demo, None)
    rows = rows_of(demo, 400)
    broken = rows[50]._replace(columns={**rows[50].columns, "actual_q": np.full(6, np.nan)})
    # Rows 100 to 104 are lost, 50 is broken, 150 comes twice, and from 300 on the controller's clock starts anew.
    sent = [*rows[:50], broken, *rows[51:100], *rows[105:151], rows[150], *rows[151:300]]
    sent += [row._replace(time=row.time - rows[300].time + 0.5) for row in rows[300:]]
    found = [beat for row in sent if (beat := live.take(row)) is not None]
    counts = live.clock.counts
    assert (counts.not_numbers, counts.lost, counts.repeated, counts.jumps) == (1, 6, 1, 1)
    times = np.array([beat.time for beat in found])
    assert (np.diff(times) > 0).all()
    # It goes on as if nothing had happened.
    assert times[-1] == pytest.approx(rows[-1].time, abs=1e-6)
    assert np.isfinite(found[-1].estimates["friction_kalman"].wrench).all()
    assert any("started anew" in what for _, what in live.notes)
    assert live.ring.count == len(found)


def test_a_target_that_jumps_makes_the_twin_begin_again(
    nominal: NominalModel, settings: ReplaySettings, demo: Recording
) -> None:
    live = follower(nominal, settings, demo, None)
    moving = int(np.argmax(np.abs(demo.robot["target_qd"]).max(axis=1) > 0.2))
    rows = rows_of(demo, 60, moving)
    moved = [
        row._replace(columns={**row.columns, **{name: row.columns[name] + 1.0 for name in ("target_q", "actual_q")}})
        for row in rows[30:]
    ]
    found = [live.take(row) for row in [*rows[:30], *moved]]
    assert found[-1] is not None
    assert np.abs(found[-1].columns["sim_actual_q"] - moved[-1].columns["actual_q"]).max() < 5e-3
    assert any("begins again" in what for _, what in live.notes)


def test_what_a_twin_needs_must_be_published(nominal: NominalModel, settings: ReplaySettings) -> None:
    with pytest.raises(WireError, match="does not publish target_q"):
        Follower({"actual_q": 6}, settings, {})


def test_the_clock() -> None:
    clock = Clock()
    assert clock.take(50.0, 0.0) == 50.0
    assert clock.take(50.002, 0.002) == 50.002
    assert clock.period == 0.002
    assert clock.take(50.002, 0.003) is None
    assert clock.take(50.010, 0.010) == 50.010
    assert clock.counts.lost == 3
    assert clock.take(50.012, 0.030) == 50.012
    assert clock.counts.late == 1
    # A controller that was started anew after 2 s.
    time = clock.take(3.0, 2.030)
    assert time == pytest.approx(52.012)
    assert clock.said is not None
    assert "started anew" in clock.said
    assert clock.take(3.002, 2.032) == pytest.approx(52.014)
    # A clock that is set ahead.
    assert clock.take(1003.0, 2.034) == pytest.approx(52.016)
    assert clock.counts.jumps == 2


def test_a_ring_keeps_the_last() -> None:
    ring = Ring({"a": 2}, 5)
    for k in range(13):
        ring.append(float(k), {"a": np.full(2, k)})
    np.testing.assert_array_equal(ring.last(3).time, [10, 11, 12])
    np.testing.assert_array_equal(ring.last(99)["a"][:, 0], [8, 9, 10, 11, 12])


class Sender:
    """A robot's port 30003: whoever connects gets the next script of chunks; then the connection is closed."""

    def __init__(self, *scripts: list[bytes | float]) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._scripts = list(scripts)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        for script in self._scripts:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            with client:
                for chunk in script:
                    if isinstance(chunk, float):
                        time.sleep(chunk)
                    else:
                        client.sendall(chunk)
        self._listener.close()

    def close(self) -> None:
        self._listener.close()
        self._thread.join(timeout=5.0)


@pytest.fixture
def sender() -> Iterator[list[Sender]]:
    made: list[Sender] = []
    yield made
    for one in made:
        one.close()


def received(source: RealtimeSource, n: int, seconds: float = 5.0) -> list[Row]:
    rows: list[Row] = []
    until = time.monotonic() + seconds
    while len(rows) < n and time.monotonic() < until:
        rows += source.rows()
    return rows


@pytest.mark.parametrize("size", SIZES)
def test_a_stream_is_put_together_however_it_is_cut(size: int, demo: Recording, sender: list[Sender]) -> None:
    rows = rows_of(demo, 12)
    packets = [encode(size, {**row.columns, "timestamp": row.time}) for row in rows]
    stream = b"".join(packets)
    # Split as the thesis' robot does, and at odd places.
    cuts = [0, size, size + 694, 2 * size, 2 * size + 1, 5 * size - 3, 5 * size + 2, len(stream)]
    sender.append(Sender([part for a, b in pairwise(cuts) for part in (stream[a:b], 0.002)]))
    source = RealtimeSource("127.0.0.1", sender[0].port)
    source.start()
    found = received(source, 12)
    source.close()
    assert [row.time for row in found] == [row.time for row in rows]
    for name in ("actual_q", "target_qdd", "actual_current"):
        np.testing.assert_array_equal([row.columns[name] for row in found], [row.columns[name] for row in rows])


def test_what_is_no_robot_is_said(sender: list[Sender]) -> None:
    sender.append(Sender([b"HTTP/1.1 400 Bad Request\r\n\r\n", 0.5]))
    with pytest.raises(WireError, match="no real-time interface"):
        RealtimeSource("127.0.0.1", sender[0].port).start()
    sender.append(Sender([struct.pack(">I", 2**31), 0.5]))
    with pytest.raises(WireError, match="no real-time interface"):
        RealtimeSource("127.0.0.1", sender[1].port).start()
    with socket.create_server(("127.0.0.1", 0)) as free:
        nobody = free.getsockname()[1]
    with pytest.raises(WireError, match="no connection"):
        RealtimeSource("127.0.0.1", nobody).start()


def test_a_lost_connection_is_found_again(
    nominal: NominalModel, settings: ReplaySettings, demo: Recording, sender: list[Sender]
) -> None:
    rows = rows_of(demo, 60)
    packets = [encode(1116, {**row.columns, "timestamp": row.time}) for row in rows]
    sender.append(Sender([b"".join(packets[:30]), 0.1], [b"".join(packets[40:]), 0.3]))
    source = RealtimeSource("127.0.0.1", sender[0].port)
    source.start()
    live = Follower(source.columns, settings, {"friction_kalman": create("friction_kalman", nominal)})
    stopped, found, began = threading.Event(), [], time.monotonic()
    for some in beats(source, live, stopped):
        found += some
        if len(found) == 50 or time.monotonic() - began > 20.0:
            stopped.set()
    source.close()
    assert len(found) == 50
    assert live.clock.counts.reconnects >= 1
    assert live.clock.counts.lost == 10
    assert any("connection is lost" in what for _, what in live.notes)
