"""What hung on the flange, by the devices that a log holds."""

from __future__ import annotations

from ur5_twin.arm.parameters import FT_SENSOR, IMU_SENSOR
from ur5_twin.recording.table import Recording


def carried_tool(recording: Recording) -> str:
    """The tool of the log's force sensor and IMU, the one on the other, or ``none`` (``arm.parameters.load_tool``)."""
    carried = [name for name, device in ((FT_SENSOR, "ft"), (IMU_SENSOR, "imu")) if device in recording.tables]
    return "+".join(carried) or "none"
