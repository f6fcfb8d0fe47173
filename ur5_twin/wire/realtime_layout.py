"""What lies where in a packet of the real-time interface, by the packet's size; the server and the reader share it.

A packet is its size as a 32-bit integer, then doubles, all big-endian. The names are RTDE's.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from ur5_twin.errors import WireError
from ur5_twin.wire.rtde_signals import OUTPUTS
from ur5_twin.wire.state import Value

#: Bytes of the size that begins a packet.
HEADER = 4
_SIZE = struct.Struct(">I")
#: The first size of the 3.x series; smaller ones are of 1.x.
_THIRD = 1044
#: Packet's size -> the versions that send it.
SIZES: Mapping[int, str] = {
    756: "1.0 to 1.6",
    764: "1.7",
    812: "1.8",
    1044: "3.0 and 3.1",
    1060: "3.2 to 3.4",
    1108: "3.5 to 3.9, 5.0 to 5.3",
    1116: "3.10 to 3.13, 5.4 to 5.8",
    1140: "3.14, 3.15, 5.9",
    1220: "5.10 and later",
}


@dataclass(frozen=True)
class Field:
    """A signal's place in a packet.

    Attributes:
        name: RTDE's.
        offset: of its first byte.
        width: number of doubles.
    """

    name: str
    offset: int
    width: int = 1


#: In every version; those that lie beyond a packet's end are not in it.
_COMMON = (
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
    Field("robot_mode", 756),
    Field("joint_mode", 764, 6),
)
_FIRST_SERIES = (
    Field("actual_tool_accelerometer", 396, 3),
    Field("actual_TCP_pose", 588, 6),
    Field("actual_TCP_speed", 636, 6),
)
_SINCE_THIRD = (
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

#: Robot modes since 3.0 and the 1.x series' for the same; no stop among them, which 1.x counts as modes.
_OLD_MODES = {7: 0, 6: 1, 5: 2, 4: 3, 2: 3, 8: 3, 3: 7, 0: 8, 1: 8, -1: 8}
_NEW_MODES = {0: 7, 1: 6, 2: 5, 3: 4, 4: 7, 5: 3, 6: 3, 7: 3, 8: 0, 9: 3, 10: 7}
#: Safety modes since 3.0 and the 1.x robot mode for the same.
_OLD_STOPS = {3: 4, 5: 10, 6: 5, 7: 5, 8: 6, 9: 6}
_NEW_STOPS = {4: 3, 10: 5, 5: 7, 6: 9}


@cache
def fields(size: int) -> tuple[Field, ...]:
    """The signals in a packet of so many bytes.

    Raises:
        WireError: no version sends such packets.
    """
    if size not in SIZES:
        known = ", ".join(f"{known} ({versions})" for known, versions in SIZES.items())
        raise WireError(f"no version's real-time packet has {size} bytes; there are {known}")
    own = _FIRST_SERIES if size < _THIRD else _SINCE_THIRD
    return tuple(field for field in (*_COMMON, *own) if field.offset + 8 * field.width <= size)


def encode(size: int, signals: Mapping[str, Value]) -> bytes:
    """The packet of a tick; zeros where there is no signal.

    Raises:
        WireError: no version sends packets of that size.
    """
    values = np.zeros((size - HEADER) // 8, dtype=">f8")
    for field in fields(size):
        value = signals.get(field.name)
        if value is not None:
            place = (field.offset - HEADER) // 8
            values[place : place + field.width] = value
    if size < _THIRD and size > 756:
        safety, mode = _whole(signals.get("safety_mode", 1)), _whole(signals.get("robot_mode", 0))
        values[(756 - HEADER) // 8] = old_mode(mode, safety)
    return _SIZE.pack(size) + values.tobytes()


def decode(packet: bytes) -> dict[str, Value]:
    """The signals of a packet: numbers, and (3,) and (6,) arrays.

    The robot modes of 1.x become those of later versions and a ``safety_mode``.

    Raises:
        WireError: it is no packet of any version, or not a whole one.
    """
    size = size_of(packet)
    if size != len(packet):
        raise WireError(f"a real-time packet of {size} bytes with {len(packet)}")
    values = np.frombuffer(packet, dtype=">f8", offset=HEADER).astype(float)
    signals: dict[str, Value] = {}
    for field in fields(size):
        place = (field.offset - HEADER) // 8
        found = values[place : place + field.width]
        whole = OUTPUTS[field.name].code != "d"
        if whole:
            found = np.nan_to_num(found, posinf=0.0, neginf=0.0).astype(np.int64)
        signals[field.name] = found if field.width > 1 else int(found[0]) if whole else float(found[0])
    if size < _THIRD and "robot_mode" in signals:
        signals["robot_mode"], signals["safety_mode"] = modes_of(int(signals["robot_mode"]))
    return signals


def size_of(data: bytes) -> int:
    """How many bytes the packet has that begins here; ``data`` must hold its header.

    Raises:
        WireError: this is no packet's beginning.
    """
    size = _SIZE.unpack_from(data)[0]
    fields(size)
    return size


def old_mode(robot_mode: int, safety_mode: int) -> int:
    """The robot mode of the 1.x series for the modes of later ones."""
    return _OLD_STOPS.get(safety_mode, _OLD_MODES.get(robot_mode, 8))


def modes_of(old: int) -> tuple[int, int]:
    """The robot mode and the safety mode of later versions for a robot mode of the 1.x series."""
    return _NEW_MODES.get(old, 0), _NEW_STOPS.get(old, 1)


def _whole(value: Value) -> int:
    return int(np.asarray(value).ravel()[0])
