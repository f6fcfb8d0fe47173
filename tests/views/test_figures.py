"""Figures: which are drawn, that something is on them, and that nothing global is touched."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import matplotlib.image
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ur5_twin.arm.parameters import ArmModel
from ur5_twin.recording import Recording, Table
from ur5_twin.views import paper
from ur5_twin.views.figures import write_figures

ALL = ["position.png", "velocity.png", "torque.png", "current.png", "tcp_path.png", "wrench.png"]


def _only(recording: Recording, *names: str) -> Recording:
    robot = recording.robot
    return Recording({"robot": Table("robot", robot.time, {n: robot[n] for n in names})}, "made", "test")


def _names(paths: list[Path]) -> list[str]:
    return [path.name for path in paths]


def test_all_figures_of_a_replay(replayed: Recording, model: ArmModel, tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    paths = write_figures(replayed, tmp_path / "figures", title="made", tool=model.tool)
    assert _names(paths) == ALL
    assert sorted((tmp_path / "figures").iterdir()) == sorted(paths)
    assert dict(mpl.rcParams) == before
    for path in paths:
        assert path.stat().st_size < 400_000
        picture = matplotlib.image.imread(path)[..., :3]
        assert picture.shape[0] > 800
        assert picture.shape[1] > 1400
        # Mostly white paper, but ink in each quarter.
        for half in np.array_split(picture, 2):
            for quarter in np.array_split(half, 2, axis=1):
                assert quarter.std() > 0.03, path.name


def test_the_same_recording_gives_the_same_bytes(replayed: Recording, tmp_path: Path) -> None:
    only = _only(replayed, "actual_TCP_force")
    first, second = (write_figures(only, tmp_path / name, title="made")[0].read_bytes() for name in "ab")
    assert first == second


@pytest.mark.parametrize(
    ("columns", "figures"),
    [
        ((), []),
        (("actual_q",), ["position.png"]),
        (("actual_qd", "sim_actual_qd"), ["velocity.png"]),
        (("actual_TCP_pose",), []),
        (("actual_TCP_force",), ["wrench.png"]),
        (("sim_moment",), ["torque.png"]),
    ],
)
def test_what_is_missing_is_left_out(
    replayed: Recording, columns: tuple[str, ...], figures: list[str], tmp_path: Path
) -> None:
    assert _names(write_figures(_only(replayed, *columns), tmp_path, title="made")) == figures


def test_columns_that_hold_no_number_are_missing(replayed: Recording, tmp_path: Path) -> None:
    names = ("actual_q", "target_moment", "actual_TCP_force")
    nothing = {name: np.full((len(replayed.robot), 6), np.nan) for name in names}
    empty = Recording({"robot": Table("robot", replayed.robot.time, nothing)}, "made", "test")
    assert write_figures(empty, tmp_path, title="made") == []


@pytest.mark.filterwarnings("error")
def test_gaps_are_drawn_as_gaps(replayed: Recording, tmp_path: Path) -> None:
    robot = replayed.robot
    holed = {name: values.copy() for name, values in robot.columns.items()}
    for values in holed.values():
        values[100:200] = np.nan
    holed["actual_q"][:, 2] = np.nan
    broken = replayed.with_table(Table("robot", robot.time, holed, robot.host_start))
    assert _names(write_figures(broken, tmp_path, title="made")) == ALL


@pytest.mark.filterwarnings("error")
def test_one_row_and_an_arm_that_stands_still(tmp_path: Path) -> None:
    for rows in (1, 50):
        columns = {name: np.ones((rows, 6)) for name in ("actual_q", "sim_actual_q", "target_q")}
        still = Recording({"robot": Table("robot", np.arange(rows) * 0.008, columns)}, "still", "test")
        assert _names(write_figures(still, tmp_path, title="still")) == ["position.png"]


@settings(max_examples=50, deadline=None)
@given(rows=st.integers(1, 5000), most=st.integers(10, 400), seed=st.integers(0, 100))
def test_a_thinned_line_keeps_its_extremes_and_its_gaps(rows: int, most: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=rows)
    values[rows // 3 : rows // 2] = np.nan
    time = np.arange(rows) * 0.008
    at, thinned = paper.envelope(time, values, most)
    assert len(at) == len(thinned) <= max(most, 2)
    assert np.all(np.diff(at) > 0)
    if np.isfinite(values).any():
        assert np.nanmax(thinned) == np.nanmax(values)
        assert np.nanmin(thinned) == np.nanmin(values)
    if rows // 2 - rows // 3 >= 2 * -(-rows // (most // 2)):
        assert np.isnan(thinned).any()
