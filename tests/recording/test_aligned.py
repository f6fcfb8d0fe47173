"""All devices on the robot's clock, and the rules of a table."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ur5_twin.errors import RecordingError
from ur5_twin.recording import Recording, Table
from ur5_twin.recording.checks import longest_increasing


def _ramp(time: np.ndarray) -> np.ndarray:
    """A wrench that is a straight line over time: linear interpolation gives it back exactly."""
    return np.outer(time, np.arange(1, 7)) + 3.0


def _recording(robot_start: float | None, ft_start: float | None, shift: float = 0.0) -> Recording:
    robot_time = 0.1 + 0.008 * np.arange(100)
    ft_time = 0.0013 + 0.0048 * np.arange(150)
    return Recording(
        {
            "robot": Table("robot", robot_time, {"actual_q": np.ones((100, 6))}, robot_start),
            # ``shift``: what the ft clock reads less than the robot's.
            "ft": Table("ft", ft_time, {"ft_wrench": _ramp(ft_time + shift)}, ft_start),
        },
        "made",
        "test",
    )


@pytest.mark.parametrize("shift", [0.0, 0.25, -0.25])
def test_offset_of_the_host_stamps(shift: float) -> None:
    recording = _recording(1000.0, 1000.0 + shift, shift)
    aligned = recording.aligned()
    assert recording.offset("ft") == shift
    inside = (aligned.time >= 0.0013 + shift) & (aligned.time <= 0.0013 + 0.0048 * 149 + shift)
    assert 0 < inside.sum() < 100
    np.testing.assert_allclose(aligned["ft_wrench"][inside], _ramp(aligned.time[inside]), atol=1e-12)
    assert np.isnan(aligned["ft_wrench"][~inside]).all()
    np.testing.assert_array_equal(aligned["actual_q"], recording.robot["actual_q"])
    np.testing.assert_array_equal(aligned.time, recording.robot.time)


@pytest.mark.parametrize(("robot_start", "ft_start"), [(None, 1000.0), (1000.0, None), (None, None)])
def test_unknown_offset_is_zero(robot_start: float | None, ft_start: float | None) -> None:
    recording = _recording(robot_start, ft_start)
    assert recording.offset("ft") is None
    aligned = recording.aligned()
    inside = aligned.time <= 0.0013 + 0.0048 * 149
    np.testing.assert_allclose(aligned["ft_wrench"][inside], _ramp(aligned.time[inside]), atol=1e-12)


def test_repeated_stamps() -> None:
    """Of a stamp that a device repeats the last value counts, at the stamp itself and after it."""
    robot = Table("robot", np.array([0.0, 1.0, 1.5, 2.0]), {})
    imu = Table("imu", np.array([0.0, 1.0, 1.0, 1.0, 2.0]), {"imu_acc": np.array([[0.0], [9.0], [8.0], [4.0], [6.0]])})
    aligned = Recording({"robot": robot, "imu": imu}, "made", "test").aligned()
    np.testing.assert_array_equal(aligned["imu_acc"][:, 0], [0.0, 4.0, 5.0, 6.0])


def test_a_column_of_the_robot_stays_the_robots() -> None:
    robot = Table("robot", np.array([0.0, 1.0]), {"ft_wrench": np.zeros((2, 6))})
    ft = Table("ft", np.array([0.0, 1.0]), {"ft_wrench": np.ones((2, 6))})
    np.testing.assert_array_equal(Recording({"robot": robot, "ft": ft}, "made", "test").aligned()["ft_wrench"], 0.0)


def test_who_needs_a_robot_is_told_that_there_is_none() -> None:
    sensors = Recording({"ft": Table("ft", np.zeros(0), {})}, "made", "test")
    with pytest.raises(RecordingError, match=r"made: no robot table \(found: ft\)"):
        sensors.aligned()
    with pytest.raises(RecordingError, match="made: a recording without any table"):
        Recording({}, "made", "test")


def test_a_column_must_fit_its_table() -> None:
    with pytest.raises(RecordingError, match=r"robot: column 'actual_q' has shape \(3,\), the table has 2 rows"):
        Table("robot", np.zeros(2), {"actual_q": np.zeros(3)})
    with pytest.raises(RecordingError, match=r"the robot table has no column 'x' \(it has: y\)"):
        Table("robot", np.zeros(2), {"y": np.zeros((2, 1))})["x"]


@given(stamps=st.lists(st.integers(0, 8), max_size=9), strictly=st.booleans())
def test_longest_increasing_is_longest(stamps: list[int], strictly: bool) -> None:
    """Against trying all subsets."""
    time = np.array(stamps, dtype=float)

    def increases(rows: np.ndarray) -> bool:
        steps = np.diff(time[rows])
        return bool((steps > 0).all() if strictly else (steps >= 0).all())

    subsets = ([i for i in range(len(time)) if mask >> i & 1] for mask in range(2 ** len(time)))
    best = max(len(rows) for rows in subsets if increases(np.array(rows, dtype=int)))
    kept = longest_increasing(time, strictly=strictly)
    assert len(kept) == best
    assert increases(kept)
    assert (np.diff(kept) > 0).all()
