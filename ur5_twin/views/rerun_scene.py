"""The 3D part of the Rerun view: the arms in their real cylinders, the flange's path, obstacles, arrows for forces.

Every link is an entity whose pose in the base is sent by columns; what it looks like hangs below it and is sent once.
Needs ``rerun``; import it through ``rerun_view``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from ur5_twin.arm import kinematics
from ur5_twin.arm.mjcf import Obstacle, looks
from ur5_twin.arm.parameters import N_JOINTS, ArmModel, Box, Cylinder, Part, Sphere
from ur5_twin.evaluation import contacts
from ur5_twin.recording.table import Recording, Table
from ur5_twin.views.style import LEAST_FORCE, MEASURED, TRUTH, TRUTH_TOO, TWIN, has, rgb
from ur5_twin.views.wrenches import Wrench

ROOT = "scene"
#: Poses and arrows a second: as smooth as a film, a fifth of the robot's rows.
FRAME_RATE = 25.0
FLOOR_Z = -0.72
_NAME_Z = -0.3
#: Length of an arrow, m per N.
ARROW_SCALE = 0.006
#: Radius of an arrow's shaft, m, at the flange, and at a contact.
_ARROW_RADIUS, _CONTACT_RADIUS = 0.009, 0.011

#: The eye is turned from where the arm points by this angle about the vertical, and looks down with this slope.
_ASIDE = np.radians(68.0)
_FROM_ABOVE = 0.33
#: Distance of the eye for each metre of a point right and up of the picture's middle, by the viewer's angle of view.
_EYE_DISTANCE = np.array([1.85, 2.05])

#: How far from the base an obstacle is shown, m: a little more than the arm reaches.
_REACH = 1.1

_ALUMINIUM = (205, 208, 213)
_STEEL = (120, 123, 128)
_STAND = (74, 80, 88)
_WOOD = (172, 128, 82)
_GHOST_OPACITY = 90
#: How much thicker a ghost is drawn, m: where it coincides with the twin it lies over it like a skin.
_GHOST_SKIN = 0.002
#: Quaternions x, y, z, w that turn a cylinder from z to the axis.
_ALONG = {"x": (0.0, 0.5**0.5, 0.0, 0.5**0.5), "y": (-(0.5**0.5), 0.0, 0.0, 0.5**0.5), "z": (0.0, 0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Arm:
    """One of the two arms: which column moves it, what it is called and its colour everywhere.

    A ghost is drawn translucent and beside the other.
    """

    key: str
    column: str
    label: str
    colour: str
    ghost: bool

    @property
    def path(self) -> str:
        return f"{ROOT}/{self.key}"


THE_TWIN = Arm("twin", "sim_actual_q", "twin", TWIN, ghost=False)
THE_ROBOT = Arm("measured", "actual_q", "measured", MEASURED, ghost=True)


@dataclass(frozen=True)
class Stage:
    """Where things stand.

    Attributes:
        beside: (3,) from the twin's base to the measured arm's, m; zero puts one into the other.
        eye: (3,) from where one looks, in the twin's base frame, m.
        target: (3,) at what.
    """

    beside: np.ndarray
    eye: np.ndarray
    target: np.ndarray

    @classmethod
    def facing(cls, p_BF: np.ndarray, *, overlaid: bool = False, obstacles: Sequence[Obstacle] = ()) -> Stage:
        """The stage on which a path is seen from the side, with the measured arm to the viewer's right.

        Args:
            p_BF: (n, 3) the flange's positions, m, rows with NaN allowed; none at all give the view along the base's y.
            overlaid: put the measured arm where the twin is, or there is only one.
            obstacles: what should be seen too, and not stand between the eye and the flange.
        """
        known = p_BF[np.isfinite(p_BF).all(axis=1)]
        ahead = known[:, :2].mean(axis=0) if len(known) else np.array([1.0, 0.0])
        straight = np.arctan2(ahead[1], ahead[0])
        # Of these ways to stand aside the first from which obstacles hide least of the path.
        sides = [straight + aside * _ASIDE for aside in (1.0, -1.0, 0.5, -0.5, 1.7, -1.7)]
        azimuth = min(sides, key=lambda side: _hidden(known, side, obstacles))
        # The viewer's axes: to the right, up, and from the picture to the eye.
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        back = np.array([np.cos(azimuth), np.sin(azimuth), _FROM_ABOVE]) / np.hypot(1.0, _FROM_ABOVE)
        axes = np.stack([right, np.cross(back, right), back])
        # Whatever the flange does, the shoulder, the elbow's height and the upper stand belong into the picture.
        always = np.array([[0.0, 0.0, 0.6], [0.0, 0.0, -0.4], *(0.22 * right * side for side in (-1, 1))])
        around = [_near(obstacle) for obstacle in obstacles]
        points = np.concatenate([known, always, *around]) @ axes.T
        gap = 0.0 if overlaid else float(np.clip(np.ptp(points[:, 0]) + 0.15, 0.8, 1.25))
        points = np.concatenate([points, points + np.array([gap, 0.0, 0.0])])
        middle = (points.max(axis=0) + points.min(axis=0))[:2] / 2
        far = float(np.max(np.abs(points[:, :2] - middle) * _EYE_DISTANCE + points[:, 2:]))
        target = middle @ axes[:2]
        return cls(beside=right * gap, eye=target + back * far, target=target)


def _near(obstacle: Obstacle) -> np.ndarray:
    """(8, 3) corners of the box around an obstacle in B, those out of reach brought to where the arm reaches."""
    corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3) * _edges(obstacle)
    placed = obstacle.center() + corners @ obstacle.pose[:3, :3].T
    return placed * np.minimum(1.0, _REACH / np.linalg.norm(placed, axis=1, keepdims=True))


def _edges(obstacle: Obstacle) -> np.ndarray:
    """(3,) edges of the box around an obstacle in its own axes, m."""
    if obstacle.shape == "sphere":
        return np.repeat(2.0 * obstacle.size, 3)
    if obstacle.shape == "cylinder":
        radius, height = obstacle.size
        return np.array([2.0 * radius, 2.0 * radius, height])
    return obstacle.size


def _hidden(p_BF: np.ndarray, azimuth: float, obstacles: Sequence[Obstacle]) -> int:
    """How many of some points of a path an obstacle hides from an eye far away in a direction.

    The ray from a point p along d is inside the obstacle's box where |p_i + s d_i| is at most half an edge for all i.
    """
    back = np.array([np.cos(azimuth), np.sin(azimuth), _FROM_ABOVE])
    some = p_BF[:: max(1, len(p_BF) // 200)]
    seen = np.ones(len(some), dtype=bool)
    for obstacle in obstacles:
        R = obstacle.pose[:3, :3]
        p, d = (some - obstacle.center()) @ R, back @ R
        d = np.where(np.abs(d) < 1e-9, 1e-9, d)
        ends = np.stack([(side * _edges(obstacle) / 2 - p) / d for side in (-1, 1)])
        enter, leave = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
        seen &= ~((enter <= leave) & (leave > 0))
    return int((~seen).sum())


def log_static(
    stream: rr.RecordingStream,
    model: ArmModel,
    arms: Sequence[Arm],
    stage: Stage,
    obstacles: Sequence[Obstacle] = (),
) -> None:
    """Send what never changes: the axes, the stands, the shapes of each arm's links, of the tool and of obstacles."""
    stream.log(ROOT, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for arm in arms:
        offset = stage.beside if arm.ghost else np.zeros(3)
        stream.log(arm.path, rr.Transform3D(translation=offset), static=True)
        _log_stand(stream, arm)
        if len(arms) > 1:
            _log_name(stream, arm, _NAME_Z - (0.0 if not arm.ghost or offset.any() else 0.12))
        for obstacle in obstacles:
            _log_obstacle(stream, f"{arm.path}/obstacles/{obstacle.name}", obstacle)
        for i in range(N_JOINTS):
            _log_cylinders(stream, f"{_link(arm, i)}/body", model.links[i].cylinders, _paint(arm, _ALUMINIUM))
            caps = _caps(model, i)
            if caps:
                _log_cylinders(stream, f"{_link(arm, i)}/caps", caps, _paint(arm, rgb(arm.colour)))
        if model.tool is not None:
            _log_parts(stream, f"{_link(arm, N_JOINTS - 1)}/tool", model.tool.parts, _paint(arm, _STEEL))
        stream.log(f"{_link(arm, N_JOINTS - 1)}/flange", rr.TransformAxes3D(0.12), static=True)


def log_paths(stream: rr.RecordingStream, model: ArmModel, arms: Sequence[Arm], table: Table) -> None:
    """Send each arm's whole path of the flange as one line, once: for a recording that has ended."""
    rows = frame_rows(table.time)
    for arm in arms:
        q = table[arm.column][rows]
        p_BF = kinematics.forward(model, q[np.isfinite(q).all(axis=1)])[:, :3, 3]
        line = rr.LineStrips3D([p_BF], radii=rr.Radius.ui_points(1.6), colors=[(*rgb(arm.colour), 200)])
        stream.log(f"{arm.path}/path", line, static=True)


def log_poses(
    stream: rr.RecordingStream, model: ArmModel, arms: Sequence[Arm], table: Table, ticks: np.ndarray
) -> None:
    """Send the links' poses in the base at 25 Hz; rows without a pose are left out, the arm stays where it was."""
    rows = frame_rows(table.time)
    for arm in arms:
        known = rows[np.isfinite(table[arm.column][rows]).all(axis=1)]
        if not len(known):
            continue
        frames = kinematics.link_frames(model, table[arm.column][known])[:, 1:]
        quaternions = Rotation.from_matrix(frames[..., :3, :3].reshape(-1, 3, 3)).as_quat().reshape(-1, N_JOINTS, 4)
        for i in range(N_JOINTS):
            columns = rr.Transform3D.columns(translation=frames[:, i, :3, 3], quaternion=quaternions[:, i])
            stream.send_columns(_link(arm, i), indexes(table.time[known], ticks[known]), columns, strict=True)


def log_arrows(
    stream: rr.RecordingStream, arm: Arm, X_BF: np.ndarray, wrenches: Sequence[Wrench], table: Table, ticks: np.ndarray
) -> None:
    """Send an arrow per force at an arm's flange at 25 Hz; none where the force is unknown or below 3 N."""
    rows = frame_rows(table.time)
    for wrench in wrenches:
        path = f"{arm.path}/force/{wrench.key}"
        force = wrench.values[rows, :3]
        shown = (np.linalg.norm(force, axis=1) >= LEAST_FORCE) & np.isfinite(X_BF[rows, :3, 3]).all(axis=1)
        style = rr.Arrows3D.from_fields(radii=[_ARROW_RADIUS], colors=[rgb(wrench.colour)])
        stream.log(path, style, static=True)
        columns = rr.Arrows3D.columns(vectors=force[shown] * ARROW_SCALE, origins=X_BF[rows[shown], :3, 3])
        lengths = shown.astype(np.int64)
        stream.send_columns(path, indexes(table.time[rows], ticks[rows]), columns.partition(lengths), strict=True)


def log_contacts(stream: rr.RecordingStream, arm: Arm, recording: Recording, ticks: np.ndarray) -> None:
    """Send an arrow per true force, of contacts and of pushes, at every tick at which any acts.

    An arrow begins at the point of contact, goes along the force on the arm and says its size in N. Contacts may be
    short, so no tick is left out; the tick after one clears its arrow, and so does the first row, of what came before.
    """
    table = recording.tables.get("contact")
    if table is None or not len(recording.robot):
        return
    known, rows = contacts.points(recording)
    time = recording.robot.time
    pushes = table["contact_obstacle"][known, 0] == contacts.PUSH
    for key, colour, mine in (("contact", TRUTH, ~pushes), ("push", TRUTH_TOO, pushes)):
        at = rows[mine]
        sent = np.unique([0, *at, *np.minimum(at + 1, len(time) - 1)])
        force, point = (table[f"contact_{name}"][known[mine]] for name in ("force", "point"))
        path = f"{arm.path}/force/{key}"
        style = rr.Arrows3D.from_fields(radii=[_CONTACT_RADIUS], colors=[rgb(colour)], show_labels=True)
        stream.log(path, style, static=True)
        labels = [f"{size:.0f} N" for size in np.linalg.norm(force, axis=1)]
        columns = rr.Arrows3D.columns(vectors=force * ARROW_SCALE, origins=point, labels=labels)
        lengths = np.bincount(np.searchsorted(sent, at), minlength=len(sent))
        stream.send_columns(path, indexes(time[sent], ticks[sent]), columns.partition(lengths), strict=True)


def frame_rows(time: np.ndarray) -> np.ndarray:
    """Rows at which a picture is due: the first of each 40 ms of the robot's clock."""
    frame = np.floor(time * FRAME_RATE + 1e-6)
    return np.flatnonzero(np.diff(frame, prepend=-np.inf) > 0)


def indexes(time: np.ndarray, ticks: np.ndarray) -> list[rr.TimeColumn]:
    """The two timelines: ``time``, seconds on the robot's clock, and ``tick``, the row of the log."""
    nanoseconds = np.round(time * 1e9).astype("timedelta64[ns]")
    return [rr.TimeColumn("time", duration=nanoseconds), rr.TimeColumn("tick", sequence=ticks)]


def _link(arm: Arm, i: int) -> str:
    return f"{arm.path}/link_{i + 1}"


def _paint(arm: Arm, colour: tuple[int, int, int]) -> tuple[int, int, int, int]:
    return (*rgb(arm.colour), _GHOST_OPACITY) if arm.ghost else (*colour, 255)


def _log_obstacle(stream: rr.RecordingStream, path: str, obstacle: Obstacle) -> None:
    """An obstacle as it is simulated, solid, where it stands."""
    placed = rr.Transform3D(translation=obstacle.center(), mat3x3=obstacle.pose[:3, :3])
    stream.log(path, placed, static=True)
    body = Box(obstacle.name, 0.0, obstacle.size, np.zeros(3))
    if obstacle.shape == "sphere":
        body = Sphere(obstacle.name, 0.0, float(obstacle.size[0]), np.zeros(3))
    elif obstacle.shape == "cylinder":
        body = Cylinder(obstacle.name, 0.0, float(obstacle.size[1]), float(obstacle.size[0]), "z", np.zeros(3))
    _log_parts(stream, path, [body], (*_WOOD, 255))


def _log_stand(stream: rr.RecordingStream, arm: Arm) -> None:
    foot = Cylinder("foot", 0.0, looks.BASE_HEIGHT, looks.BASE_RADIUS, "z", np.array([0, 0, looks.BASE_HEIGHT / 2]))
    column = Cylinder("column", 0.0, -FLOOR_Z - 0.04, 0.075, "z", np.array([0.0, 0.0, FLOOR_Z / 2]))
    plates = [
        Box(name, 0.0, np.array([width, width, 0.02]), np.array([0.0, 0.0, z]))
        for name, width, z in (("plate", 0.30, -0.01), ("ground plate", 0.48, FLOOR_Z + 0.01))
    ]
    _log_cylinders(stream, f"{arm.path}/base", [foot], _paint(arm, _ALUMINIUM))
    _log_parts(stream, f"{arm.path}/stand", [column, *plates], (*_STAND, 255))


def _log_name(stream: rr.RecordingStream, arm: Arm, z: float) -> None:
    name = rr.Points3D([[0.0, 0.0, z]], radii=0.001, labels=[arm.label], colors=[rgb(arm.colour)])
    stream.log(f"{arm.path}/name", name, static=True)


def _log_parts(stream: rr.RecordingStream, path: str, parts: Sequence[Part], colour: tuple[int, int, int, int]) -> None:
    _log_cylinders(stream, path, [part for part in parts if isinstance(part, Cylinder)], colour)
    boxes = [part for part in parts if isinstance(part, Box)]
    if boxes:
        drawn = rr.Boxes3D(
            centers=[box.center for box in boxes],
            sizes=[box.size for box in boxes],
            colors=[colour],
            fill_mode="solid",
        )
        stream.log(path if len(boxes) == len(parts) else f"{path}/boxes", drawn, static=True)
    spheres = [part for part in parts if isinstance(part, Sphere)]
    if spheres:
        drawn = rr.Ellipsoids3D(
            centers=[sphere.center for sphere in spheres],
            radii=[sphere.radius for sphere in spheres],
            colors=[colour],
            fill_mode="solid",
        )
        stream.log(path if len(spheres) == len(parts) else f"{path}/spheres", drawn, static=True)


def _log_cylinders(
    stream: rr.RecordingStream, path: str, parts: Sequence[Cylinder], colour: tuple[int, int, int, int]
) -> None:
    if parts:
        skin = 0.0 if colour[3] == 255 else _GHOST_SKIN
        drawn = rr.Cylinders3D(
            lengths=[part.height for part in parts],
            radii=[part.radius + skin for part in parts],
            centers=[part.center for part in parts],
            quaternions=[rr.Quaternion(xyzw=_ALONG[part.axis]) for part in parts],
            colors=[colour],
            fill_mode="solid",
        )
        stream.log(path, drawn, static=True)


def _caps(model: ArmModel, i: int) -> list[Cylinder]:
    """A disc over the outer end of each motor housing of link i."""
    caps = []
    for motor in looks.motors(model)[i]:
        along = "xyz".index(motor.axis)
        housing = [
            part
            for part in model.links[i].cylinders
            if part.axis == motor.axis and abs(part.center[0] - motor.x) < 0.005
        ]
        if housing:
            end = max(motor.cap_end * part.center[along] + part.height / 2 for part in housing) * motor.cap_end
            center = np.array(housing[0].center)
            center[along] = end + motor.cap_end * 0.004
            caps.append(Cylinder("cap", 0.0, 0.008, 0.96 * housing[0].radius, housing[0].axis, center))
    return caps


def arms_in(table: Table) -> list[Arm]:
    """The arms that the columns can move, the twin first; one alone is no ghost."""
    arms = [arm for arm in (THE_TWIN, THE_ROBOT) if has(table, arm.column)]
    return arms if len(arms) > 1 else [replace(arm, ghost=False) for arm in arms]
