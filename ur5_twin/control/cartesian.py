"""Straight lines of the flange or of a tool on it: movel, and joint motions from motions of the flange."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ur5_twin import spatial
from ur5_twin.arm.inverse_kinematics import solve
from ur5_twin.arm.kinematics import forward, jacobian, jacobian_dot
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.arm.singularities import determinant, distances
from ur5_twin.control.limits import check_position, check_rows
from ur5_twin.control.profile import Trapezoid, ticks
from ur5_twin.control.trajectory import require_positive, still
from ur5_twin.errors import TwinError

#: Joints that turn this much from one point of a line to the next have left the line's branch, rad.
_JUMP = 0.5
#: |det J| below this is a singular position, m^3; a usual one has 0.01 to 0.1.
_SINGULAR = 1e-9
#: Points at which a path's joints are followed: these at least, and no more than these.
_POINTS = (65, 5001)

Where = Callable[[int], str]


@dataclass(frozen=True)
class Line:
    """A straight way of a tool with its orientation along the geodesic, by path coordinate x.

    p = p_0 + d x / L and R = exp(S(n x / L)) R_0 with d the displacement, n the rotation vector from R_0 to R_1 in base
    axes, and L = max(|d|, |n| 1 m/rad): 1 rad counts as 1 m, and the longer of the two rules the time.

    Attributes:
        model: the arm.
        X_start: (4, 4) pose of the tool at x = 0.
        slope: (6,) [d; n] / L.
        length: L, m.
        guide_x, guide_q: (m,), (m, 6) the joints at some points of the line, continuous from its start.
        name: of the command, for messages.
        X_FT: (4, 4) pose of the tool in the flange; the flange itself by default.
    """

    model: ArmModel
    X_start: np.ndarray
    slope: np.ndarray
    length: float
    guide_x: np.ndarray
    guide_q: np.ndarray
    name: str
    X_FT: np.ndarray = field(default_factory=lambda: np.eye(4))

    @property
    def goal(self) -> np.ndarray:
        """(6,) joint position at the end of the line, rad."""
        return self.guide_q[-1]

    def poses(self, x: np.ndarray) -> np.ndarray:
        """X_BT (n, 4, 4) at path coordinates x (n,)."""
        return _along(self.X_start, self.slope, x)

    def rows(self, x: np.ndarray, xd: np.ndarray, xdd: np.ndarray) -> np.ndarray:
        """(n, 3, 6) q, qd, qdd at path coordinates (n,), their rates and accelerations.

        Raises:
            TwinError: the arm is singular there.
        """
        twist, acceleration = np.outer(xd, self.slope), np.outer(xdd, self.slope)
        near = interpolate(self.guide_x, self.guide_q, x)
        flange = flange_motion(self.X_FT, self.poses(x), twist, acceleration)
        return joint_rows(self.model, *flange, near, lambda k: self.where(x[k]))

    def where(self, x: float) -> str:
        """Words for a place on the line."""
        return f"{self.name} at s = {x / self.length:.3f} of the line"


def line(
    model: ArmModel,
    q_start: np.ndarray,
    X_goal: np.ndarray,
    step: float,
    name: str = "movel",
    X_FT: np.ndarray | None = None,
) -> Line | None:
    """The line from a joint position to a pose.

    Args:
        model: the arm.
        q_start: (6,), rad.
        X_goal: (4, 4) pose of the tool in the base.
        step: m (or rad), about the distance of the points at which the joints are followed.
        name: of the command, for messages.
        X_FT: (4, 4) the tool in the flange, by default the flange itself.

    Returns:
        The line, None if the tool is there already (within 1e-12 m and rad).

    Raises:
        TwinError: the line leaves the arm's reach, passes a singularity or a joint's limit.
    """
    X_FT = np.eye(4) if X_FT is None else X_FT
    X_start = forward(model, q_start) @ X_FT
    displacement = X_goal[:3, 3] - X_start[:3, 3]
    turn = spatial.vector_from_rotation(X_goal[:3, :3] @ X_start[:3, :3].T)
    length = float(max(np.linalg.norm(displacement), np.linalg.norm(turn)))
    if length < 1e-12:
        return None
    slope = np.concatenate([displacement, turn]) / length
    x = np.linspace(0.0, length, points(length / step))

    def where(k: int) -> str:
        return f"{name} at s = {x[k] / length:.3f} of the line"

    guide = track(model, _along(X_start, slope, x) @ np.linalg.inv(X_FT), q_start, where)
    return Line(model, X_start, slope, length, x, guide, name, X_FT)


def movel(
    model: ArmModel,
    q_start: ArrayLike,
    X_goal: ArrayLike,
    *,
    speed: float = 0.25,
    acceleration: float = 1.2,
    period: float,
) -> np.ndarray:
    """A movel: the flange goes straight, its orientation along the geodesic, with a trapezoidal speed.

    The way is the distance in m, or the angle in rad where that is the greater number: a pure rotation takes ``speed``
    in rad/s and ``acceleration`` in rad/s^2. Joints follow from the closed-form inverse kinematics, on the branch of
    ``q_start``: qd = J^-1 V, qdd = J^-1 (V' - J' qd). Speed and acceleration default to URScript's.

    Args:
        model: the arm with its limits.
        q_start: (6,), rad.
        X_goal: (4, 4) pose of the flange in the base.
        speed: along the line, m/s.
        acceleration: along the line, m/s^2.
        period: tick, s.

    Returns:
        (n, 3, 6) q, qd, qdd at 0, period, 2 period, ... up to and including rest at the goal.

    Raises:
        TwinError: a number is not positive, the line leaves the arm's reach, comes so near to a singularity that a
            joint would exceed its speed or acceleration, or leaves a joint's limits; the message says where.
    """
    require_positive("movel", speed=speed, acceleration=acceleration, period=period)
    q_start = np.asarray(q_start, dtype=float)
    way = line(model, q_start, np.asarray(X_goal, dtype=float), speed * period)
    if way is None:
        return still(q_start, 1)
    law = Trapezoid(way.length, speed, acceleration)
    x, xd, xdd = law.at(np.arange(ticks(law.duration, period) + 1) * period)
    rows = way.rows(x, xd, xdd)
    check_line(model, rows, period, lambda k: way.where(x[k]))
    rows[-1] = still(way.goal, 1)[0]
    return rows


def check_line(model: ArmModel, rows: np.ndarray, period: float, where: Where) -> None:
    """Refuse joint rows (n, 3, 6) of a flange motion beyond the joints' limits, saying which singularity is near.

    Raises:
        TwinError: names the place, the joint, its value, its limit and the nearest singularity.
    """

    def where_and_why(k: int) -> str:
        return f"{where(k)}, {nearest_singularity(model, rows[k, 0])}"

    check_rows(model.limits, rows, where_and_why)
    # A singularity between two ticks shows in neither's speed but in what lies between them.
    steps = np.zeros_like(rows)
    steps[1:, 1] = np.diff(rows[:, 0], axis=0) / period
    check_rows(model.limits, steps, where_and_why)


def track(model: ArmModel, X_BF: np.ndarray, q_start: np.ndarray, where: Where) -> np.ndarray:
    """Joints (n, 6) that follow poses (n, 4, 4) without a jump, from the branch of q_start (6,).

    Raises:
        TwinError: a pose is out of reach, the joints jump (a singularity) or leave their limits.
    """
    solutions = solve(model, X_BF, q6_hint=q_start[5])
    reached = solutions.valid.any(axis=-1)
    if not reached.all():
        raise TwinError(f"{where(int(np.argmin(reached)))}: the flange pose is out of the arm's reach")
    q = np.empty((len(X_BF), 6))
    near = q_start
    for k, candidates in enumerate(solutions.q):
        q[k] = _closest(candidates, near)
        if np.abs(q[k] - near).max() > _JUMP:
            raise TwinError(f"{where(k)}: the line passes a singularity, {nearest_singularity(model, near)}")
        check_position(model.limits, q[k], where(k))
        near = q[k]
    return q


def flange_motion(
    X_FT: np.ndarray, X_BT: np.ndarray, twist: np.ndarray, acceleration: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pose, twist and its derivative of the flange when a tool on it moves; with r from the tool to the flange

        v_F = v_T + omega x r,    a_F = a_T + alpha x r + omega x (omega x r).

    Args:
        X_FT: (4, 4) pose of the tool in the flange.
        X_BT: (n, 4, 4) poses of the tool in the base.
        twist: (n, 6) [v_T; omega], m/s and rad/s, base axes.
        acceleration: (n, 6) [a_T; alpha], m/s^2 and rad/s^2.

    Returns:
        X_BF (n, 4, 4), twist (n, 6), acceleration (n, 6).
    """
    X_BF = X_BT @ np.linalg.inv(X_FT)
    r = X_BF[:, :3, 3] - X_BT[:, :3, 3]
    omega, alpha = twist[:, 3:], acceleration[:, 3:]
    carried = spatial.cross(omega, r)
    v = twist[:, :3] + carried
    a = acceleration[:, :3] + spatial.cross(alpha, r) + spatial.cross(omega, carried)
    return X_BF, np.concatenate([v, omega], axis=1), np.concatenate([a, alpha], axis=1)


def joint_rows(
    model: ArmModel, X_BF: np.ndarray, twist: np.ndarray, acceleration: np.ndarray, q_near: np.ndarray, where: Where
) -> np.ndarray:
    """Joint motion of a flange motion: q by inverse kinematics, qd = J^-1 V, qdd = J^-1 (V' - J' qd).

    Args:
        model: the arm.
        X_BF: (n, 4, 4) poses of the flange in the base.
        twist: (n, 6) V, m/s and rad/s, base axes.
        acceleration: (n, 6) V', m/s^2 and rad/s^2.
        q_near: (n, 6) roughly where the joints are, rad: of all solutions the nearest one is taken.
        where: words for a row's index.

    Returns:
        (n, 3, 6) q, qd, qdd.

    Raises:
        TwinError: a pose is out of reach or singular.
    """
    solutions = solve(model, X_BF, q6_hint=q_near[:, 5])
    reached = solutions.valid.any(axis=-1)
    if not reached.all():
        raise TwinError(f"{where(int(np.argmin(reached)))}: the flange pose is out of the arm's reach")
    q = _closest(solutions.q, q_near)
    singular = np.abs(determinant(model, q)) < _SINGULAR
    if singular.any():
        k = int(np.argmax(singular))
        raise TwinError(f"{where(k)}: the arm is singular, {nearest_singularity(model, q[k])}")
    J = jacobian(model, q)
    qd = np.linalg.solve(J, twist[..., None])[..., 0]
    bias = (jacobian_dot(model, q, qd) @ qd[..., None])[..., 0]
    qdd = np.linalg.solve(J, (acceleration - bias)[..., None])[..., 0]
    return np.stack([q, qd, qdd], axis=1)


def nearest_singularity(model: ArmModel, q: np.ndarray) -> str:
    """Words for the singularity that a joint position (6,) is nearest to, and how near."""
    d = distances(model, q)
    near = {"shoulder": (d.shoulder, "m"), "elbow": (d.elbow, "rad"), "wrist": (d.wrist, "rad")}
    name = min(near, key=lambda family: abs(float(near[family][0])))
    value, unit = near[name]
    return f"{abs(float(value)):.2g} {unit} from the {name} singularity"


def points(steps: float) -> int:
    """How many points follow a path whose length is this many steps."""
    low, high = _POINTS
    return int(np.clip(np.ceil(steps) + 1 if np.isfinite(steps) else high, low, high))


def interpolate(guide_x: np.ndarray, guide: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(n, 6) the guide (m, 6) at coordinates x (n,), linear between its points."""
    return np.stack([np.interp(x, guide_x, column) for column in guide.T], axis=-1)


def _along(X_start: np.ndarray, slope: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(n, 4, 4) poses at coordinates x (n,) of a line that starts at X_start (4, 4) with slope (6,)."""
    R = spatial.rotation_from_vector(np.outer(x, slope[3:])) @ X_start[:3, :3]
    return spatial.pose(R, X_start[:3, 3] + np.outer(x, slope[:3]))


def _closest(candidates: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Of solutions (..., 8, 6), with whole turns added, the one (..., 6) whose farthest joint is nearest to near."""
    near = near[..., None, :]
    q = candidates + 2.0 * np.pi * np.rint((near - candidates) / (2.0 * np.pi))
    distance = np.abs(q - near).max(axis=-1)
    best = np.argmin(np.where(np.isnan(distance), np.inf, distance), axis=-1)
    return np.take_along_axis(q, best[..., None, None], axis=-2)[..., 0, :]
