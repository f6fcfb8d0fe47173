"""Programs: what runs, when, and what is ignored."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ur5_twin import spatial
from ur5_twin.arm.kinematics import forward
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.commands import MoveJ, MoveL, Pose, Program, Sent, ServoJ, Wait
from ur5_twin.control.program import Reference, plan
from ur5_twin.errors import TwinError

MODEL = load_model("controller")
Q = np.array([1.266, -2.135, -1.947, -0.377, -2.542, -0.5])
PERIOD = 0.008


def turned(angle: float) -> MoveJ:
    return MoveJ(tuple(Q + angle))


def check_consistent(reference: Reference) -> None:
    """Rest to rest, and each row follows from the former within what a jump of qdd inside a tick allows."""
    q, qd, qdd = reference.rows.swapaxes(0, 1)
    assert not qd[0].any()
    assert not reference.rows[-1, 1:].any()
    dt, top = reference.period, max(np.abs(qdd).max(), 1e-9)
    assert np.abs(np.diff(qd, axis=0)).max(initial=0.0) <= top * dt * 1.01 + 1e-9
    # dt^2 / 4 per half jump; a stream's set points jump by up to the top acceleration within a tick.
    assert np.abs(np.diff(q, axis=0) - 0.5 * dt * (qd[1:] + qd[:-1])).max(initial=0.0) <= top * dt**2 / 4 * 1.01


def test_a_program_runs_its_commands_one_after_another() -> None:
    X = forward(MODEL, Q + 0.3)
    X[:3, 3] += [0.05, 0.0, -0.05]
    stream = ServoJ((0.0, 0.1), (tuple(Q + 0.31), tuple(Q + 0.32)))
    program = Program((turned(0.3), Wait(2.0), MoveL(Pose(tuple(spatial.vector_from_pose(X)))), turned(0.3), stream))
    reference = plan(MODEL, Q, program)
    check_consistent(reference)
    assert [one.index for one in reference.executed] == [0, 1, 2, 3, 4]
    assert reference.ignored == ()
    starts, ends = (np.array([getattr(one, key) for one in reference.executed]) for key in ("start", "end"))
    # 0.3 rad at 1.4 rad/s^2 is a triangle: 2 sqrt(0.3 / 1.4) s.
    assert np.isclose(ends[0], 2 * np.sqrt(0.3 / 1.4))
    # A command starts at the first tick after the former one's end.
    assert np.allclose(starts[1:], np.ceil(np.round(ends[:-1] / PERIOD, 9)) * PERIOD)
    assert np.isclose(ends[1] - starts[1], 2.0)
    still = (reference.time > starts[1]) & (reference.time < ends[1])
    assert not reference.rows[still, 1:].any()
    assert np.allclose(reference.rows[still, 0], Q + 0.3)
    assert np.isclose(reference.time[-1], ends[-1])


def test_moves_with_a_radius_blend_and_others_stop() -> None:
    a, b = MoveJ(tuple(Q + np.eye(6)[0]), r=0.1), MoveJ(tuple(Q + np.eye(6)[0] + np.eye(6)[1] * 0.5))
    blend = plan(MODEL, Q, Program((a, b)))
    stops = plan(MODEL, Q, Program((a, Wait(0.0), b)))
    for reference in (blend, stops):
        check_consistent(reference)
        assert np.allclose(reference.rows[-1, 0], b.goal)
    moving = np.abs(blend.rows[5:-5, 1]).max(axis=1)
    assert moving.min() > 0.02
    assert (np.abs(stops.rows[5:-5, 1]).max(axis=1) == 0.0).any()
    assert len(blend.rows) < len(stops.rows)
    assert blend.executed[0].end == blend.executed[1].start


def test_a_command_that_arrives_in_motion_is_ignored() -> None:
    # 1 rad takes 1 / 1.05 + 1.05 / 1.4 = 1.702 s; commands arrive every 0.7 s: at 0.7 and 1.4 s the arm still moves.
    commands = [turned(1.0), turned(0.3), turned(0.6), turned(0.8), turned(0.0)]
    reference = plan(MODEL, Q, Sent.every(commands, 0.7))
    check_consistent(reference)
    assert [one.index for one in reference.executed] == [0, 3]
    assert [(one.index, one.because) for one in reference.ignored] == [(1, 0), (2, 0), (4, 3)]
    assert [one.time for one in reference.ignored] == pytest.approx([0.7, 1.4, 2.8])
    # The fourth command starts from where the first one ended, 0.2 rad away, not from where the third would have led.
    assert np.isclose(reference.executed[1].start, 2.104)  # 2.1 s is no tick: the next one
    assert np.isclose(reference.executed[1].end - reference.executed[1].start, 2 * np.sqrt(0.2 / 1.4))
    assert np.allclose(reference.rows[-1, 0], Q + 0.8)


def test_enough_waiting_ignores_nothing() -> None:
    reference = plan(MODEL, Q, Sent.every([turned(0.5), turned(0.0), turned(0.2)]))
    assert [one.index for one in reference.executed] == [0, 1, 2]
    assert [one.start for one in reference.executed] == [0.0, 3.0, 6.0]
    assert reference.ignored == ()


def test_of_commands_in_one_tick_the_newest_runs() -> None:
    reference = plan(MODEL, Q, Sent((turned(0.1), turned(0.2)), (0.5, 0.5)))
    assert [one.index for one in reference.executed] == [1]
    assert [(one.index, one.because) for one in reference.ignored] == [(0, 1)]
    assert reference.executed[0].start == 0.504


@settings(max_examples=30, deadline=None)
@given(
    angles=st.lists(st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).map(np.array), min_size=1, max_size=4),
    wait=st.floats(0.05, 3.0),
    v=st.floats(0.1, 3.2),
    a=st.floats(0.5, 25.0),
)
def test_whatever_is_sent_keeps_the_limits(angles: list[np.ndarray], wait: float, v: float, a: float) -> None:
    reference = plan(MODEL, Q, Sent.every([MoveJ(tuple(Q + angle), v=v, a=a) for angle in angles], wait))
    check_consistent(reference)
    assert len(reference.executed) + len(reference.ignored) == len(angles)
    assert np.abs(reference.rows[:, 1]).max() <= v * (1 + 1e-9)
    assert np.abs(reference.rows[:, 2]).max() <= a * (1 + 1e-9)
    assert np.array_equal(reference.rows[-1, 0], reference.executed[-1].command.goal)


def test_errors_name_the_command() -> None:
    with pytest.raises(TwinError, match=r"command 1 \(movej\): goal: elbow is 7 rad"):
        plan(MODEL, Q, Program((Wait(1.0), MoveJ((0, 0, 7, 0, 0, 0)))))
    with pytest.raises(TwinError, match=r"command 0 \(movel\) at s = 0\.\d+ of the line: .*out of the arm's reach"):
        plan(MODEL, Q, Program((MoveL(Pose((2.0, 0, 0, 0, 0, 0))),)))
    with pytest.raises(TwinError, match=r"command 0 \(servoj\): set point 0"):
        plan(MODEL, Q, Program((ServoJ((0.0,), ((7, 0, 0, 0, 0, 0),)),)))
    with pytest.raises(TwinError, match="plan: start: wrist_3 is 9 rad"):
        plan(MODEL, [0, 0, 0, 0, 0, 9.0], Program((Wait(1.0),)))
    with pytest.raises(TwinError, match="command 0 is a Wait, expected one of MoveJ, MoveL, ServoJ"):
        Sent((Wait(1.0),), (0.0,))
    with pytest.raises(TwinError, match="one command at least"):
        Program(())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"v": 0.0}, "movej: v is 0.0, it must be positive"),
        ({"a": -1.0}, "movej: a is -1.0, it must be positive"),
        ({"t": -1.0}, "movej: t is -1.0, it must not be negative"),
        ({"r": -0.1}, "movej: r is -0.1, it must not be negative"),
        ({"goal": (0, 0)}, "movej: goal: 2 numbers, expected 6"),
        ({"goal": (0, 0, 0, 0, 0, "x")}, "is not a list of 6 numbers"),
    ],
)
def test_commands_are_checked_where_they_are_made(arguments: dict, message: str) -> None:
    with pytest.raises(TwinError, match=message):
        MoveJ(**{"goal": (0,) * 6, **arguments})
