"""The layout of ``models/*.toml`` and their checked reading. Units stand in the keys; the loaders convert to SI."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec

from ur5_twin.errors import ModelError, unknown
from ur5_twin.resources import data_dir

Positive = Annotated[float, msgspec.Meta(gt=0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0)]
Six = tuple[float, float, float, float, float, float]
SixPositive = tuple[Positive, Positive, Positive, Positive, Positive, Positive]
SixNonNegative = tuple[NonNegative, NonNegative, NonNegative, NonNegative, NonNegative, NonNegative]
Three = tuple[float, float, float]
T = TypeVar("T")
#: No number of an arm, in any unit of these files, is as large.
_LARGEST = 1e9


class Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A section of a file: unknown keys are errors."""


class DHSpec(Strict, frozen=True):
    source: str
    d_mm: Six
    a_mm: Six
    alpha_rad: Six


class LimitsSpec(Strict, frozen=True):
    source: str
    q_max_rad: SixPositive
    qd_max_rad_s: SixPositive
    qdd_max_rad_s2: SixPositive
    torque_max_nm: SixPositive


class ManufacturerDriveSpec(Strict, frozen=True):
    source: str
    static_friction: SixNonNegative
    dynamic_friction: SixNonNegative
    viscous_friction: SixNonNegative
    dynamic_friction_backdrive: SixNonNegative
    viscous_friction_backdrive: SixNonNegative
    torque_constant: SixPositive


class BaseFile(Strict, frozen=True):
    dh: DHSpec
    limits: LimitsSpec
    manufacturer_drive: ManufacturerDriveSpec


class GravitySpec(Strict, frozen=True):
    value_m_s2: NonNegative
    source: str


class RotorSpec(Strict, frozen=True):
    inertia_kg_m2: SixNonNegative
    source: str


class InertiaSpec(Strict, frozen=True):
    kind: Literal["point", "cylinders"]
    source: str


class CylinderSpec(Strict, frozen=True):
    name: str
    mass_kg: Positive
    height_mm: Positive
    radius_mm: Positive
    axis: Literal["x", "y", "z"]
    offset_mm: Three


class LinkSpec(Strict, frozen=True):
    mass_kg: Positive
    center_mm: Three
    sources: dict[str, str]
    cylinders: tuple[CylinderSpec, ...]


class LinkChange(Strict, frozen=True):
    link: Annotated[int, msgspec.Meta(ge=1, le=6)]
    center_mm: Three
    source: str


class ModelFile(Strict, frozen=True):
    name: str
    title: str
    source: str
    gravity: GravitySpec
    rotors: RotorSpec
    inertia: InertiaSpec | None = None
    links: tuple[LinkSpec, ...] = ()
    links_from: str | None = None
    joints_from: str | None = None
    changes: tuple[LinkChange, ...] = ()
    provenance: dict[str, Any] | None = None


class PartSpec(Strict, frozen=True):
    name: str
    shape: Literal["cylinder", "box", "sphere"]
    mass_kg: Positive
    center_mm: Three
    height_mm: Positive | None = None
    radius_mm: Positive | None = None
    size_mm: tuple[Positive, Positive, Positive] | None = None


class ToolSpec(Strict, frozen=True):
    title: str
    source: str
    parts: tuple[PartSpec, ...]
    frame: Literal["mount", "flange"] = "mount"
    mount_height_mm: Positive | None = None
    sensor_frame_mm: Three | None = None
    sensor_frame_source: str | None = None
    provenance: dict[str, Any] | None = None


class GainsSpec(Strict, frozen=True):
    source: str
    kappa0: SixNonNegative
    kappa1: SixNonNegative
    kappai: SixNonNegative = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    lag_ms: SixNonNegative = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    acceleration_share: Six = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    provenance: dict[str, Any] | None = None


class DriveSpec(Strict, frozen=True):
    source: str
    torque_constant_nm_a: SixPositive
    offset_nm: Six
    coulomb_nm: SixNonNegative
    viscous_nm_s_rad: SixNonNegative
    dead_zone_rad_s: NonNegative
    provenance: dict[str, Any] | None = None


class RippleSpec(Strict, frozen=True):
    order: Positive
    amplitude_nm: SixNonNegative
    phase_rad: Six


class JointDrivesSpec(Strict, frozen=True):
    source: str
    torque_constant_nm_a: SixPositive
    offset_nm: Six
    coulomb_positive_nm: SixNonNegative
    coulomb_negative_nm: SixNonNegative
    stribeck_nm: Six
    stribeck_speed_rad_s: SixPositive
    load_nm_nm: SixNonNegative
    viscous_nm_s_rad: SixNonNegative
    presliding_mrad: SixPositive
    cold_viscous_ratio: Positive
    warming_time_s: Positive
    ripple: tuple[RippleSpec, ...] = ()


class CurrentErrorSpec(Strict, frozen=True):
    slow_a: Positive
    slow_s: Positive
    fast_a: Positive
    fast_s: Positive


class JointCurrentSpec(Strict, frozen=True):
    servo: bool
    moving_s: Positive
    forgetting_s: Positive
    servo_forgetting_s: Positive
    averages_s: tuple[Positive, ...]
    integral: bool
    orders: tuple[Annotated[int, msgspec.Meta(gt=0)], ...]
    delay_s: NonNegative
    lag_s: NonNegative
    directed: bool
    sticking: bool
    terms: tuple[str, ...]
    coefficients: tuple[float, ...]
    standard_errors: tuple[NonNegative, ...]
    error_moving: CurrentErrorSpec
    error_at_rest: CurrentErrorSpec
    turned_a: Positive


class CurrentMapSpec(Strict, frozen=True):
    source: str
    model: str
    torque_constant_nm_a: SixPositive
    joint: Annotated[tuple[JointCurrentSpec, ...], msgspec.Meta(min_length=6, max_length=6)]
    provenance: dict[str, Any] | None = None


class TargetCurrentSpec(Strict, frozen=True):
    source: str
    torque_constant_nm_a: SixPositive
    load_a_nm: SixNonNegative
    viscous_driving_a_s_rad: SixNonNegative
    viscous_backdriven_a_s_rad: SixNonNegative
    provenance: dict[str, Any] | None = None


def model_path(name: str) -> Path:
    """Path of a file that ships in ``models/``."""
    return data_dir("models") / name


def read(path: Path, kind: type[T]) -> T:
    """Read a TOML file as ``kind``.

    Raises:
        ModelError: no such file, not TOML, a key is missing or unknown, or a value has the wrong type or range.
    """
    return convert(load(path), kind, path.name)


def read_named(name: str, kind: type[T]) -> dict[str, T]:
    """Read a shipped file whose top-level tables are all of one ``kind``."""
    return convert(load(model_path(name)), dict[str, kind], name)  # type: ignore[valid-type]


def choose(choice: str | Path, shipped: str, kind: type[T], what: str) -> tuple[str, T]:
    """One preset by name from a shipped file, or the only table of a file of the user's with that layout.

    Returns:
        The preset's name and its content.

    Raises:
        ModelError: the name is unknown, or the file does not hold exactly one table.
    """
    presets = read_named(shipped, kind)
    key = str(choice).lower().replace("-", "_")
    if key in presets:
        return key, presets[key]
    path = Path(choice)
    if path.suffix != ".toml":
        raise ModelError(unknown(what, str(choice), presets) + ", or give the path of a .toml file")
    own = convert(load(path), dict[str, kind], path.name)  # type: ignore[valid-type]
    if len(own) != 1:
        raise ModelError(f"{path.name}: {len(own)} tables ({', '.join(own)}), expected one with the keys of {shipped}")
    return next(iter(own.items()))


def convert(data: Any, kind: type[T], where: str) -> T:
    """Check parsed data against a layout; ``where`` names the file in the error."""
    if (bad := _senseless(data)) is not None:
        raise ModelError(f"{where}: {bad} is no number that a robot has: finite and below {_LARGEST:g}")
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        raise ModelError(f"{where}: {_explain(str(error), kind)}") from None


def _senseless(data: Any, path: str = "") -> str | None:
    """The key of the first number in parsed TOML that is inf, nan or beyond all bounds; None if there is none."""
    if isinstance(data, float):
        return None if abs(data) < _LARGEST else path
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        found = _senseless(value, f"{path}[{key}]" if isinstance(data, list) else f"{path}.{key}".lstrip("."))
        if found is not None:
            return found
    return None


def _explain(message: str, kind: Any) -> str:
    if "unknown field" not in message:
        return message
    fields = sorted({name for layout in _layouts(kind, set()) for name in layout.__struct_fields__})
    return f"{message} (known keys: {', '.join(fields)})"


def _layouts(kind: Any, seen: set[Any]) -> set[type[msgspec.Struct]]:
    """Every Struct that can stand inside ``kind``; msgspec's message does not say which one it was in."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        if kind in seen:
            return seen
        seen.add(kind)
        inside = [info.type for info in msgspec.structs.fields(kind)]
    else:
        inside = list(getattr(kind, "__args__", ()))
    for item in inside:
        _layouts(item, seen)
    return seen


def load(path: Path) -> Any:
    """A TOML file, not checked against a layout.

    Raises:
        ModelError: no such file, or not TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ModelError(f"cannot read {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ModelError(f"{path.name} is not valid TOML: {error}") from None
