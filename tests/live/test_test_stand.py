"""The test stand, with devices that are made up: what they report is in the recording, whatever happens to them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.errors import RecordingError, WireError
from ur5_twin.live.test_stand import DEVICE_STAMP, TestStand, finished, for_lab
from ur5_twin.live.watch import ARRIVAL, STAMP
from ur5_twin.recording import Recording, Table, read
from ur5_twin.recording.journal import read_journal
from ur5_twin.recording.lab_layout import ROBOT_FILES
from ur5_twin.sources.device import Rows

COLUMNS = {
    "robot": {file.column: file.width for file in ROBOT_FILES},
    "ft": {"ft_wrench": 6},
    "imu": {"imu_acc": 3, "imu_gyro": 3, "imu_mag": 3},
}
PERIODS = {"robot": 0.008, "ft": 0.005, "imu": 0.004}


class MadeUp:
    """A device that has some rows for each time it is asked, on a clock that began at ``start``."""

    def __init__(self, device: str, start: float, pieces: int = 1000, each: int = 3) -> None:
        self.device, self.connected = device, True
        self.closed = False
        self._start, self._left, self._each, self._sent = start, pieces, each, 0
        self._began = time.monotonic()
        self.said: list[str] = []

    def describe(self) -> str:
        return f"made-up {self.device}"

    def stamps(self, n: int) -> np.ndarray:
        return self._start + PERIODS[self.device] * np.arange(n)

    def rows(self) -> list[Rows]:
        if self._left <= 0 or self.closed:
            return []
        self._left -= 1
        k = self._sent + np.arange(self._each)
        self._sent += self._each
        columns = {name: k[:, None] + np.arange(float(w)) / 8.0 for name, w in COLUMNS[self.device].items()}
        return [Rows(self._start + PERIODS[self.device] * k, self._began + PERIODS[self.device] * k, columns)]

    def news(self) -> list[str]:
        said, self.said = self.said, []
        return said

    def close(self) -> None:
        self.closed = True
        self.connected = False


def stand_of(folder: Path, *devices: MadeUp) -> TestStand:
    def opener(device: MadeUp) -> Callable[[], MadeUp]:
        return lambda: device

    stand = TestStand({f"--{device.device}": opener(device) for device in devices}, folder, name="made")
    stand.connect()
    return stand


def test_all_devices_are_recorded_each_on_its_clock(tmp_path: Path) -> None:
    devices = MadeUp("robot", 100.0), MadeUp("ft", 7.0), MadeUp("imu", 0.0)
    devices[1].said = ["lost for a moment"]
    stand = stand_of(tmp_path / "out", *devices)
    told: list[str] = []
    stand.run(
        stop=threading.Event(),
        duration=0.5,
        tell=lambda status, news: told.extend([*news, *(s.device for s in status)]),
    )
    assert all(device.closed for device in devices)
    recording = stand.finish({"command": "test"})
    assert {"ft: lost for a moment", "robot", "ft", "imu"} <= set(told)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["log", "recording.parquet"]
    again = read(tmp_path / "out")
    assert again.format == "record"
    for name in ("robot", "ft", "imu"):
        table = again.tables[name]
        np.testing.assert_array_equal(table.time, recording.tables[name].time)
        # One after the other, none lost, none made up; those of before the recording are left out.
        np.testing.assert_array_equal(np.diff(table[next(iter(COLUMNS[name]))][:, 0]), 1.0)
        assert len(table) >= 9
    np.testing.assert_array_equal(again.tables["imu"][DEVICE_STAMP][:, 0], again.tables["imu"].time)
    np.testing.assert_array_equal(again.robot[STAMP][:, 0], again.robot.time)
    # All began at the same moment of the host's, within the time it takes to make them.
    assert again.offset("ft") == pytest.approx(93.0, abs=0.05)
    assert again.offset("imu") == pytest.approx(100.0, abs=0.05)
    assert "lost for a moment" in " ".join(map(str, again.notes))


def test_the_labs_layout_keeps_the_devices_together(tmp_path: Path) -> None:
    devices = MadeUp("robot", 100.0), MadeUp("ft", 7.0), MadeUp("imu", 0.0)
    stand = stand_of(tmp_path / "out", *devices)
    stand.run(stop=threading.Event(), duration=0.3)
    recording = stand.finish()
    lab = read(tmp_path / "out" / "log")
    assert lab.robot.time[0] == 0.0
    ours, theirs = recording.aligned(), lab.aligned()
    for name in ("ft_wrench", "imu_acc"):
        both = np.isfinite(ours[name]) & np.isfinite(theirs[name])
        assert both.sum() > 10
        # The layout keeps microseconds; a column grows by 1 in 4 ms.
        np.testing.assert_allclose(theirs[name][both], ours[name][both], atol=1e-3)


def test_sensors_alone(tmp_path: Path) -> None:
    stand = stand_of(tmp_path / "out", MadeUp("ft", 7.0))
    stand.run(stop=threading.Event(), duration=0.2)
    recording = stand.finish()
    assert list(read(tmp_path / "out").tables) == ["ft"]
    assert any("not written in the lab's layout: made: no robot table" in str(note) for note in recording.notes)


def test_until_it_is_stopped_all_is_in_the_journal(tmp_path: Path) -> None:
    robot = MadeUp("robot", 100.0)
    stand = stand_of(tmp_path / "out", robot)
    stop = threading.Event()
    running = threading.Thread(target=stand.run, kwargs={"stop": stop})
    running.start()
    journal = tmp_path / "out" / "recording.journal"
    end = time.monotonic() + 5.0
    while time.monotonic() < end and not (journal.exists() and journal.stat().st_size > 20_000):
        time.sleep(0.02)
    # A reader beside it, or after a kill.
    before = len(read_journal(journal).robot)
    assert before > 3
    assert len(read(tmp_path / "out").robot) >= before
    stop.set()
    running.join()
    assert len(read_journal(journal).robot) >= before
    with pytest.raises(RecordingError, match=r"recording\.journal exists already, and what was measured is never"):
        stand_of(tmp_path / "out", robot)


def test_a_jump_of_a_clock_and_rows_that_cannot_be(tmp_path: Path) -> None:
    class Restarted(MadeUp):
        def rows(self) -> list[Rows]:
            found = super().rows()
            if self._sent > 9 and found:
                rows = found[0]
                stamps = rows.time - 100.0
                stamps[1] = np.nan
                return [rows._replace(time=stamps)]
            return found

    stand = stand_of(tmp_path / "out", Restarted("robot", 100.0))
    stand.run(stop=threading.Event(), duration=0.3)
    recording = stand.finish()
    assert (np.diff(recording.robot.time) > 0.0).all()
    assert recording.robot[STAMP][-1, 0] < 10.0
    said = " ".join(map(str, recording.notes))
    assert "its clock jumped" in said
    assert "rows with a number that is not finite, left out" in said


def test_who_cannot_be_reached_is_named_and_nobody_is_left_connected(tmp_path: Path) -> None:
    robot = MadeUp("robot", 0.0)

    def refuse() -> MadeUp:
        raise WireError("10.0.0.3:49152: no Net F/T")

    stand = TestStand({"HOST 10.0.0.2": lambda: robot, "--ft 10.0.0.3": refuse}, tmp_path / "out", name="made")
    with pytest.raises(WireError, match=r"--ft 10\.0\.0\.3: 10\.0\.0\.3:49152: no Net F/T"):
        stand.connect()
    assert robot.closed
    assert not (tmp_path / "out").exists()
    with pytest.raises(WireError, match="nothing to record"):
        TestStand({}, tmp_path / "out", name="made")


def test_no_row_at_all(tmp_path: Path) -> None:
    stand = stand_of(tmp_path / "out", MadeUp("ft", 0.0, pieces=0))
    stand.run(stop=threading.Event(), duration=0.1)
    with pytest.raises(WireError, match="no row came of any device"):
        stand.finish()


def test_the_offset_is_that_of_the_middle() -> None:
    time_ = np.arange(0.0, 100.0, 0.01)
    # The device's clock is 100 ppm slow, and rows come up to 5 ms late.
    late = np.abs(np.random.default_rng(1).normal(scale=2e-3, size=len(time_)))
    late[::50] = 0.0
    arrival = 1e9 + time_ * (1.0 + 1e-4) + late
    table = Table("ft", time_, {"ft_wrench": np.zeros((len(time_), 6)), ARRIVAL: arrival[:, None]})
    recording = finished(Recording({"ft": table}, "made", "journal"))
    assert recording.tables["ft"].host_start == pytest.approx(1e9 + 5e-3, abs=5e-4)
    assert any("its clock lost 9.5 ms on the host's in 100 s (95 ppm)" in str(note) for note in recording.notes)


def test_for_lab_moves_clocks_not_rows() -> None:
    tables: Mapping[str, Table] = {
        "robot": Table("robot", np.array([100.0, 100.008]), {}, 900.0),
        "ft": Table("ft", np.array([7.0, 7.01]), {}, 993.0),
        "imu": Table("imu", np.array([0.5, 0.51]), {}, 1000.0),
    }
    moved = for_lab(Recording(tables, "made", "x")).tables
    assert (moved["robot"].time[0], moved["robot"].host_start) == (0.0, 1000.0)
    assert (moved["ft"].time[0], moved["ft"].host_start) == (0.0, 1000.0)
    assert moved["imu"].time[0] == pytest.approx(0.5)
