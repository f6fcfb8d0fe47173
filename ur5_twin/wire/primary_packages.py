"""The packages of ports 30001 and 30002, by version: big-endian, each its size, its type, its fields."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ur5_twin.arm.parameters import ArmModel
from ur5_twin.wire.realtime_layout import old_mode
from ur5_twin.wire.state import Value
from ur5_twin.wire.version import Version

_STATE, _MESSAGE = 16, 20
#: Types of messages.
_TEXT, _POPUP, _VERSION, _EXCEPTION = 0, 2, 3, 10
#: Who a message comes from: the controller itself, the running program.
_CONTROLLER, _PROGRAM = -2, 7
#: What a program's motions use unless it says otherwise (rad/s, rad/s^2, m/s, m/s^2), and the radius (m) that turns
#: rotation into distance.
_DEFAULTS = (1.05, 1.4, 0.25, 1.2, 0.2)
#: A UR5's number among the robots.
_ROBOT_TYPE = 1
#: Bits of robot_status_bits and safety_status_bits that the robot mode's flags repeat.
_POWER_ON = 1 << 0
_PROTECTIVE, _EMERGENCY = 1 << 2, 1 << 7
_PLAYING, _PAUSED = (2, 5), (3, 4)


class Signals:
    """Signals with zeros for what is not there."""

    def __init__(self, signals: Mapping[str, Value]) -> None:
        self._signals = signals

    def number(self, name: str) -> float:
        """A number; zero for what is none."""
        found = float(np.asarray(self._signals.get(name, 0.0)).ravel()[0])
        return found if np.isfinite(found) else 0.0

    def whole(self, name: str, low: int = 0, high: int = 255) -> int:
        """A whole number within what its field holds."""
        return int(min(max(self.number(name), low), high))

    def vector(self, name: str, width: int = 6) -> list[float]:
        """(width,) numbers."""
        found = np.nan_to_num(np.asarray(self._signals.get(name, np.zeros(width)), dtype=float)).ravel()
        return np.resize(found, width).tolist()


def robot_state(version: Version, timestamp: float, signals: Mapping[str, Value], arm: ArmModel) -> bytes:
    """The state of a tick.

    Args:
        version: of the controller.
        timestamp: the controller's clock, s.
        signals: RTDE's names and values.
        arm: limits and kinematics that the configuration tells, from 1.8 on.
    """
    known = Signals(signals)
    parts = [
        _part(0, _robot_mode(version, timestamp, known)),
        _part(1, _joints(known)),
        _part(2, _tool(known)),
        _part(3, _masterboard(version, known)),
        _part(4, _cartesian(version, known)),
    ]
    if (version.major, version.minor) >= (1, 8):
        parts += [_part(5, _kinematics(arm)), _part(6, _configuration(arm))]
    parts.append(_part(7, _force(known)))
    body = b"".join(parts)
    return struct.pack(">IB", 5 + len(body), _STATE) + body


def version_message(version: Version, timestamp: float) -> bytes:
    """What a controller says of itself to who connects."""
    name = b"URControl"
    fields = struct.pack(">B", len(name)) + name + struct.pack(">BBi", version.major, version.minor, version.bugfix)
    if version.major >= 3:
        fields += struct.pack(">i", version.build)
    return _message(_VERSION, _CONTROLLER, timestamp, fields + b"virtual, ur5-twin")


def text_message(text: str, timestamp: float) -> bytes:
    """What a program says with textmsg."""
    return _message(_TEXT, _PROGRAM, timestamp, text.encode("utf-8", "replace"))


def popup_message(version: Version, text: str, timestamp: float, number: int) -> bytes:
    """A popup on the screen that is not there."""
    title = b"Popup"
    flags = struct.pack(">??", False, False)
    if version.major >= 3:
        # The request's number and type (0: nothing is asked), and that it does not block.
        flags = struct.pack(">IB", number & 0xFFFFFFFF, 0) + flags + struct.pack(">?", False)
    return _message(
        _POPUP, _PROGRAM, timestamp, flags + struct.pack(">B", len(title)) + title + text.encode("utf-8", "replace")
    )


def exception_message(text: str, timestamp: float, line: int = -1) -> bytes:
    """What is wrong with a program; ``line`` -1: nobody knows where."""
    return _message(_EXCEPTION, _PROGRAM, timestamp, struct.pack(">ii", line, -1) + text.encode("utf-8", "replace"))


def _message(kind: int, source: int, timestamp: float, fields: bytes) -> bytes:
    body = struct.pack(">QbB", _microseconds(timestamp), source, kind) + fields
    return struct.pack(">IB", 5 + len(body), _MESSAGE) + body


def _part(kind: int, fields: bytes) -> bytes:
    return struct.pack(">IB", 5 + len(fields), kind) + fields


def _microseconds(timestamp: float) -> int:
    return max(round(timestamp * 1e6), 0)


def _robot_mode(version: Version, timestamp: float, known: Signals) -> bytes:
    status, safety = known.whole("robot_status_bits", 0, 2**32 - 1), known.whole("safety_status_bits", 0, 2**32 - 1)
    runtime = known.whole("runtime_state")
    flags = (
        True,
        True,
        bool(status & _POWER_ON),
        bool(safety & _EMERGENCY),
        bool(safety & _PROTECTIVE),
        runtime in _PLAYING,
        runtime in _PAUSED,
    )
    head = struct.pack(">Q7?", _microseconds(timestamp), *flags)
    mode = known.whole("robot_mode")
    fraction = known.number("target_speed_fraction")
    if version.major < 3:
        stop = known.whole("safety_mode") or 1
        return head + struct.pack(">Bd", old_mode(mode, stop), fraction)
    # The control mode: position (0), nothing else is known.
    fields = head + struct.pack(">BBdd", mode, 0, fraction, known.number("speed_scaling"))
    if (version.major, version.minor) >= (3, 2):
        fields += struct.pack(">d", 1.0)
    return fields + (b"\x00" if version.major >= 5 else b"")


def _joints(known: Signals) -> bytes:
    columns: Sequence[list[Any]] = [
        known.vector("actual_q"),
        known.vector("target_q"),
        known.vector("actual_qd"),
        known.vector("actual_current"),
        known.vector("actual_joint_voltage"),
        known.vector("joint_temperatures"),
        [0.0] * 6,
        [int(min(max(mode, 0), 255)) for mode in known.vector("joint_mode")],
    ]
    return b"".join(struct.pack(">3d4fB", *row) for row in zip(*columns, strict=True))


def _tool(known: Signals) -> bytes:
    types = known.whole("tool_analog_input_types")
    return struct.pack(
        ">BBddfBffB",
        types & 1,
        types >> 1 & 1,
        known.number("tool_analog_input0"),
        known.number("tool_analog_input1"),
        known.number("actual_robot_voltage"),
        known.whole("tool_output_voltage"),
        known.number("tool_output_current"),
        known.number("tool_temperature"),
        known.whole("tool_mode"),
    )


def _masterboard(version: Version, known: Signals) -> bytes:
    inputs, outputs = (
        known.whole("actual_digital_input_bits", 0, 2**31),
        known.whole("actual_digital_output_bits", 0, 2**31),
    )
    types = known.whole("analog_io_types")
    bits = struct.pack(">ii", inputs & 0x7FFFFFFF, outputs & 0x7FFFFFFF)
    if version.major < 3:
        bits = struct.pack(">HH", inputs & 0xFFFF, outputs & 0xFFFF)
    analog = struct.pack(
        ">BBddBBdd",
        types & 1,
        types >> 1 & 1,
        known.number("standard_analog_input0"),
        known.number("standard_analog_input1"),
        types >> 2 & 1,
        types >> 3 & 1,
        known.number("standard_analog_output0"),
        known.number("standard_analog_output1"),
    )
    power = struct.pack(
        ">4f",
        0.0,
        known.number("actual_robot_voltage"),
        known.number("actual_robot_current"),
        known.number("io_current"),
    )
    # The safety mode; not in reduced mode; no Euromap 67 interface.
    fields = bits + analog + power + struct.pack(">BBB", known.whole("safety_mode"), 0, 0)
    if (version.major, version.minor) >= (3, 2):
        fields += bytes(4)
    if (version.major, version.minor) >= (3, 3):
        fields += bytes(2)
    return fields + (b"\x00" if version.major >= 5 else b"")


def _cartesian(version: Version, known: Signals) -> bytes:
    fields = struct.pack(">6d", *known.vector("actual_TCP_pose"))
    if (version.major, version.minor) >= (3, 1):
        fields += struct.pack(">6d", *known.vector("tcp_offset"))
    return fields


def _kinematics(arm: ArmModel) -> bytes:
    """The arm's kinematics, without checksums of a calibration that was never made."""
    return struct.pack(">6I24dI", *[0] * 6, *[0.0] * 6, *arm.dh.a, *arm.dh.d, *arm.dh.alpha, 0)


def _configuration(arm: ArmModel) -> bytes:
    limits = np.column_stack([-arm.limits.q, arm.limits.q]).ravel()
    speeds = np.column_stack([arm.limits.qd, arm.limits.qdd]).ravel()
    return struct.pack(
        ">12d12d5d24d4i",
        *limits,
        *speeds,
        *_DEFAULTS,
        *arm.dh.a,
        *arm.dh.d,
        *arm.dh.alpha,
        *[0.0] * 6,
        0,
        0,
        _ROBOT_TYPE,
        0,
    )


def _force(known: Signals) -> bytes:
    return struct.pack(">6dd", *known.vector("actual_TCP_force"), 0.0)
