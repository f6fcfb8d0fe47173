"""Waypoint files of the lab."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ur5_twin.arm.kinematics import forward
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.commands import MoveJ, MoveL, Pose
from ur5_twin.control.program import plan
from ur5_twin.control.waypoints import Waypoints, format_move, parse_move, read_waypoints, write_waypoints
from ur5_twin.errors import ScenarioError, TwinError

#: The thesis' figure 4.5, with what the format allows besides.
FIGURE = """\
# Singularity_Free.txt
joint_space 3.2
movej([2.181661, -2.135061, -1.745329,  0.275936, -6.021385, 0])

movej([2.181661, -2.135061, -1.745329,  0.275936, -6.021385, 0.5], a=1.0, v=0.5)  # slowly
movel(p[0.1, -0.4, 0.3, 0, 3.1, 0], 1.0, 0.1, r=0.02)
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "points.txt"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_figures_file(tmp_path: Path) -> None:
    points = read_waypoints(written(tmp_path, FIGURE))
    start = (2.181661, -2.135061, -1.745329, 0.275936, -6.021385, 0.0)
    assert points.moves == (
        MoveJ(start),
        MoveJ((*start[:5], 0.5), a=1.0, v=0.5),
        MoveL(Pose((0.1, -0.4, 0.3, 0, 3.1, 0)), a=1.0, v=0.1, r=0.02),
    )
    assert (points.space, points.wait) == ("joint_space", 3.2)
    assert points.sent().times == (0.0, 3.2, 6.4)


def test_what_is_not_said_has_the_labs_defaults(tmp_path: Path) -> None:
    path = written(tmp_path, "movej([0, 0, 0, 0, 0, 0])\n")
    points = read_waypoints(path)
    assert (points.space, points.wait) == ("joint_space", 3.0)
    # What the caller says rules.
    points = read_waypoints(path, space="task_space", wait=1.5)
    assert (points.space, points.wait) == ("task_space", 1.5)


def test_task_space_goes_straight_to_the_same_place(tmp_path: Path) -> None:
    model = load_model("controller")
    start = np.array([1.266, -2.135, -1.947, -0.377, -2.542, -0.5])
    goal = start + np.array([0.2, 0.1, 0.0, 0.1, 0.0, 0.0])
    path = written(tmp_path, f"task_space\nmovej({list(map(float, goal))})\n")
    reference = plan(model, start, read_waypoints(path).sent())
    p = forward(model, reference.rows[:, 0])[:, :3, 3]
    way = p[-1] - p[0]
    # Closed-form inverse kinematics: rounding.
    assert np.linalg.norm(np.cross(p - p[0], way / np.linalg.norm(way)), axis=1).max() < 1e-9
    assert np.allclose(reference.rows[-1, 0], goal, rtol=0, atol=1e-9)


numbers = st.lists(st.floats(-6.0, 6.0), min_size=6, max_size=6).map(tuple)
positive, zero_up = st.floats(1e-3, 3.0), st.floats(0.0, 3.0)
moves = st.builds(
    lambda kind, goal, a, v, t, r: kind(goal, a=a, v=v, t=t, r=r),
    st.sampled_from([MoveJ, MoveL]),
    numbers | numbers.map(Pose),
    positive,
    positive,
    zero_up,
    zero_up,
)


@given(move=moves)
def test_a_move_survives_its_text(move: MoveJ | MoveL) -> None:
    assert parse_move(format_move(move)) == move


@pytest.mark.parametrize("space", ["joint_space", "task_space"])
def test_a_file_survives_writing(tmp_path: Path, space: str) -> None:
    points = Waypoints((MoveJ((0.1,) * 6), MoveL(Pose((0.4, 0.1, 1 / 3, 0, 3.1, 0)), a=0.5, r=0.01)), space, 1.7)
    path = tmp_path / "points.txt"
    write_waypoints(points, path)
    assert read_waypoints(path) == points


def test_arguments_at_their_defaults_are_not_written() -> None:
    assert format_move(MoveJ((0, 0, 0, 0, 0, 1.5))) == "movej([0.0, 0.0, 0.0, 0.0, 0.0, 1.5])"
    assert format_move(MoveL(Pose((1, 0, 0, 0, 0, 0)), r=0.05)) == "movel(p[1.0, 0.0, 0.0, 0.0, 0.0, 0.0], r=0.05)"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("movej([0, 0, 0, 0, 0])", "movej: goal: 5 numbers, expected 6"),
        ("movej([0, 0, 0, 0, 0, x])", "movej: goal: 'x' is no number"),
        ("movej([0, 0, 0, 0, 0, 0]", "is no URScript call"),
        ("movek([0, 0, 0, 0, 0, 0])", "unknown command 'movek'; did you mean"),
        ("movej([0, 0, 0, 0, 0, 0], w=1)", r"movej: unknown argument 'w'.*known: a, r, t, v"),
        ("movej([0, 0, 0, 0, 0, 0], 1, a=1)", "movej: a is given twice"),
        ("movej([0, 0, 0, 0, 0, 0], 1, 1, 0, 0, 0)", "6 arguments, expected a goal"),
        ("movej([0, 0, 0, 0, 0, 0], v=-1)", "movej: v is -1.0, it must be positive"),
        ("movej(q[0, 0, 0, 0, 0, 0])", "movej: the goal is"),
        ("movej([0, 0, 0, 0, 0, 0], v=1e999)", "movej: v is inf"),
        ("task_space 3", "keyword and waiting time stand once, before the moves"),
    ],
)
def test_errors_name_file_and_line(tmp_path: Path, line: str, message: str) -> None:
    path = written(tmp_path, f"# a comment\nmovej([0, 0, 0, 0, 0, 0])\n\n{line}\n")
    with pytest.raises(ScenarioError, match=f"points.txt line 4: .*{message}"):
        read_waypoints(path)


def test_errors_of_the_first_lines(tmp_path: Path) -> None:
    for text, message in (
        ("cartesian 3\n", "line 1: unknown keyword 'cartesian'"),
        ("joint_space soon\n", "line 1: waiting time 'soon' is no number of seconds"),
        ("joint_space 0\n", "line 1: keyword line: wait is 0.0, it must be positive"),
        ("joint_space 3 4\n", "line 1: 'joint_space 3 4': expected a keyword and at most one waiting time"),
        ("# nothing\n", "there is no move"),
    ):
        with pytest.raises(ScenarioError, match=f"points.txt:? {message}" if "line" in message else message):
            read_waypoints(written(tmp_path, text))
    with pytest.raises(ScenarioError, match=r"cannot read .*missing\.txt"):
        read_waypoints(tmp_path / "missing.txt")


def test_task_space_has_no_use_for_rad_per_s(tmp_path: Path) -> None:
    text = "task_space\nmovej([0, 0, 0, 0, 0, 0])\nmovej([0, 0, 0, 0, 0, 1], v=0.5)\n"
    with pytest.raises(ScenarioError, match=r"points.txt line 3: under task_space movej.* v=0\.5\) has a or v in rad"):
        read_waypoints(written(tmp_path, text))
    with pytest.raises(TwinError, match="unknown keyword 'cartesian'"):
        Waypoints((MoveJ((0,) * 6),), "cartesian")  # type: ignore[arg-type]
