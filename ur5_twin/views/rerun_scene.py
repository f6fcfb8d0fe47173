"""The 3D part of the Rerun view: both arms in their real cylinders, the flange's path, arrows for forces.

Every link is an entity whose pose in the base is sent by columns; what it looks like hangs below it and is sent once.
Needs ``rerun``; import it through ``rerun_view``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from ur5_twin.arm import kinematics
from ur5_twin.arm.mjcf import looks
from ur5_twin.arm.parameters import N_JOINTS, ArmModel, Box, Cylinder
from ur5_twin.recording.table import Table
from ur5_twin.views.style import LEAST_FORCE, MEASURED, TWIN, has, rgb
from ur5_twin.views.wrenches import Wrench

ROOT = "scene"
#: Poses and arrows a second: as smooth as a film, a fifth of the robot's rows.
FRAME_RATE = 25.0
FLOOR_Z = -0.72
_NAME_Z = -0.3
#: Length of an arrow, m per N.
ARROW_SCALE = 0.006

#: The eye is turned from where the arm points by this angle about the vertical, and looks down with this slope.
_ASIDE = np.radians(68.0)
_FROM_ABOVE = 0.33
#: Distance of the eye for each metre of a point right and up of the picture's middle, by the viewer's angle of view.
_EYE_DISTANCE = np.array([1.85, 2.05])

_ALUMINIUM = (205, 208, 213)
_STEEL = (120, 123, 128)
_STAND = (74, 80, 88)
_GHOST_OPACITY = 90
#: How much thicker a ghost is drawn, m: where it coincides with the twin it lies over it like a skin.
_GHOST_SKIN = 0.002
#: Quaternions x, y, z, w that turn a cylinder from z to the axis.
_ALONG = {"x": (0.0, 0.5**0.5, 0.0, 0.5**0.5), "y": (-(0.5**0.5), 0.0, 0.0, 0.5**0.5), "z": (0.0, 0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Arm:
    """One of the two arms: which column moves it, what it is called and its colour everywhere."""

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
    def facing(cls, p_BF: np.ndarray, *, overlaid: bool = False) -> Stage:
        """The stage on which a path is seen from the side, with the measured arm to the viewer's right.

        Args:
            p_BF: (n, 3) the flange's positions, m, rows with NaN allowed; none at all give the view along the base's y.
            overlaid: put the measured arm where the twin is.
        """
        known = p_BF[np.isfinite(p_BF).all(axis=1)]
        ahead = known[:, :2].mean(axis=0) if len(known) else np.array([1.0, 0.0])
        azimuth = np.arctan2(ahead[1], ahead[0]) + _ASIDE
        # The viewer's axes: to the right, up, and from the picture to the eye.
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        back = np.array([np.cos(azimuth), np.sin(azimuth), _FROM_ABOVE]) / np.hypot(1.0, _FROM_ABOVE)
        axes = np.stack([right, np.cross(back, right), back])
        # Whatever the flange does, the shoulder, the elbow's height and the upper stand belong into the picture.
        always = np.array([[0.0, 0.0, 0.6], [0.0, 0.0, -0.4], *(0.22 * right * side for side in (-1, 1))])
        points = np.concatenate([known, always]) @ axes.T
        gap = 0.0 if overlaid else float(np.clip(np.ptp(points[:, 0]) + 0.15, 0.8, 1.25))
        points = np.concatenate([points, points + np.array([gap, 0.0, 0.0])])
        middle = (points.max(axis=0) + points.min(axis=0))[:2] / 2
        far = float(np.max(np.abs(points[:, :2] - middle) * _EYE_DISTANCE + points[:, 2:]))
        target = middle @ axes[:2]
        return cls(beside=right * gap, eye=target + back * far, target=target)


def log_static(stream: rr.RecordingStream, model: ArmModel, arms: Sequence[Arm], stage: Stage) -> None:
    """Send what never changes: the axes, the stands, the shapes of each arm's links and of the tool."""
    stream.log(ROOT, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for arm in arms:
        offset = stage.beside if arm.ghost and len(arms) > 1 else np.zeros(3)
        stream.log(arm.path, rr.Transform3D(translation=offset), static=True)
        _log_stand(stream, arm, name_z=_NAME_Z - (0.0 if not arm.ghost or offset.any() else 0.12))
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
        style = rr.Arrows3D.from_fields(radii=[0.009], colors=[rgb(wrench.colour)])
        stream.log(path, style, static=True)
        columns = rr.Arrows3D.columns(vectors=force[shown] * ARROW_SCALE, origins=X_BF[rows[shown], :3, 3])
        lengths = shown.astype(np.int64)
        stream.send_columns(path, indexes(table.time[rows], ticks[rows]), columns.partition(lengths), strict=True)


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


def _log_stand(stream: rr.RecordingStream, arm: Arm, name_z: float) -> None:
    foot = Cylinder("foot", 0.0, looks.BASE_HEIGHT, looks.BASE_RADIUS, "z", np.array([0, 0, looks.BASE_HEIGHT / 2]))
    column = Cylinder("column", 0.0, -FLOOR_Z - 0.04, 0.075, "z", np.array([0.0, 0.0, FLOOR_Z / 2]))
    plates = [
        Box(name, 0.0, np.array([width, width, 0.02]), np.array([0.0, 0.0, z]))
        for name, width, z in (("plate", 0.30, -0.01), ("ground plate", 0.48, FLOOR_Z + 0.01))
    ]
    _log_cylinders(stream, f"{arm.path}/base", [foot], _paint(arm, _ALUMINIUM))
    _log_parts(stream, f"{arm.path}/stand", [column, *plates], (*_STAND, 255))
    name = rr.Points3D([[0.0, 0.0, name_z]], radii=0.001, labels=[arm.label], colors=[rgb(arm.colour)])
    stream.log(f"{arm.path}/name", name, static=True)


def _log_parts(
    stream: rr.RecordingStream, path: str, parts: Sequence[Cylinder | Box], colour: tuple[int, int, int, int]
) -> None:
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
    """The arms that the columns can move, the twin first."""
    return [arm for arm in (THE_TWIN, THE_ROBOT) if has(table, arm.column)]
