"""Blends: within their circle, without a stop, with the legs' speeds and accelerations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from ur5_twin import spatial
from ur5_twin.arm.kinematics import acceleration, forward, twist
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.blend import blended
from ur5_twin.control.commands import Move, MoveJ, MoveL, Pose
from ur5_twin.control.trajectory import movej
from ur5_twin.errors import TwinError

MODEL = load_model("controller")
Q = np.array([1.266, -2.135, -1.947, -0.377, -2.542, -0.5])
FINE = 0.001


def at(x: float, y: float, z: float, turn: float = 0.0) -> Pose:
    """The pose of Q, shifted in m and turned about the base's z, rad."""
    X = forward(MODEL, Q)
    R = spatial.rotation_from_vector(np.array([0.0, 0.0, turn])) @ X[:3, :3]
    return Pose(tuple(spatial.vector_from_pose(spatial.pose(R, X[:3, 3] + [x, y, z]))))


def bent(*turns: float) -> tuple[float, ...]:
    return tuple(Q + np.array(turns))


SQUARE = (MoveL(at(0.1, 0, 0), r=0.03), MoveL(at(0.1, 0.1, 0, 0.1), r=0.04), MoveL(at(0.0, 0.1, 0.05)))
JOINTS = (
    MoveJ(bent(0.5, 0.3, 0, 0, 0, 0), r=0.05),
    MoveJ(bent(0.5, -0.3, 0.3, 0, 0.2, 0), r=0.05),
    MoveJ(bent(0, 0, 0, 0, 0, 0)),
)
MIXED = (
    MoveJ(bent(0.5, 0.3, 0, 0, 0, 0), r=0.05),
    MoveL(at(0.1, 0, 0), r=0.05),
    MoveJ(bent(-0.5, 0, 0, 0, 0, 1)),
)
SEQUENCES = pytest.mark.parametrize("moves", [SQUARE, JOINTS, MIXED], ids=["movel", "movej", "mixed"])


def corner_of(move: Move) -> np.ndarray:
    return move.goal.matrix()[:3, 3] if isinstance(move.goal, Pose) else forward(MODEL, np.array(move.goal))[:3, 3]


@SEQUENCES
def test_the_arm_leaves_the_corner_within_its_circle_and_keeps_moving(moves: tuple[Move, ...]) -> None:
    path = blended(MODEL, Q, moves, period=FINE)
    q, qd, _ = path.rows.swapaxes(0, 1)
    p = forward(MODEL, q)[:, :3, 3]
    t = np.arange(len(q)) * FINE
    speed = np.abs(qd).max(axis=1)
    for move, time in zip(moves[:-1], path.times[1:-1], strict=True):
        distance = np.linalg.norm(p - corner_of(move), axis=1)
        # It passes within the circle, cuts the corner, and does not stop there. 2 % of the full speed is no stop.
        nearest = int(np.argmin(distance))
        assert 1e-4 < distance[nearest] < move.r
        assert speed[np.abs(t - time) < 0.1].min() > 0.02
    # Outside all circles each movel is straight.
    outside = np.all([np.linalg.norm(p - corner_of(move), axis=1) > move.r for move in moves[:-1]], axis=0)
    for k, move in enumerate(moves):
        if isinstance(move, MoveL) and k:
            here = outside & (t > path.times[k]) & (t < path.times[k + 1])
            a, b = corner_of(moves[k - 1]), corner_of(move)
            off = np.cross(p[here] - a, (b - a) / np.linalg.norm(b - a))
            # Closed-form inverse kinematics.
            assert np.abs(off).max() < 1e-9


@SEQUENCES
def test_blended_rows_are_one_function_of_time_from_rest_to_rest(moves: tuple[Move, ...]) -> None:
    path = blended(MODEL, Q, moves, period=FINE)
    q, qd, qdd = path.rows.swapaxes(0, 1)
    assert np.allclose(q[0], Q, rtol=0, atol=1e-9)
    assert not qd[0].any()
    assert not path.rows[-1, 1:].any()
    assert np.allclose(forward(MODEL, q[-1])[:3, 3], corner_of(moves[-1]), rtol=0, atol=1e-9)
    # Speed is continuous: it changes by no more than a tick of the highest acceleration.
    top = np.abs(qdd).max()
    assert np.abs(np.diff(qd, axis=0)).max() <= top * FINE * (1 + 1e-6)
    # The trapezoidal rule is off by a dt^2 / 4 at a jump of 2 a, and by dt^3 / 12 of the jerk between.
    assert np.abs(np.diff(q, axis=0) - 0.5 * FINE * (qd[1:] + qd[:-1])).max() < top * FINE**2 / 4 * (1 + 1e-3)
    # Away from jumps qdd is the slope of qd; what is left is dt^2 / 12 times qd's third derivative (some 100 rad/s^4).
    jump = np.abs(np.diff(qdd, axis=0)).max(axis=1)
    smooth = jump < 0.2
    assert smooth.mean() > 0.98
    slope = np.diff(qd, axis=0) - 0.5 * FINE * (qdd[1:] + qdd[:-1])
    assert np.abs(slope[smooth & np.roll(smooth, 1)]).max() < 1e-6


def test_a_blend_of_lines_is_a_parabola_that_keeps_the_bounds() -> None:
    path = blended(MODEL, Q, SQUARE, period=FINE)
    q, qd, qdd = path.rows.swapaxes(0, 1)
    V, A = twist(MODEL, q, qd), acceleration(MODEL, q, qd, qdd)
    # Rounding of J times J^-1, with joint accelerations up to a few rad/s^2.
    assert np.linalg.norm(V[:, :3], axis=1).max() <= 0.25 * (1 + 1e-9)
    assert np.linalg.norm(A[:, :3], axis=1).max() <= 1.2 * (1 + 1e-9)
    # Within the blend the flange's acceleration is one constant vector.
    t = np.arange(len(q)) * FINE
    middle = np.abs(t - path.times[1]) < 0.02
    assert np.ptp(A[middle, :3], axis=0).max() < 1e-8
    assert np.linalg.norm(A[middle, :3], axis=1).min() > 0.5


def test_a_straight_corner_keeps_the_full_speed() -> None:
    # Two lines in one direction with a circle between: nothing to slow down for.
    path = blended(MODEL, Q, (MoveL(at(0.1, 0, 0), r=0.03), MoveL(at(0.2, 0, 0))), period=FINE)
    V = twist(MODEL, path.rows[:, 0], path.rows[:, 1])
    t = np.arange(len(V)) * FINE
    assert np.abs(V[np.abs(t - path.times[1]) < 0.1, 0] - 0.25).max() < 1e-9
    # The same with joints, which is then one movej.
    legs = blended(MODEL, Q, (MoveJ(bent(0.5, 0, 0, 0, 0, 0), r=0.05), MoveJ(bent(1, 0, 0, 0, 0, 0))), period=FINE)
    whole = movej(Q, np.array(bent(1, 0, 0, 0, 0, 0)), period=FINE)
    assert np.allclose(legs.rows, whole, rtol=0, atol=1e-9)


turns = st.lists(st.floats(-0.6, 0.6), min_size=6, max_size=6).map(np.array)


@settings(max_examples=40, deadline=None)
@given(first=turns, second=turns, r=st.floats(0.01, 0.1), v=st.floats(0.2, 3.2), a=st.floats(0.5, 25.0))
def test_blended_joint_moves_keep_circle_and_limits(
    first: np.ndarray, second: np.ndarray, r: float, v: float, a: float
) -> None:
    corner = Q + first
    moves = (MoveJ(tuple(corner), a=a, v=v, r=r), MoveJ(tuple(corner + second), a=a, v=v))
    try:
        path = blended(MODEL, Q, moves, period=0.004)
    except TwinError as error:
        if "overlapping blends" not in str(error):
            raise
        reject()
    assert np.abs(path.rows[:, 1]).max() <= v * (1 + 1e-9)
    assert np.abs(path.rows[:, 2]).max() <= a * (1 + 1e-9)
    p = forward(MODEL, path.rows[:, 0])[:, :3, 3]
    center = forward(MODEL, corner)[:3, 3]
    on_a_leg = np.zeros(len(p), dtype=bool)
    for start, way in ((Q, first), (corner, second)):
        s = np.clip((path.rows[:, 0] - start) @ way / (way @ way), 0.0, 1.0)
        on_a_leg |= np.abs(path.rows[:, 0] - start - np.outer(s, way)).max(axis=1) < 1e-9
    # The bulge is looked for at 129 points of a blend: between two of them it is less than 1e-4 r higher.
    assert np.linalg.norm(p - center, axis=1)[~on_a_leg].max(initial=0.0) <= r * (1 + 1e-4)


def test_overlapping_blends_are_refused() -> None:
    moves = (MoveL(at(0.1, 0, 0), r=0.06), MoveL(at(0.1, 0.1, 0), r=0.05), MoveL(at(0, 0.1, 0)))
    with pytest.raises(TwinError, match=r"move 1 \(movel\): overlapping blends, r = 0\.06 m and r = 0\.05 m"):
        blended(MODEL, Q, moves, period=FINE)
    with pytest.raises(TwinError, match=r"move 0 \(movel\): overlapping blends, r = 0\.11 m"):
        blended(MODEL, Q, (MoveL(at(0.1, 0, 0), r=0.11), MoveL(at(0.1, 0.3, 0))), period=FINE)
    # A turn of joint 6 does not move the flange's origin out of any circle.
    with pytest.raises(TwinError, match=r"move 1 \(movej\): overlapping blends"):
        blended(MODEL, Q, (MoveJ(bent(1, 0, 0, 0, 0, 0), r=0.01), MoveJ(bent(1, 0, 0, 0, 0, 1))), period=FINE)
    with pytest.raises(TwinError, match="goes to where the arm already is"):
        blended(MODEL, Q, (MoveJ(bent(1, 0, 0, 0, 0, 0), r=0.01), MoveJ(bent(1, 0, 0, 0, 0, 0))), period=FINE)


@pytest.mark.parametrize("kind", [MoveJ, MoveL])
def test_the_time_of_a_move_rules(kind: type[MoveJ] | type[MoveL]) -> None:
    path = blended(MODEL, Q, (kind(at(0.1, 0.05, 0, 0.1), t=2.0),), period=0.008)
    assert np.isclose(path.times[-1], 2.0, rtol=1e-12)
    assert len(path.rows) == 251


def test_a_movej_to_a_pose_takes_the_nearest_joints() -> None:
    wanted = Q + np.array([0.2, -0.1, 0.1, 0.2, -0.1, 0.3])
    pose = Pose(tuple(spatial.vector_from_pose(forward(MODEL, wanted))))
    path = blended(MODEL, Q, (MoveJ(pose),), period=0.008)
    # Through a rotation vector and the closed form: rounding.
    assert np.allclose(path.rows[-1, 0], wanted, rtol=0, atol=1e-9)
    with pytest.raises(TwinError, match=r"move 0 \(movej\): pose .* is out of the arm's reach"):
        blended(MODEL, Q, (MoveJ(Pose((2.0, 0, 0, 0, 0, 0))),), period=0.008)
