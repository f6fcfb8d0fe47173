"""A recording in the Rerun viewer: the arms and what is around them in 3D, and every signal over time.

Rerun is an optional part of the package and imported only when one of these functions is called.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.atomic import replacing
from ur5_twin.errors import MissingExtraError
from ur5_twin.evaluation import contacts
from ur5_twin.recording.table import Recording
from ur5_twin.views import wrenches

if TYPE_CHECKING:
    import rerun as rr

    from ur5_twin.arm.mjcf import Obstacle
    from ur5_twin.views.rerun_scene import Stage

APPLICATION_ID = "ur5_twin"


def write_rrd(
    recording: Recording,
    model: ArmModel,
    path: Path,
    *,
    title: str,
    overlaid: bool = False,
    obstacles: Sequence[Obstacle] = (),
) -> Path:
    """Write a recording as an ``.rrd`` file that opens in the viewer with a layout of its own.

    Args:
        recording: a replay, a run of a scenario, or any other: what is missing is left out. A single arm is solid.
        model: the arm that is drawn, with its tool.
        path: where to write; an existing file is replaced in one piece.
        title: what the viewer calls the recording.
        overlaid: draw the measured arm into the twin, not beside it.
        obstacles: what stands around the arm, in the scenario's order.

    Returns:
        The path.

    Raises:
        MissingExtraError: Rerun is not installed.
    """
    stream = new_stream(recording, title)
    stage = new_stage(recording, model, overlaid=overlaid, obstacles=obstacles)
    with replacing(path) as temporary:
        stream.save(temporary, default_blueprint=new_blueprint(recording, model, stage, obstacles=obstacles))
        _log_all(stream, recording, model, stage, obstacles)
        stream.disconnect()
    return path


def spawn(
    recording: Recording,
    model: ArmModel,
    *,
    title: str | None = None,
    overlaid: bool = False,
    obstacles: Sequence[Obstacle] = (),
) -> None:
    """Open the viewer with a recording; it stays open when this process ends. Arguments as of ``write_rrd``."""
    stream = new_stream(recording, recording.source if title is None else title)
    stage = new_stage(recording, model, overlaid=overlaid, obstacles=obstacles)
    stream.spawn(default_blueprint=new_blueprint(recording, model, stage, obstacles=obstacles))
    _log_all(stream, recording, model, stage, obstacles)
    stream.disconnect()


def new_stream(recording: Recording, title: str) -> rr.RecordingStream:
    """A stream of its own, not the process' default; equal recordings get the same recording id."""
    need_rerun()
    import rerun as rr

    stream = rr.RecordingStream(APPLICATION_ID, recording_id=_content_id(recording), send_properties=False)
    stream.send_recording_name(title)
    return stream


def new_stage(
    recording: Recording, model: ArmModel, *, overlaid: bool = False, obstacles: Sequence[Obstacle] = ()
) -> Stage:
    """Where the arms stand and from where one looks, such that the recording's motion is seen from the side."""
    need_rerun()
    from ur5_twin.views import rerun_scene as scene

    arms = scene.arms_in(recording.robot)
    if not arms:
        return scene.Stage.facing(np.empty((0, 3)), overlaid=overlaid, obstacles=obstacles)
    path = _flange_poses(recording, model)[:, :3, 3]
    return scene.Stage.facing(path, overlaid=overlaid or len(arms) == 1, obstacles=obstacles)


def new_blueprint(
    recording: Recording, model: ArmModel, stage: Stage, *, obstacles: Sequence[Obstacle] = ()
) -> rr.blueprint.Blueprint:
    """The layout of the viewer's window for a whole recording: its plots, their lines and limits."""
    need_rerun()
    from ur5_twin.views import rerun_plots as plots

    found = wrenches.find(recording, _flange_poses(recording, model), model.tool)
    names = [obstacle.name for obstacle in obstacles]
    return plots.blueprint(recording.robot, found, stage, contacts.touches(recording), names)


def log_static(
    stream: rr.RecordingStream,
    recording: Recording,
    model: ArmModel,
    stage: Stage,
    *,
    obstacles: Sequence[Obstacle] = (),
) -> None:
    """Send what never changes: the shapes of obstacles and of the arms whose columns are there. Once a stream."""
    from ur5_twin.views import rerun_scene as scene

    scene.log_static(stream, model, scene.arms_in(recording.robot), stage, obstacles)


def log_rows(
    stream: rr.RecordingStream,
    recording: Recording,
    model: ArmModel,
    *,
    first_tick: int = 0,
    sensor_bias: np.ndarray | None = None,
    obstacles: Sequence[Obstacle] = (),
) -> None:
    """Send the rows of a recording, or of the next piece of one that is still running.

    Args:
        stream: where to.
        recording: the rows.
        model: the arm that is drawn.
        first_tick: number of rows sent before.
        sensor_bias: (6,) what the force sensor reads without load; from the rows' own first 0.3 s if not given, so give
            that of the first piece (``recording.force_sensor.sensor_bias``) with every later one.
        obstacles: what stands around the arm, for the names of contacts.
    """
    from ur5_twin.views import rerun_plots as plots
    from ur5_twin.views import rerun_scene as scene

    table = recording.robot
    ticks = first_tick + np.arange(len(table))
    arms = scene.arms_in(table)
    plots.log_signals(stream, table, ticks)
    scene.log_poses(stream, model, arms, table, ticks)
    X_BF = _flange_poses(recording, model)
    found = wrenches.find(recording, X_BF, model.tool, sensor_bias)
    plots.log_wrenches(stream, found, table, ticks)
    touched, names = contacts.touches(recording), [obstacle.name for obstacle in obstacles]
    plots.log_contacts(stream, touched, names, table, ticks)
    plots.log_states(stream, touched, names, table, ticks)
    if arms:
        # Forces act on the arm they were measured on; the last arm is the measured one where there are two.
        # Where the true forces are known point by point, their sum at the flange would only be in the way.
        at_flange = [item for item in found if "contact" not in recording.tables or item.label != "truth"]
        scene.log_arrows(stream, arms[-1], X_BF, at_flange, table, ticks)
        scene.log_contacts(stream, arms[-1], recording, ticks)


def _log_all(
    stream: rr.RecordingStream, recording: Recording, model: ArmModel, stage: Stage, obstacles: Sequence[Obstacle]
) -> None:
    from ur5_twin.views import rerun_scene as scene

    log_static(stream, recording, model, stage, obstacles=obstacles)
    scene.log_paths(stream, model, scene.arms_in(recording.robot), recording.robot)
    log_rows(stream, recording, model, obstacles=obstacles)


def _flange_poses(recording: Recording, model: ArmModel) -> np.ndarray:
    """(n, 4, 4) X_BF by the measured joints, or the twin's where nothing was measured; NaN where unknown."""
    from ur5_twin.views import rerun_scene as scene

    arms = scene.arms_in(recording.robot)
    if not arms:
        return np.full((len(recording.robot), 4, 4), np.nan)
    return kinematics.forward(model, recording.robot[arms[-1].column])


def _content_id(recording: Recording) -> uuid.UUID:
    digest = hashlib.sha256()
    for device, table in sorted(recording.tables.items()):
        digest.update(f"{device} {table.host_start}".encode())
        digest.update(np.ascontiguousarray(table.time).tobytes())
        for name, values in sorted(table.columns.items()):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(values).tobytes())
    return uuid.UUID(bytes=digest.digest()[:16])


def has_rerun() -> bool:
    """Whether the Rerun SDK is installed."""
    return find_spec("rerun") is not None


def need_rerun() -> None:
    """Raise MissingExtraError, which names the extra to install, if Rerun is not installed."""
    if not has_rerun():
        raise MissingExtraError("the Rerun view", "view")
