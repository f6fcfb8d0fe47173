"""The layout of ``scenarios/*.toml`` and its checked reading. Units stand in the keys; ``loading`` converts to SI.

Errors name the key as it stands in the file: ``push[1].force_n`` is the second ``[[push]]``.
"""

from __future__ import annotations

import difflib
import re
import types
import typing
from pathlib import Path
from typing import Annotated, Any, Literal, Union

import msgspec

from ur5_twin.arm import files
from ur5_twin.arm.files import NonNegative, Positive, Six, SixPositive, Strict, Three
from ur5_twin.arm.mjcf.obstacles import MAX_DAMPING, MAX_FRICTION, MAX_STIFFNESS
from ur5_twin.errors import ModelError, ScenarioError

ThreePositive = tuple[Positive, Positive, Positive]
SixThrees = tuple[Three, Three, Three, Three, Three, Three]
Body = Literal[
    "shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link", "tool"
]

_ONES: Six = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
_ZEROS: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_ORIGIN: Three = (0.0, 0.0, 0.0)


class ArmSpec(Strict, frozen=True):
    controller: str = "controller"
    plant: str = "plant"
    tool: str = "none"
    declared_payload: str = "none"
    gains: str = "servo"


class StartSpec(Strict, frozen=True):
    q_rad: Six | None = None
    q_deg: Six | None = None
    position_mm: Three | None = None
    rotation_rad: Three | None = None
    near_deg: Six | None = None


class MoveJSpec(Strict, frozen=True, tag_field="type", tag="movej"):
    q_rad: Six | None = None
    q_deg: Six | None = None
    position_mm: Three | None = None
    rotation_rad: Three | None = None
    speed_rad_s: Positive = 1.05
    acceleration_rad_s2: Positive = 1.4
    blend_mm: NonNegative = 0.0


class MoveLSpec(Strict, frozen=True, tag_field="type", tag="movel"):
    position_mm: Three | None = None
    rotation_rad: Three | None = None
    by_mm: Three | None = None
    turn_by_rad: Three | None = None
    frame: Literal["base", "flange"] = "base"
    speed_m_s: Positive = 0.25
    acceleration_m_s2: Positive = 1.2
    blend_mm: NonNegative = 0.0


class WaitSpec(Strict, frozen=True, tag_field="type", tag="wait"):
    duration_s: Positive


class ServoJSpec(Strict, frozen=True, tag_field="type", tag="servoj"):
    file: str
    lookahead_s: Annotated[float, msgspec.Meta(ge=0.03, le=0.2)] = 0.1
    gain: Annotated[float, msgspec.Meta(ge=100, le=2000)] = 300.0


class WaypointsSpec(Strict, frozen=True, tag_field="type", tag="waypoints"):
    file: str
    space: Literal["joint_space", "task_space"] | None = None
    wait_s: Positive | None = None


MotionSpec = MoveJSpec | MoveLSpec | WaitSpec | ServoJSpec | WaypointsSpec


class Surface(Strict, frozen=True, kw_only=True):
    name: str
    position_mm: Three
    stiffness_n_m: Annotated[float, msgspec.Meta(gt=0, le=MAX_STIFFNESS)]
    rotation_rad: Three = _ORIGIN
    damping_n_s_m: Annotated[float, msgspec.Meta(ge=0, le=MAX_DAMPING)] = 100.0
    friction: Annotated[float, msgspec.Meta(ge=0, le=MAX_FRICTION)] = 0.3


class PlateSpec(Surface, frozen=True, tag_field="shape", tag="plate", kw_only=True):
    size_mm: ThreePositive


class WallSpec(Surface, frozen=True, tag_field="shape", tag="wall", kw_only=True):
    size_mm: ThreePositive


class BoxSpec(Surface, frozen=True, tag_field="shape", tag="box", kw_only=True):
    size_mm: ThreePositive


class SphereSpec(Surface, frozen=True, tag_field="shape", tag="sphere", kw_only=True):
    radius_mm: Positive


class CylinderSpec(Surface, frozen=True, tag_field="shape", tag="cylinder", kw_only=True):
    radius_mm: Positive
    height_mm: Positive


ObstacleSpec = PlateSpec | WallSpec | BoxSpec | SphereSpec | CylinderSpec


class PushBase(Strict, frozen=True, kw_only=True):
    at_s: NonNegative
    body: Body = "tool"
    point_mm: Three = _ORIGIN


class HalfSineSpec(PushBase, frozen=True, tag_field="profile", tag="half_sine", kw_only=True):
    duration_s: Positive
    frame: Literal["base", "body"] = "base"
    force_n: Three = _ORIGIN
    moment_nm: Three = _ORIGIN


class RampSpec(PushBase, frozen=True, tag_field="profile", tag="ramp", kw_only=True):
    duration_s: Positive
    rise_s: Positive
    frame: Literal["base", "body"] = "base"
    force_n: Three = _ORIGIN
    moment_nm: Three = _ORIGIN


class StepSpec(PushBase, frozen=True, tag_field="profile", tag="step", kw_only=True):
    duration_s: Positive
    frame: Literal["base", "body"] = "base"
    force_n: Three = _ORIGIN
    moment_nm: Three = _ORIGIN


class LogSpec(PushBase, frozen=True, tag_field="profile", tag="log", kw_only=True):
    log: str
    first_s: NonNegative = 0.0
    last_s: Positive | None = None
    scale: float = 1.0


PushSpec = HalfSineSpec | RampSpec | StepSpec | LogSpec


class PayloadSpec(Strict, frozen=True):
    at_s: NonNegative
    mass_kg: NonNegative
    center_mm: Three = _ORIGIN
    inertia_kg_m2: tuple[NonNegative, NonNegative, NonNegative] = _ORIGIN
    declared_at_s: NonNegative | None = None


class MismatchSpec(Strict, frozen=True):
    link_mass_scale: SixPositive = _ONES
    link_center_shift_mm: SixThrees = (_ORIGIN, _ORIGIN, _ORIGIN, _ORIGIN, _ORIGIN, _ORIGIN)
    rotor_scale: SixPositive = _ONES
    friction_scale: SixPositive = _ONES
    torque_constant_scale: SixPositive = _ONES
    offset_nm: Six = _ZEROS
    ripple_phase_rad: Six = _ZEROS
    gravity_scale: NonNegative = 1.0


class TemperatureSpec(Strict, frozen=True):
    warm_for_s: NonNegative | None = None
    cold_viscous_ratio: Positive | None = None
    warming_time_s: Positive | None = None


class SensorsSpec(Strict, frozen=True):
    preset: str = "lab"
    late_packages: bool = False


class LimitsSpec(Strict, frozen=True):
    force_n: Positive | None = None
    # No sound arm comes near either: not in the lab's fastest motion nor under its hardest push.
    deviation_rad: Positive = 0.1
    speed_factor: Positive = 1.1


class ScenarioFile(Strict, frozen=True):
    title: str
    description: str
    seed: Annotated[int, msgspec.Meta(ge=0)] = 0
    duration_s: Positive | None = None
    settle_s: NonNegative = 1.0
    arm: ArmSpec = ArmSpec()
    start: StartSpec = StartSpec()
    motion: tuple[MotionSpec, ...] = ()
    obstacle: tuple[ObstacleSpec, ...] = ()
    push: tuple[PushSpec, ...] = ()
    payload: tuple[PayloadSpec, ...] = ()
    mismatch: MismatchSpec = MismatchSpec()
    temperature: TemperatureSpec = TemperatureSpec()
    sensors: SensorsSpec = SensorsSpec()
    limits: LimitsSpec = LimitsSpec()


def read(path: Path) -> ScenarioFile:
    """Read a scenario file.

    Raises:
        ScenarioError: no such file, not TOML, a key is missing or unknown, or a value has the wrong type or range.
    """
    try:
        data = files.read(path, dict[str, Any])
    except ModelError as error:
        raise ScenarioError(str(error)) from None
    try:
        return msgspec.convert(data, ScenarioFile)
    except msgspec.ValidationError as error:
        raise ScenarioError(f"{path.name}: {_explain(str(error), data)}") from None


def _explain(message: str, data: Any) -> str:
    """msgspec's message with the key as it stands in the file, and what would be known there."""
    what, _, place = message.partition(" - at `$")
    path = place.rstrip("`").lstrip(".")
    unknown = re.search(r"unknown field `(.+)`", what)
    missing = re.search(r"missing required field `(.+)`", what)
    if unknown or missing:
        key = (unknown or missing).group(1)  # type: ignore[union-attr]
        whole = f"{path}.{key}" if path else key
        if missing:
            return f"{whole} is missing"
        known = sorted(_known_keys(path, data))
        close = difflib.get_close_matches(key, known, n=1)
        hint = f"; did you mean '{close[0]}'?" if close else ""
        return f"unknown key {whole}{hint} (known there: {', '.join(known)})"
    if "Invalid value" in what and (tags := _tags(path)):
        return f"{path}: {what} (known: {', '.join(tags)})"
    return f"{path}: {what}" if path else what


def _known_keys(path: str, data: Any) -> set[str]:
    """The keys of the table at ``path``, by its tag where there are several kinds of it."""
    layouts: tuple[type[msgspec.Struct], ...] = (ScenarioFile,)
    for step, index in re.findall(r"\.?(\w+)(?:\[(\d+)\])?", path):
        data = data[step][int(index)] if index else data[step]
        layouts = _layouts(_field_type(layouts[0], step))
    field = layouts[0].__struct_config__.tag_field
    if field is None:
        return set(layouts[0].__struct_fields__)
    kinds = [kind for kind in layouts if kind.__struct_config__.tag == data[field]]
    return {field, *kinds[0].__struct_fields__}


def _tags(path: str) -> list[str]:
    step, _, field = path.rpartition(".")
    layouts = _layouts(_field_type(ScenarioFile, step.partition("[")[0])) if step else ()
    return [str(kind.__struct_config__.tag) for kind in layouts if kind.__struct_config__.tag_field == field]


def _field_type(kind: type[msgspec.Struct], name: str) -> Any:
    return next(info.type for info in msgspec.structs.fields(kind) if info.name == name)


def _layouts(kind: Any) -> tuple[type[msgspec.Struct], ...]:
    """The Structs that ``kind`` can be: itself, or the members of a union, or what a tuple holds."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return (kind,)
    origin = typing.get_origin(kind)
    if origin in (Union, types.UnionType, tuple):
        return tuple(found for item in typing.get_args(kind) if item is not Ellipsis for found in _layouts(item))
    return ()
