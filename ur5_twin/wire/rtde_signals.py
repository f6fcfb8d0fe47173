"""RTDE's variables: their types, by name, and since which version of the controller they exist.

Source: Universal Robots' RTDE guide, whose tables say since when there is a variable, and the open client library's
table of types. ``tool_digital_output`` and its mask are in the library alone, so since when is not known.
"""

from __future__ import annotations

from dataclasses import dataclass

from ur5_twin.wire.version import Version


@dataclass(frozen=True)
class Type:
    """A type of RTDE.

    Attributes:
        name: as it goes over the wire.
        code: its element's in the module ``struct``.
        width: number of elements.
    """

    name: str
    code: str
    width: int = 1

    @property
    def format(self) -> str:
        """Its format in the module ``struct``."""
        return self.code * self.width


BOOL = Type("BOOL", "?")
UINT8 = Type("UINT8", "B")
UINT32 = Type("UINT32", "I")
UINT64 = Type("UINT64", "Q")
INT32 = Type("INT32", "i")
DOUBLE = Type("DOUBLE", "d")
VECTOR3D = Type("VECTOR3D", "d", 3)
VECTOR6D = Type("VECTOR6D", "d", 6)
VECTOR6INT32 = Type("VECTOR6INT32", "i", 6)
VECTOR6UINT32 = Type("VECTOR6UINT32", "I", 6)


def _of(type: Type, *names: str) -> dict[str, Type]:
    return {name: type for text in names for name in text.split()}


def _registers(direction: str) -> dict[str, Type]:
    return {
        f"{direction}_bit_registers0_to_31": UINT32,
        f"{direction}_bit_registers32_to_63": UINT32,
        **{f"{direction}_bit_register_{i}": BOOL for i in range(64, 128)},
        **{f"{direction}_int_register_{i}": INT32 for i in range(48)},
        **{f"{direction}_double_register_{i}": DOUBLE for i in range(48)},
    }


#: What a controller publishes.
OUTPUTS: dict[str, Type] = {
    **_of(
        DOUBLE,
        "timestamp actual_execution_time target_execution_time speed_scaling target_speed_fraction actual_momentum",
        "actual_main_voltage actual_robot_voltage actual_robot_current io_current tcp_force_scalar payload",
        "standard_analog_input0 standard_analog_input1 standard_analog_output0 standard_analog_output1",
        "euromap67_24V_voltage euromap67_24V_current tool_analog_input0 tool_analog_input1 tool_output_current",
        "tool_temperature actual_robot_energy_consumed actual_robot_braking_energy_dissipated",
        "joint_position_deviation_ratio collision_detection_ratio",
    ),
    **_of(
        VECTOR6D,
        "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current",
        "actual_current_window actual_current_as_torque joint_control_output actual_TCP_pose actual_TCP_speed",
        "actual_TCP_force actual_TCP_acceleration target_TCP_pose target_TCP_speed target_TCP_acceleration tcp_offset",
        "joint_temperatures actual_joint_voltage ft_raw_wrench wrench_calc_from_currents payload_inertia",
        "target_base_acceleration target_base_wrench",
    ),
    **_of(VECTOR3D, "actual_tool_accelerometer elbow_position elbow_velocity payload_cog target_gravity"),
    **_of(VECTOR6INT32, "joint_mode"),
    **_of(
        INT32,
        "robot_mode safety_mode safety_status tool_output_voltage time_scale_source encoder0_raw encoder1_raw",
    ),
    **_of(
        UINT32,
        "runtime_state robot_status_bits safety_status_bits analog_io_types euromap67_input_bits euromap67_output_bits",
        "tool_mode tool_analog_input_types script_control_line",
    ),
    **_of(UINT8, "tool_output_mode tool_digital_output0_mode tool_digital_output1_mode"),
    **_of(
        UINT64,
        "actual_digital_input_bits actual_digital_output_bits actual_configurable_digital_input_bits",
        "actual_configurable_digital_output_bits control_step",
    ),
    **_registers("output"),
    **_registers("input"),
}

#: What a client may write.
INPUTS: dict[str, Type] = {
    **_of(UINT32, "speed_slider_mask"),
    **_of(DOUBLE, "speed_slider_fraction standard_analog_output_0 standard_analog_output_1"),
    **_of(
        UINT8,
        "standard_digital_output_mask standard_digital_output configurable_digital_output_mask",
        "configurable_digital_output tool_digital_output_mask tool_digital_output standard_analog_output_mask",
        "standard_analog_output_type",
    ),
    **_of(VECTOR6D, "external_force_torque"),
    **_registers("input"),
}

_Since = tuple[tuple[int, int] | None, tuple[int, int] | None]
#: When the upper half of the registers came, and when the lower half of those that are no bits.
_UPPER: _Since = ((3, 9), (5, 3))
_LOWER: _Since = ((3, 4), (5, 0))


def _registers_since() -> dict[str, _Since]:
    found: dict[str, _Since] = {}
    for way in ("input", "output"):
        found |= {f"{way}_bit_register_{i}": _UPPER for i in range(64, 128)}
        found |= {f"{way}_{kind}_register_{i}": _LOWER for kind in ("int", "double") for i in range(24)}
        found |= {f"{way}_{kind}_register_{i}": _UPPER for kind in ("int", "double") for i in range(24, 48)}
    return found


#: The first version with a variable, for those that came later and whose version is known: (CB3's, the e-Series').
#: None: that series has not got it. Where a variable is both written and published, it came at once as both.
_SINCE: dict[str, _Since] = {
    **_registers_since(),
    "elbow_position": ((3, 5), (5, 0)),
    "elbow_velocity": ((3, 5), (5, 0)),
    "safety_status": ((3, 10), (5, 4)),
    "payload": ((3, 11), (5, 5)),
    "payload_cog": ((3, 11), (5, 5)),
    "payload_inertia": ((3, 15), (5, 11)),
    "script_control_line": ((3, 14), (5, 9)),
    "ft_raw_wrench": (None, (5, 9)),
    "joint_position_deviation_ratio": (None, (5, 15)),
    "collision_detection_ratio": (None, (5, 15)),
    "time_scale_source": (None, (5, 17)),
    "actual_current_as_torque": (None, (5, 23)),
    "tool_output_mode": (None, (5, 2)),
    "tool_digital_output0_mode": (None, (5, 2)),
    "tool_digital_output1_mode": (None, (5, 2)),
}


def output_type(name: str, version: Version) -> Type | None:
    """The type of a published variable; None if that version has no such."""
    return OUTPUTS.get(name) if _has(name, version) else None


def input_type(name: str, version: Version) -> Type | None:
    """The type of a variable that clients write; None if that version has no such."""
    return INPUTS.get(name) if _has(name, version) else None


def _has(name: str, version: Version) -> bool:
    if name not in _SINCE:
        return True
    since = _SINCE[name][version.major >= 5]
    return since is not None and (version.major, version.minor) >= since
