"""Where the arm may be while it is identified: joints, a box for flange and tool, heights, and clear of itself.

Distances are between the geoms of the arm's own MuJoCo model on its stand, which are cylinders a little larger than the
links; pairs of neighbours, which share a joint, are not looked at, and the elbow stays unfolded instead.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from ur5_twin.arm import kinematics, mjcf
from ur5_twin.arm.parameters import JOINT_NAMES, ArmModel, Box, Sphere, Tool
from ur5_twin.errors import IdentificationError
from ur5_twin.twin.setup import carrying

#: Further folded, forearm and upper arm come close in a way that no pair of geoms tells, rad.
_ELBOW = 2.6
#: Where the arm stands if nobody says: bent, each joint in the middle of its range, rad.
START = np.radians([-5.0, -113.0, -67.0, 90.0, -90.0, 85.0])
#: kg/m^3 of the steel ball that a carried weight is drawn as.
_STEEL = 7800.0
#: Joint steps between two postures that are looked at on a way, rad. At the finer one the wrist's parts come nearer to
#: the forearm by 5 mm at most from one to the next; the coarser one refuses most ways sooner.
_FINE, _COARSE = 0.03, 0.12


@dataclass(frozen=True)
class Bounds:
    """What the arm keeps to.

    Attributes:
        low, high: (6,) joint positions, rad.
        box: (3, 2) least and greatest x, y, z of the flange and of the tool's end in the base frame, m; infinite where
            there is no wall.
        height: that forearm, wrist and tool keep over the base's plane, m.
        clearance: between parts of the arm, and to the stand, m.
        speed: rad/s of every joint.
        acceleration: rad/s^2 of every joint.
    """

    low: np.ndarray
    high: np.ndarray
    box: np.ndarray
    height: float
    clearance: float
    speed: float
    acceleration: float

    def __post_init__(self) -> None:
        for name, value, unit in (("speed", self.speed, "rad/s"), ("acceleration", self.acceleration, "rad/s^2")):
            if not 0 < value < np.inf:
                raise IdentificationError(f"the {name} limit is {value:g} {unit}; it must be positive")
        if not (self.box[:, 0] < self.box[:, 1]).all():
            raise IdentificationError(
                "the box has no room: give least and greatest x, y and z in this order, each least below its greatest"
            )

    def tightened(self, margin: float) -> Bounds:
        """The same with walls and distances ``margin`` m stricter."""
        box = self.box + np.array([margin, -margin])
        return replace(self, box=box, height=self.height + margin, clearance=self.clearance + margin)


def joint_bounds(model: ArmModel, q_start: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions (6,) within ``reach`` rad of the start, within the arm's limits and with the elbow unfolded."""
    limit = model.limits.q.copy()
    limit[2] = min(limit[2], _ELBOW)
    return np.maximum(q_start - reach, -limit), np.minimum(q_start + reach, limit)


class Workspace:
    """The postures that are allowed.

    Args:
        plant: the arm with what is on its flange; a tool without parts counts as a steel ball at its mass centre.
        bounds: what it keeps to.

    Attributes:
        plant, bounds: as given.
        ends: (3,) each, in the flange frame, m: what ``points`` follows.
    """

    def __init__(self, plant: ArmModel, bounds: Bounds) -> None:
        self.bounds = bounds
        self.plant = plant
        self.ends = _ends(plant.tool)
        # Whoever keeps above the base's plane does not come to what is below it.
        self._model = mjcf.compile(plant, scene=bounds.height < 0.0)
        self._data = mujoco.MjData(self._model)
        bodies = [self._model.body(i).name for i in self._model.geom_bodyid]
        touches = self._model.geom_contype != 0
        self._model.geom_margin[:] = np.where(touches, bounds.clearance + 0.01, 0.0)
        # Shoulder and upper arm stand beside the base whatever the joints do.
        high = (*mjcf.BODY_NAMES[2:], "tool")
        self._high = np.flatnonzero(touches & np.array([body in high for body in bodies]))
        self._bodies = bodies

    def problem(self, q: np.ndarray) -> str | None:
        """What is wrong with the first of postures (n, 6) that is not allowed; None if all are."""
        outside = (q < self.bounds.low - 1e-9) | (q > self.bounds.high + 1e-9)
        if outside.any():
            row, j = np.argwhere(outside)[0]
            low, high = self.bounds.low[j], self.bounds.high[j]
            return f"{JOINT_NAMES[j]} at {q[row, j]:.3f} rad, outside {low:.3f} to {high:.3f}"
        for name, points in zip(("flange", "tool's end"), self.points(q), strict=False):
            beyond = (points < self.bounds.box[:, 0]) | (points > self.bounds.box[:, 1])
            if beyond.any():
                row, axis = np.argwhere(beyond)[0]
                least, greatest = self.bounds.box[axis]
                return (
                    f"the {name} at {'xyz'[axis]} = {1e3 * points[row, axis]:.0f} mm, outside {1e3 * least:.0f} to "
                    f"{1e3 * greatest:.0f} mm"
                )
        return next(filter(None, map(self._near, q)), None)

    def way_problem(self, start: np.ndarray, end: np.ndarray) -> str | None:
        """What is wrong on the straight way in joint space from one posture (6,) to another; None if nothing is."""
        longest = np.abs(end - start).max()
        for step in (_COARSE, _FINE):
            x = np.linspace(1.0, 0.0, max(2, int(np.ceil(longest / step)) + 1))
            problem = self.problem(start + x[:, None] * (end - start))
            if problem is not None:
                return problem
        return None

    def points(self, q: np.ndarray) -> list[np.ndarray]:
        """Positions (n, 3) of the flange and, with a tool, of its end in the base frame, m."""
        X_BF = kinematics.forward(self.plant, q)
        return [X_BF[:, :3, 3] + X_BF[:, :3, :3] @ end for end in self.ends]

    def _near(self, q: np.ndarray) -> str | None:
        """What comes too near to what in a posture (6,)."""
        model, data = self._model, self._data
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        if data.ncon:
            # One look at all of them: the contacts one by one would take longer than finding them.
            distance = data.contact.dist
            nearest = int(np.argmin(distance))
            if distance[nearest] < self.bounds.clearance:
                first, second = (self._bodies[geom] for geom in data.contact.geom[nearest])
                return (
                    f"{first} and {second} {1e3 * distance[nearest]:.0f} mm apart, less than "
                    f"{1e3 * self.bounds.clearance:.0f} mm"
                )
        low = self._heights()
        if low.min() < self.bounds.height:
            geom = self._high[int(np.argmin(low))]
            return (
                f"{self._bodies[geom]} at a height of {1e3 * low.min():.0f} mm over the base's plane, less than "
                f"{1e3 * self.bounds.height:.0f} mm"
            )
        return None

    def _heights(self) -> np.ndarray:
        """Heights of the lowest points of forearm, wrist and tool over the base's plane, m."""
        model, data, geoms = self._model, self._data, self._high
        down = np.abs(data.geom_xmat[geoms].reshape(-1, 3, 3)[:, 2])
        size, kind = model.geom_size[geoms], model.geom_type[geoms]
        cylinder = down[:, 2] * size[:, 1] + np.sqrt(np.maximum(1.0 - down[:, 2] ** 2, 0.0)) * size[:, 0]
        box = (down * size).sum(axis=1)
        extent = np.where(kind == mujoco.mjtGeom.mjGEOM_BOX, box, cylinder)
        extent = np.where(kind == mujoco.mjtGeom.mjGEOM_SPHERE, size[:, 0], extent)
        return data.geom_xpos[geoms, 2] - extent


def with_weight(model: ArmModel, mass: float, center: np.ndarray, *, seen: bool) -> ArmModel:
    """The arm with a homogeneous steel ball at its flange, beside its tool: kg, (3,) m in the flange frame.

    Args:
        model: the arm.
        mass: of the ball.
        center: of the ball.
        seen: whether it is among the tool's parts, which can touch.
    """
    ball = Sphere("weight", mass, ball_radius(mass), np.asarray(center, dtype=float))
    loaded = carrying(model, mass, ball.center, ball.inertia())
    assert loaded.tool is not None
    parts = model.tool.parts if model.tool is not None else ()
    return loaded.with_tool(replace(loaded.tool, parts=(*parts, ball) if seen else parts))


def ball_radius(mass: float) -> float:
    """Radius of a steel ball, m."""
    return float((3.0 * mass / (4.0 * np.pi * _STEEL)) ** (1.0 / 3.0))


def _ends(tool: Tool | None) -> list[np.ndarray]:
    """The flange's origin, and the end of what is on it along the flange's axis."""
    ends = [np.zeros(3)]
    if tool is not None and tool.parts:
        ends.append(np.array([0.0, 0.0, max(_top(part) for part in tool.parts)]))
    return ends


def _top(part: object) -> float:
    if isinstance(part, Box):
        return float(part.center[2] + part.size[2] / 2)
    if isinstance(part, Sphere):
        return float(part.center[2] + part.radius)
    return float(part.center[2] + part.height / 2)  # type: ignore[attr-defined]
