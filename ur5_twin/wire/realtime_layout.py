"""The real-time interface's packets (TCP 30003 and 30013): where each signal is, in every layout, for both of its ends.

A packet is its own length as a 32-bit integer and then doubles, all big-endian. Its length says which layout it has;
later versions of the controller's software append, except that 3.0 moved the pose and speed of the tool.
Source: Universal Robots' description of the client interfaces.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from ur5_twin.errors import WireError

#: Bytes of a packet in each of the layouts, oldest first.
SIZES = (756, 764, 812, 1044, 1060, 1108, 1116, 1140, 1220)
#: Bytes of the length in front.
HEADER = 4
#: From this size on a packet is one of 3.0 or later.
_SINCE_3 = 1044


@dataclass(frozen=True)
class Field:
    """One signal of a packet.

    Attributes:
        name: RTDE's name of it, or the interface's own where RTDE has none.
        offset: of its first double from the packet's first byte.
        width: number of doubles.
    """

    name: str
    offset: int
    width: int = 1

    @property
    def end(self) -> int:
        """Offset of what follows it."""
        return self.offset + 8 * self.width


_ALL = (
    Field("timestamp", 4),
    Field("target_q", 12, 6),
    Field("target_qd", 60, 6),
    Field("target_qdd", 108, 6),
    Field("target_current", 156, 6),
    Field("target_moment", 204, 6),
    Field("actual_q", 252, 6),
    Field("actual_qd", 300, 6),
    Field("actual_current", 348, 6),
    Field("actual_TCP_force", 540, 6),
    Field("actual_digital_input_bits", 684),
    Field("joint_temperatures", 692, 6),
    Field("actual_execution_time", 740),
    Field("test_value", 748),
    Field("robot_mode", 756),
    Field("joint_mode", 764, 6),
)
_BEFORE_3 = (
    Field("actual_tool_accelerometer", 396, 3),
    Field("actual_TCP_pose", 588, 6),
    Field("actual_TCP_speed", 636, 6),
)
_FROM_3 = (
    Field("joint_control_output", 396, 6),
    Field("actual_TCP_pose", 444, 6),
    Field("actual_TCP_speed", 492, 6),
    Field("target_TCP_pose", 588, 6),
    Field("target_TCP_speed", 636, 6),
    Field("safety_mode", 812),
    Field("actual_tool_accelerometer", 868, 3),
    Field("speed_scaling", 940),
    Field("actual_momentum", 948),
    Field("actual_main_voltage", 972),
    Field("actual_robot_voltage", 980),
    Field("actual_robot_current", 988),
    Field("actual_joint_voltage", 996, 6),
    Field("actual_digital_output_bits", 1044),
    Field("runtime_state", 1052),
    Field("elbow_position", 1060, 3),
    Field("elbow_velocity", 1084, 3),
    Field("safety_status", 1108),
    Field("payload", 1140),
    Field("payload_cog", 1148, 3),
    Field("payload_inertia", 1172, 6),
)


@cache
def fields(size: int) -> tuple[Field, ...]:
    """The signals in a packet, by its size in bytes, in the order of their offsets.

    Raises:
        WireError: there is no layout of that size.
    """
    if size not in SIZES:
        known = ", ".join(map(str, SIZES))
        raise WireError(f"no packet of the real-time interface has {size} bytes (known: {known})")
    own = _FROM_3 if size >= _SINCE_3 else _BEFORE_3
    return tuple(sorted((field for field in (*_ALL, *own) if field.end <= size), key=lambda field: field.offset))
