"""A robot that runs, in the Rerun viewer: the measured arm and the twin, estimates with their intervals, all signals.

Rerun is an optional part of the package and imported only when one of these functions is called.
"""

from __future__ import annotations

import socket
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import numpy as np

from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.errors import WireError
from ur5_twin.evaluation.scores import NINETY
from ur5_twin.recording.table import Recording, Table
from ur5_twin.views import wrenches
from ur5_twin.views.rerun_view import APPLICATION_ID, need_rerun
from ur5_twin.views.wrenches import Wrench

if TYPE_CHECKING:
    import rerun as rr

#: What the plots show of the past, s.
_PAST = 20.0
#: The picture has room for a flange this far to each side of where it is at first, m.
_ROOM = 0.3
_CORNERS = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
#: What the viewer keeps; it forgets the oldest beyond that.
_MEMORY = "2GB"
#: How long it may take to find a viewer, s.
_PROBE = 2.0
#: The viewer's own port on this machine.
_VIEWER = "rerun+http://127.0.0.1:9876/proxy"


class RerunLive:
    """Sends rows to a viewer, to a file, or to both, as they come.

    Args:
        model: the arm that is drawn, with its tool.
        title: what the viewer calls the recording.
        spawn: open a viewer here, or use the one that is open.
        save: an ``.rrd`` file to write; it grows for as long as it goes on.
        connect: URL of a viewer elsewhere.

    Raises:
        MissingExtraError: Rerun is not installed.
        WireError: there is no viewer at that URL; sending to it would wait for ever.
    """

    def __init__(
        self, model: ArmModel, title: str, *, spawn: bool = False, save: Path | None = None, connect: str | None = None
    ) -> None:
        need_rerun()
        import rerun as rr

        self._model = model
        self._stream = rr.RecordingStream(APPLICATION_ID, recording_id=uuid.uuid4(), send_properties=False)
        self._stream.send_recording_name(title)
        self._sinks: list[rr.GrpcSink | rr.FileSink] = []
        if spawn:
            rr.spawn(connect=False, memory_limit=_MEMORY, hide_welcome_screen=True)
            self._sinks.append(rr.GrpcSink(_VIEWER))
        if connect is not None:
            _need_viewer(connect)
            self._sinks.append(rr.GrpcSink(connect))
        if save is not None:
            save.parent.mkdir(parents=True, exist_ok=True)
            self._sinks.append(rr.FileSink(save))
        self._rows = 0
        self._open = True

    def show(self, table: Table) -> None:
        """Send the next rows of the robot's table."""
        from ur5_twin.views import rerun_plots as plots
        from ur5_twin.views import rerun_scene as scene

        if not len(table) or not self._open:
            return
        X_BF = kinematics.forward(self._model, table["actual_q"])
        recording = Recording({"robot": table}, "live", "live")
        found = wrenches.find(recording, X_BF, self._model.tool)
        bands = intervals(found, table)
        arms = scene.arms_in(table)
        if self._rows == 0:
            stage = scene.Stage.facing(X_BF[0, :3, 3] + _ROOM * _CORNERS)
            blueprint = plots.live_blueprint(table, found, bands, stage, _PAST)
            self._stream.set_sinks(*self._sinks, default_blueprint=blueprint)
            scene.log_static(self._stream, self._model, arms, stage)
        ticks = self._rows + np.arange(len(table))
        self._rows += len(table)
        plots.log_signals(self._stream, table, ticks)
        plots.log_wrenches(self._stream, [*found, *bands], table, ticks)
        scene.log_poses(self._stream, self._model, arms, table, ticks)
        scene.log_arrows(self._stream, arms[-1], X_BF, found, table, ticks)

    def close(self) -> None:
        """Send what is still on its way, and finish the file."""
        if self._open:
            self._open = False
            self._stream.disconnect()


def _need_viewer(url: str) -> None:
    place = urlsplit(url)
    try:
        if not url.startswith(("rerun+http://", "rerun+https://", "rerun://")) or place.hostname is None:
            raise ValueError
        port = place.port or 9876
    except ValueError:
        raise WireError(f"'{url}' is no viewer's URL; it looks like {_VIEWER}") from None
    try:
        socket.create_connection((place.hostname, port), timeout=_PROBE).close()
    except OSError as error:
        raise WireError(f"no Rerun viewer at {url} ({error.strerror or error})") from None


def intervals(found: Sequence[Wrench], table: Table) -> list[Wrench]:
    """Lower and upper ends of the central 90 % intervals of the estimates that tell their deviation."""
    bands = []
    for item in found:
        name = item.key.removesuffix("_wrench") + "_deviation"
        if name in table:
            width = NINETY * table[name]
            for end, sign in (("low", -1.0), ("high", 1.0)):
                bands.append(Wrench(f"{item.key}_{end}", "90 %", item.colour, item.values + sign * width))
    return bands
