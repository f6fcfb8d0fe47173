"""Moves one after another that blend at their corners instead of stopping.

Each leg is a straight way with a path coordinate x of its own: the leading joint's angle for movej, that of
``cartesian.Line`` for movel. A blend takes T, in which the coordinate that is left on the former leg falls as
d_A (1 - t/T)^2 while that of the next one grows as d_B (t/T)^2; the path is the sum of both, seen from the corner. Its
speed changes from the former leg's to the next one's at a constant rate: a parabola.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from ur5_twin import spatial
from ur5_twin.arm.inverse_kinematics import nearest
from ur5_twin.arm.kinematics import acceleration as flange_acceleration
from ur5_twin.arm.kinematics import forward
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.control.arc import Arc, arc
from ur5_twin.control.cartesian import Line, check_line, flange_motion, interpolate, joint_rows, line, track
from ur5_twin.control.commands import Move, MoveC, MoveJ, Pose
from ur5_twin.control.limits import check_position, check_rates, check_rows
from ur5_twin.control.profile import Trapezoid, ticks
from ur5_twin.control.trajectory import require_positive, still
from ur5_twin.errors import TwinError

#: With ``t`` given the speed rises for a third of it and falls for a third.
_RAMP_SHARE = 1.0 / 3.0
#: Points at which a leg's distance from a corner, and a blend's bulge and peaks, are looked for.
_LEG_POINTS, _BLEND_POINTS = 513, 129
#: A blend that bulges beyond its circle is made this much smaller until it does not.
_SHRINK = 0.97
#: Circles may take this share of a leg, not all of it: no leg starts or ends in the middle of a blend.
_FREE = 1.0 - 1e-6


@dataclass(frozen=True)
class JointLine:
    """q = start + direction x; ``direction`` (6,) is 1 or -1 for the leading joint, ``length`` its angle in rad."""

    start: np.ndarray
    goal: np.ndarray
    direction: np.ndarray
    length: float
    name: str

    def rows(self, x: np.ndarray, xd: np.ndarray, xdd: np.ndarray) -> np.ndarray:
        """(n, 3, 6) q, qd, qdd at path coordinates (n,), their rates and accelerations."""
        way, rate, change = (np.outer(values, self.direction) for values in (x, xd, xdd))
        return np.stack([self.start + way, rate, change], axis=1)

    def where(self, x: float) -> str:
        """Words for a place on the way."""
        return f"{self.name} at s = {x / self.length:.3f} of its way"


@dataclass(frozen=True)
class Leg:
    """A way with the speed ``v`` and the acceleration ``a`` along it, in units of its path coordinate."""

    way: JointLine | Line | Arc
    v: float
    a: float


@dataclass(frozen=True)
class Path:
    """Rows of moves that blend, and when each move begins and ends.

    Attributes:
        rows: (n, 3, 6) q, qd, qdd at 0, period, 2 period, ... up to and including rest.
        times: (m + 1,) s: move i takes from times[i] to times[i + 1]; a blend's middle parts its two moves.
    """

    rows: np.ndarray
    times: np.ndarray


@dataclass(frozen=True)
class Corner:
    """A blend: d_A and d_B of its two legs, and its time if both are passed at their full speeds.

    ``guide`` (m, 6) holds the joints at evenly spaced times where both legs are lines of the same tool: then the poses
    are summed, otherwise the joints.
    """

    before: Leg
    after: Leg
    left: float
    taken: float
    guide: np.ndarray | None = None

    @property
    def full_time(self) -> float:
        return 2.0 * self.left / self.before.v

    def rows(self, t: np.ndarray, time: float) -> np.ndarray:
        """(n, 3, 6) q, qd, qdd at times t (n,) of a blend that takes ``time``."""
        share = t / time
        x, xd, xdd = (1.0 - share) ** 2, -2.0 * (1.0 - share) / time, np.full_like(t, 2.0 / time**2)
        y, yd, ydd = share**2, 2.0 * share / time, xdd
        x, xd, xdd = self.left * x, self.left * xd, self.left * xdd
        y, yd, ydd = self.taken * y, self.taken * yd, self.taken * ydd
        if self.guide is not None:
            near = interpolate(np.linspace(0.0, 1.0, len(self.guide)), self.guide, share)
            before, after = self.before.way, self.after.way
            assert isinstance(before, Line)
            assert isinstance(after, Line)
            flange = flange_motion(after.X_FT, *_summed_lines(before, after, (x, xd, xdd), (y, yd, ydd)))
            return joint_rows(after.model, *flange, near, lambda k: self.where())
        tail = self.before.way.rows(self.before.way.length - x, -xd, -xdd)
        head = self.after.way.rows(y, yd, ydd)
        rows = tail + head
        rows[:, 0] -= self.before.way.goal
        return rows

    def where(self) -> str:
        return f"the blend from {self.before.way.name} to {self.after.way.name}"


def leg(
    model: ArmModel,
    q_start: np.ndarray,
    move: Move | MoveC,
    period: float,
    name: str,
    X_FT: np.ndarray | None = None,
) -> Leg | None:
    """The way of a move from a joint position (6,), and its rates; None if the arm is there already.

    ``name`` stands for the move in messages. With a tool at X_FT (4, 4) in the flange it is the tool that a movel takes
    straight, and poses are the tool's.

    Raises:
        TwinError: the goal is out of reach, or the way, the speed or the acceleration is beyond the joints' limits.
    """
    X_FT = np.eye(4) if X_FT is None else X_FT
    if isinstance(move, MoveJ):
        goal = _joint_goal(model, q_start, move, name, X_FT)
        check_position(model.limits, goal, f"{name}: goal")
        length = float(np.abs(goal - q_start).max())
        if length == 0.0:
            return None
        way = JointLine(q_start, goal, (goal - q_start) / length, length, name)
        v, a = _rates(move, length)
        check_rates(model.limits, way.direction, v, a, name)
        return Leg(way, v, a)
    if isinstance(move, MoveC):
        via = np.array(move.via.vector[:3])
        goal, step = move.goal.matrix(), move.v * period
        return Leg(arc(model, q_start, via, goal, step, X_FT, turns_with=move.turns_with, name=name), move.v, move.a)
    X_goal = move.goal.matrix() if isinstance(move.goal, Pose) else forward(model, np.array(move.goal)) @ X_FT
    way = line(model, q_start, X_goal, move.v * period, name, X_FT)
    return None if way is None else Leg(way, *_rates(move, way.length))


def blended(
    model: ArmModel, q_start: ArrayLike, moves: Sequence[Move], *, period: float, names: Sequence[str] | None = None
) -> Path:
    """Moves one after another from rest to rest, with a blend of radius ``r`` at each goal but the last one's.

    A blend begins and ends within the circle of radius r around the waypoint (the flange's way from it) and stays
    in it. It is passed as fast as both legs' speeds, accelerations and the joints' limits allow.

    Args:
        model: the arm with its limits.
        q_start: (6,) joint position at rest, rad.
        moves: at least one; all but the last have r > 0.
        period: tick, s.
        names: of the moves in messages; by default "move 0 (movej)" and so on.

    Returns:
        The rows and the moves' times.

    Raises:
        TwinError: circles overlap on a leg, or a leg is beyond reach or limits; the message names the move.
    """
    require_positive("blended", period=period)
    q_start = np.asarray(q_start, dtype=float)
    names = names or [f"move {k} ({move.name})" for k, move in enumerate(moves)]
    legs: list[Leg] = []
    q = q_start
    for name, move in zip(names, moves, strict=True):
        made = leg(model, q, move, period, name)
        if made is None and len(moves) == 1:
            return Path(still(q_start, 1), np.zeros(2))
        if made is None:
            raise TwinError(f"{name}: overlapping blends, it goes to where the arm already is")
        legs.append(made)
        q = made.way.goal
    corners = _corners(model, legs, [move.r for move in moves[:-1]])
    tempo = _tempos(model, legs, corners)
    return _timed(model, legs, corners, tempo, period)


def _joint_goal(model: ArmModel, q_start: np.ndarray, move: MoveJ, name: str, X_FT: np.ndarray) -> np.ndarray:
    if not isinstance(move.goal, Pose):
        return np.array(move.goal)
    q = nearest(model, move.goal.matrix() @ np.linalg.inv(X_FT), q_start)
    if np.isnan(q).any():
        raise TwinError(f"{name}: pose {list(move.goal.vector)} is out of the arm's reach")
    return q


def _rates(move: Move, length: float) -> tuple[float, float]:
    """Speed and acceleration of a move: its own, or those that take its time t with ramps of a third each."""
    if move.t == 0.0:
        return move.v, move.a
    v = length / (move.t * (1.0 - _RAMP_SHARE))
    return v, v / (move.t * _RAMP_SHARE)


def zone(
    model: ArmModel, way: JointLine | Line | Arc, r: float, *, at_goal: bool, X_FT: np.ndarray | None = None
) -> float:
    """Path coordinate from an end of a way to where the tool is first r away from it; inf if it never is.

    X_FT (4, 4) is the tool in the flange for a way of the joints, the flange itself by default.
    """
    if isinstance(way, Line):
        slope = np.linalg.norm(way.slope[:3])
        return r / float(slope) if slope > 0.0 else np.inf
    if isinstance(way, Arc):
        return way.within(r)
    x = np.linspace(0.0, way.length, _LEG_POINTS)
    along = way.length - x if at_goal else x
    p = (forward(model, way.start + np.outer(along, way.direction)) @ (np.eye(4) if X_FT is None else X_FT))[:, :3, 3]
    distance = np.linalg.norm(p - p[0], axis=1)
    if distance.max() <= r:
        return np.inf
    k = int(np.argmax(distance > r))
    return float(np.interp(r, distance[k - 1 : k + 1], x[k - 1 : k + 1]))


def _corners(model: ArmModel, legs: list[Leg], radii: list[float]) -> list[Corner]:
    """The blends' places and sizes."""
    taken = [0.0] + [zone(model, after.way, r, at_goal=False) for after, r in zip(legs[1:], radii, strict=True)]
    left = [zone(model, before.way, r, at_goal=True) for before, r in zip(legs[:-1], radii, strict=True)] + [0.0]
    for k, (one, head, tail) in enumerate(zip(legs, taken, left, strict=True)):
        if head + tail > _FREE * one.way.length and len(legs) > 1:
            circles = " and ".join(f"r = {r:g} m" for r in [*radii[max(k - 1, 0) : k], *radii[k : k + 1]])
            raise TwinError(
                f"{one.way.name}: overlapping blends, {circles} at its ends leave nothing of its way; "
                "choose smaller radii"
            )
    corners = []
    for (before, after), r, x, y in zip(pairwise(legs), radii, left[:-1], taken[1:], strict=True):
        time = min(2.0 * x / before.v, 2.0 * y / after.v)
        corner = Corner(before, after, 0.5 * before.v * time, 0.5 * after.v * time)
        center = forward(model, before.way.goal)[:3, 3]
        while True:
            corner = guided(corner)
            rows = _samples(corner)
            bulge = np.linalg.norm(forward(model, rows[:, 0])[:, :3, 3] - center, axis=1).max()
            if bulge <= r * (1.0 + 1e-9):
                break
            corner = Corner(before, after, _SHRINK * corner.left, _SHRINK * corner.taken)
        corners.append(corner)
    return corners


def guided(corner: Corner) -> Corner:
    """The blend with joints to follow where both legs are lines of the same tool.

    Raises:
        TwinError: the arm cannot follow it.
    """
    before, after = corner.before.way, corner.after.way
    if not (isinstance(before, Line) and isinstance(after, Line) and np.array_equal(before.X_FT, after.X_FT)):
        return corner
    share = np.linspace(0.0, 1.0, _BLEND_POINTS)
    zero = np.zeros_like(share)
    x, y = corner.left * (1.0 - share) ** 2, corner.taken * share**2
    X, _, _ = _summed_lines(before, after, (x, zero, zero), (y, zero, zero))
    entry = interpolate(before.guide_x, before.guide_q, np.array([before.length - corner.left]))[0]
    guide = track(before.model, X @ np.linalg.inv(after.X_FT), entry, lambda k: corner.where())
    return Corner(corner.before, corner.after, corner.left, corner.taken, guide)


def _summed_lines(
    before: Line, after: Line, left: tuple[np.ndarray, ...], taken: tuple[np.ndarray, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pose (n, 4, 4), twist and its derivative (n, 6) of two lines' sum from the corner (p_c, R_c).

    p = p_c - d_A x + d_B y, R = exp(S(n_B y)) exp(S(-n_A x)) R_c with x left of the former line, y taken of the next.
    """
    (x, xd, xdd), (y, yd, ydd) = left, taken
    corner = after.X_start
    (d_A, n_A), (d_B, n_B) = np.split(before.slope, 2), np.split(after.slope, 2)
    E = spatial.rotation_from_vector(np.outer(y, n_B))
    R = E @ spatial.rotation_from_vector(np.outer(-x, n_A)) @ corner[:3, :3]
    p = corner[:3, 3] - np.outer(x, d_A) + np.outer(y, d_B)
    turned = E @ n_A
    own, carried = np.outer(yd, n_B), -xd[:, None] * turned
    twist = np.concatenate([np.outer(yd, d_B) - np.outer(xd, d_A), own + carried], axis=1)
    spin = np.outer(ydd, n_B) - xdd[:, None] * turned + np.cross(own, carried)
    change = np.concatenate([np.outer(ydd, d_B) - np.outer(xdd, d_A), spin], axis=1)
    return spatial.pose(R, p), twist, change


def _samples(corner: Corner) -> np.ndarray:
    """(n, 3, 6) rows of a blend at full speed."""
    return corner.rows(np.linspace(0.0, corner.full_time, _BLEND_POINTS), corner.full_time)


def _tempos(model: ArmModel, legs: list[Leg], corners: list[Corner]) -> np.ndarray:
    """(m + 1,) the share of the legs' full speeds with which each corner is passed; 0 at both ends.

    Of a blend passed at a share, speeds go with the share and accelerations with its square.
    """
    tempo = np.zeros(len(legs) + 1)
    for k, corner in enumerate(corners, start=1):
        rows = _samples(corner)
        peaks = np.abs(rows[:, 1:]).max(axis=0)
        shares = [1.0, *(model.limits.qd / np.maximum(peaks[0], 1e-12))]
        squares = [*(model.limits.qdd / np.maximum(peaks[1], 1e-12))]
        both = (corner.before, corner.after)
        joint = [one.a for one in both if isinstance(one.way, JointLine)]
        flange = [one.a for one in both if isinstance(one.way, Line)]
        if joint:
            squares.append(min(joint) / max(peaks[1].max(), 1e-12))
        if flange:
            change = flange_acceleration(model, rows[:, 0], rows[:, 1], rows[:, 2]).reshape(-1, 2, 3)
            squares.append(min(flange) / max(np.linalg.norm(change, axis=-1).max(), 1e-12))
        tempo[k] = min(*shares, np.sqrt(min(squares)))
    # What a leg's acceleration allows between its two corners, forwards and then backwards.
    gains = [2.0 * one.a * _free(k, legs, corners) / one.v**2 for k, one in enumerate(legs)]
    for k, gain in enumerate(gains):
        tempo[k + 1] = min(tempo[k + 1], np.sqrt(tempo[k] ** 2 + gain))
    for k, gain in reversed(list(enumerate(gains))):
        tempo[k] = min(tempo[k], np.sqrt(tempo[k + 1] ** 2 + gain))
    return tempo


def _free(k: int, legs: list[Leg], corners: list[Corner]) -> float:
    """What blends leave of a leg."""
    return legs[k].way.length - _head(k, corners) - (corners[k].left if k < len(corners) else 0.0)


def _head(k: int, corners: list[Corner]) -> float:
    """What the blend before a leg takes of it."""
    return corners[k - 1].taken if k > 0 else 0.0


def _timed(model: ArmModel, legs: list[Leg], corners: list[Corner], tempo: np.ndarray, period: float) -> Path:
    """The rows at each tick: legs and blends in turn."""
    laws = [
        Trapezoid(_free(k, legs, corners), one.v, one.a, tempo[k] * one.v, tempo[k + 1] * one.v)
        for k, one in enumerate(legs)
    ]
    blend_times = [corner.full_time / share for corner, share in zip(corners, tempo[1:-1], strict=True)]
    # Each leg is followed by its blend, the last one by nothing.
    ends = np.cumsum(np.array([[law.duration, blend] for law, blend in zip(laws, [*blend_times, 0.0], strict=True)]))
    total = float(ends[-1])
    t = np.arange(ticks(total, period) + 1) * period
    piece = np.minimum(np.searchsorted(ends, t, side="right"), 2 * len(legs) - 2)
    rows = np.empty((len(t), 3, 6))
    for k in range(2 * len(legs) - 1):
        here = np.flatnonzero(piece == k)
        if not here.size:
            continue
        local = t[here] - (ends[k - 1] if k else 0.0)
        number, in_blend = divmod(k, 2)
        if in_blend:
            corner = corners[number]
            part = corner.rows(local, blend_times[number])
            task = isinstance(corner.before.way, Line) or isinstance(corner.after.way, Line)
            where = partial(_in_blend, corner)
        else:
            way = legs[number].way
            x, xd, xdd = laws[number].at(local)
            x = x + _head(number, corners)
            part = way.rows(x, xd, xdd)
            task = isinstance(way, Line)
            where = partial(_on_way, way, x)
        (partial(check_line, model, part, period) if task else partial(check_rows, model.limits, part))(where)
        rows[here] = part
    rows[-1] = still(legs[-1].way.goal, 1)[0]
    middles = ends[1:-1:2] - 0.5 * np.array(blend_times)
    return Path(rows, np.concatenate([[0.0], middles, [total]]))


def _in_blend(corner: Corner, row: int) -> str:
    return corner.where()


def _on_way(way: JointLine | Line | Arc, x: np.ndarray, row: int) -> str:
    return way.where(x[row])
