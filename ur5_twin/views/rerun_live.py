"""A running robot and its twin in the Rerun viewer, as they move."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.recording.table import Recording, Table
from ur5_twin.views import rerun_view

if TYPE_CHECKING:
    import rerun as rr

    from ur5_twin.views.rerun_scene import Stage

#: What the plots show before the newest row, s.
SHOWN = 20.0
#: The picture has room for a flange this far to each side of where it is at first, m.
_ROOM = 0.3
#: What the viewer keeps at most; the oldest goes first.
_MEMORY = "1GB"


class LiveView:
    """The viewer's side of a live session; rows are sent in pieces.

    One of ``save``, ``connect`` and, without them, a viewer that is opened.

    Args:
        model: the arm that is drawn, with its tool.
        first: the first rows, at least one: what they hold decides on the layout.
        title: what the viewer calls it.
        save: an ``.rrd`` file to write.
        connect: URL of a viewer that is open somewhere.

    Raises:
        MissingExtraError: Rerun is not installed.
    """

    def __init__(
        self, model: ArmModel, first: Table, title: str, *, save: Path | None = None, connect: str | None = None
    ) -> None:
        rerun_view.need_rerun()
        import rerun as rr

        self._model = model
        self._sent = 0
        recording = _recording(first)
        stage = _stage(model, first)
        layout = rerun_view.new_blueprint(recording, model, stage, last=SHOWN)
        self._stream: rr.RecordingStream = rr.RecordingStream(rerun_view.APPLICATION_ID, send_properties=False)
        self._stream.send_recording_name(title)
        if save is not None:
            save.parent.mkdir(parents=True, exist_ok=True)
            self._stream.save(save, default_blueprint=layout)
        elif connect is not None:
            self._stream.connect_grpc(connect, default_blueprint=layout)
        else:
            self._stream.spawn(memory_limit=_MEMORY, default_blueprint=layout)
        rerun_view.log_static(self._stream, recording, model, stage)

    def show(self, rows: Table) -> None:
        """Send the next rows."""
        if len(rows):
            rerun_view.log_rows(self._stream, _recording(rows), self._model, first_tick=self._sent)
            self._sent += len(rows)

    def close(self) -> None:
        """Send what still waits, and end."""
        self._stream.flush()
        self._stream.disconnect()


def _stage(model: ArmModel, first: Table) -> Stage:
    """Room for an arm that may go anywhere near where it is."""
    from ur5_twin.views.rerun_scene import Stage

    place = kinematics.forward(model, first["actual_q"][0])[:3, 3]
    return Stage.facing(place + _ROOM * np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3))


def _recording(rows: Table) -> Recording:
    return Recording({"robot": rows}, "live", "live")
