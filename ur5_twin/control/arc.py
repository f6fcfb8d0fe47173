"""Circular ways of a tool: movec."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ur5_twin import spatial
from ur5_twin.arm.kinematics import forward
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.control.cartesian import flange_motion, interpolate, joint_rows, points, track
from ur5_twin.errors import TwinError

#: A triangle of three points that is this flat, its height over its longest side, is no circle.
_FLAT = 1e-4
#: Points nearer to each other are one, m.
_SAME = 1e-6


@dataclass(frozen=True)
class Arc:
    """A circular way of a tool, by path coordinate x.

    p = c + exp(S(k phi x / L)) (p_0 - c) and R = exp(S(n x / L)) R_0 with the circle's centre c, axis k and angle phi
    and n the rotation vector from R_0 to R_1 in base axes. L = max(|p_0 - c| phi, |n| 1 m/rad), as for
    ``cartesian.Line``. A tool that turns with the circle has n = k phi and L = |p_0 - c| phi.

    Attributes:
        model: the arm.
        X_start: (4, 4) pose of the tool at x = 0.
        center: (3,) c, m.
        sweep: (3,) k phi, rad.
        turn: (3,) n, rad.
        length: L, m.
        guide_x, guide_q: (m,), (m, 6) the joints at some points of the way, continuous from its start.
        name: of the command, for messages.
        X_FT: (4, 4) pose of the tool in the flange.
    """

    model: ArmModel
    X_start: np.ndarray
    center: np.ndarray
    sweep: np.ndarray
    turn: np.ndarray
    length: float
    guide_x: np.ndarray
    guide_q: np.ndarray
    name: str
    X_FT: np.ndarray

    @property
    def goal(self) -> np.ndarray:
        """(6,) joint position at the end, rad."""
        return self.guide_q[-1]

    def poses(self, x: np.ndarray) -> np.ndarray:
        """X_BT (n, 4, 4) at path coordinates x (n,)."""
        return _along(self.X_start, self.center, self.sweep, self.turn, x / self.length)

    def rows(self, x: np.ndarray, xd: np.ndarray, xdd: np.ndarray) -> np.ndarray:
        """(n, 3, 6) q, qd, qdd at path coordinates (n,), their rates and accelerations.

        v = w x (p - c), a = w' x (p - c) + w x v with w = k phi xd / L.

        Raises:
            TwinError: the arm is singular there.
        """
        X_BT = self.poses(x)
        rate, change = xd[:, None] / self.length, xdd[:, None] / self.length
        out = X_BT[:, :3, 3] - self.center
        w = rate * self.sweep
        v = spatial.cross(w, out)
        a = spatial.cross(change * self.sweep, out) + spatial.cross(w, v)
        twist = np.concatenate([v, rate * self.turn], axis=1)
        acceleration = np.concatenate([a, change * self.turn], axis=1)
        near = interpolate(self.guide_x, self.guide_q, x)
        flange = flange_motion(self.X_FT, X_BT, twist, acceleration)
        return joint_rows(self.model, *flange, near, lambda k: self.where(x[k]))

    def where(self, x: float) -> str:
        """Words for a place on the way."""
        return f"{self.name} at s = {x / self.length:.3f} of the circle"

    def within(self, r: float) -> float:
        """Path coordinate left where the tool is r from its goal, m; inf if it is never farther."""
        radius = float(np.linalg.norm(self.X_start[:3, 3] - self.center))
        if r >= 2.0 * radius:
            return np.inf
        return 2.0 * float(np.arcsin(r / (2.0 * radius)) / np.linalg.norm(self.sweep)) * self.length


def arc(
    model: ArmModel,
    q_start: np.ndarray,
    via: np.ndarray,
    X_goal: np.ndarray,
    step: float,
    X_FT: np.ndarray,
    *,
    turns_with: bool = False,
    name: str = "movec",
) -> Arc:
    """The circle's arc from a joint position through a point to a pose.

    Args:
        model: the arm.
        q_start: (6,), rad.
        via: (3,) a point of the tool between start and goal, m.
        X_goal: (4, 4) pose of the tool in the base.
        step: m, about the distance of the points at which the joints are followed.
        X_FT: (4, 4) the tool in the flange.
        turns_with: the tool keeps its orientation to the circle's tangent; the goal's does not count.
        name: of the command, for messages.

    Raises:
        TwinError: the three points are on one line; the way leaves the arm's reach, passes a singularity or a joint's
            limit.
    """
    X_start = forward(model, q_start) @ X_FT
    p, end = X_start[:3, 3], X_goal[:3, 3]
    center, sweep = _circle(p, via, end, name)
    turn = sweep if turns_with else spatial.vector_from_rotation(X_goal[:3, :3] @ X_start[:3, :3].T)
    length = float(np.linalg.norm(p - center) * np.linalg.norm(sweep))
    if not turns_with:
        length = max(length, float(np.linalg.norm(turn)))
    s = np.linspace(0.0, 1.0, points(length / step))
    X = _along(X_start, center, sweep, turn, s) @ np.linalg.inv(X_FT)
    guide = track(model, X, q_start, lambda k: f"{name} at s = {s[k]:.3f} of the circle")
    return Arc(model, X_start, center, sweep, turn, length, length * s, guide, name, X_FT)


def _circle(p: np.ndarray, via: np.ndarray, end: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Centre (3,) of the circle through three points, and k phi (3,) from the first through the second to the third."""
    sides = np.array([via - p, end - via, end - p])
    sizes = np.linalg.norm(sides, axis=1)
    normal = np.cross(sides[0], sides[1])
    area = float(np.linalg.norm(normal))
    if sizes.min() < _SAME or area < _FLAT * sizes.max() ** 2:
        raise TwinError(
            f"{name}: where the tool is, the point between and the goal are on one line or one point; use movel"
        )
    # The circumcentre, from the second point.
    a, b = p - via, end - via
    center = via + np.cross((a @ a) * b - (b @ b) * a, np.cross(a, b)) / (2.0 * area**2)
    axis = normal / area
    out, last = p - center, end - center
    angle = np.arctan2(axis @ np.cross(out, last), out @ last) % (2.0 * np.pi)
    return center, axis * angle


def _along(X_start: np.ndarray, center: np.ndarray, sweep: np.ndarray, turn: np.ndarray, s: np.ndarray) -> np.ndarray:
    """(n, 4, 4) poses at shares s (n,) of an arc."""
    p = center + spatial.rotation_from_vector(np.outer(s, sweep)) @ (X_start[:3, 3] - center)
    return spatial.pose(spatial.rotation_from_vector(np.outer(s, turn)) @ X_start[:3, :3], p)
