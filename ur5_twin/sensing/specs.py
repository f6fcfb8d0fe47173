"""Presets of the devices: the numbers of ``models/sensors.toml``, checked, in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from ur5_twin.arm import files
from ur5_twin.arm.files import NonNegative, Positive, Six, SixNonNegative, SixPositive, Strict, Three
from ur5_twin.errors import ModelError, unknown
from ur5_twin.sensing.channel import Channel

#: Name of the preset without any fault.
IDEAL = "ideal"
_SHIPPED = "sensors.toml"
_Share = Annotated[float, msgspec.Meta(ge=0, lt=1)]
#: A clock that is off by more than a hundredth is no clock.
_Drift = Annotated[float, msgspec.Meta(ge=-1e4, le=1e4)]


class EncodersSpec(Strict, frozen=True):
    source: str
    position_step_urad: SixNonNegative
    velocity_step_urad_s: SixNonNegative


class CurrentsSpec(Strict, frozen=True):
    source: str
    step_ma: SixNonNegative
    noise_ma: SixNonNegative
    noise_moving_ma: SixNonNegative
    noise_moving_pole: _Share


class ForceTorqueSpec(Strict, frozen=True):
    source: str
    rate_hz: Positive
    jitter_ms: NonNegative
    delay_ms: NonNegative
    clock_offset_ms: float
    bandwidth_hz: Positive
    bias: Six
    drift_per_root_s: SixNonNegative
    slow_noise: SixNonNegative
    slow_noise_hz: Positive
    full_scale: SixPositive
    gauges: tuple[Six, Six, Six, Six, Six, Six]
    noise_counts: SixNonNegative
    mount_rotation_rad: Three = (0.0, 0.0, 0.0)
    clock_drift_ppm: _Drift = 0.0


class AxesSpec(Strict, frozen=True):
    bandwidth_hz: Positive
    noise: NonNegative
    slow_noise: NonNegative
    slow_noise_hz: Positive
    bias: Three
    full_scale: Positive
    gain: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)


class ImuSpec(Strict, frozen=True):
    source: str
    rate_hz: Positive
    stamp_step_ms: NonNegative
    delay_ms: NonNegative
    clock_offset_ms: float
    acceleration: AxesSpec
    rate: AxesSpec
    field: AxesSpec
    earth_field: Three
    bits: Annotated[int, msgspec.Meta(ge=2, le=32)]
    mount_rotation_rad: Three = (0.0, 0.0, 0.0)
    mount_shift_mm: Three = (0.0, 0.0, 0.0)
    clock_drift_ppm: _Drift = 0.0


class SuiteSpec(Strict, frozen=True):
    encoders: EncodersSpec
    currents: CurrentsSpec
    force_torque: ForceTorqueSpec
    imu: ImuSpec
    provenance: dict[str, Any] | None = None


@dataclass(frozen=True)
class Clock:
    """When a device samples.

    Attributes:
        rate: 1/s.
        jitter: standard deviation of the time from sample to sample, s, each for itself, so that the clock wanders; cut
            at 0.4 of a period.
        offset: its clock's zero on the robot's clock, s.
        stamp_step: resolution of its time stamps, s; 0 for stamps as exact as a number can be.
        drift: by how much of a second per second the robot's clock gains on this one.
    """

    rate: float
    jitter: float
    offset: float
    stamp_step: float
    drift: float = 0.0


@dataclass(frozen=True)
class SensorSuite:
    """The devices of a test stand.

    Attributes:
        name: of the preset.
        position, velocity, current: channels of the robot's own signals, sampled at its tick.
        current_moving: (6,) standard deviation of the current's further noise in motion, A (``sensing.motor_noise``).
        current_pole: of that noise.
        ft, ft_clock: the force sensor, N and Nm.
        acceleration, rate, field, imu_clock: the IMU, m/s^2, rad/s and the unit of ``earth_field``.
        earth_field: (3,) in the base frame.
        ft_mount, imu_mount: (3,) how the sensor's axes are turned against the flange's, R_FS and R_FA as rotation
            vectors, rad.
        imu_shift: (3,) from where the tool says that the IMU measures to where it does, flange axes, m.
        late_packages: whether the robot's packages come late and split while it moves (thesis section 4.4.1).
        source: where the numbers come from, by device.
    """

    name: str
    position: Channel
    velocity: Channel
    current: Channel
    current_moving: np.ndarray
    current_pole: float
    ft: Channel
    ft_clock: Clock
    acceleration: Channel
    rate: Channel
    field: Channel
    imu_clock: Clock
    earth_field: np.ndarray
    ft_mount: np.ndarray
    imu_mount: np.ndarray
    imu_shift: np.ndarray
    late_packages: bool
    source: dict[str, str]


def sensor_names() -> tuple[str, ...]:
    """Names of the presets."""
    return (*files.read_named(_SHIPPED, SuiteSpec), IDEAL)


def load_suite(name: str | Path = "lab") -> SuiteSpec:
    """A preset as its file has it; the lab's for the one without any fault.

    Raises:
        ModelError: the name is unknown or the file is wrong.
    """
    return _chosen(name)[1]


def _chosen(name: str | Path) -> tuple[str, SuiteSpec]:
    if str(name) == IDEAL:
        return IDEAL, files.read_named(_SHIPPED, SuiteSpec)["lab"]
    if not str(name).endswith(".toml") and str(name) not in sensor_names():
        raise ModelError(unknown("sensor preset", str(name), sensor_names()) + ", or give the path of a .toml file")
    return files.choose(name, _SHIPPED, SuiteSpec, "sensor preset")


def load_sensors(name: str | Path = "lab", *, late_packages: bool = False) -> SensorSuite:
    """A preset by name, or a file with one table of the same layout.

    Args:
        name: ``lab``, ``ideal`` (the lab's devices and rates without noise, steps, bias, delay, repeats and limits), or
            the path of a ``.toml`` file.
        late_packages: see ``SensorSuite``.

    Raises:
        ModelError: the name is unknown or the file is wrong.
    """
    key, spec = _chosen(name)
    if key == IDEAL:
        return _ideal(spec, late_packages)
    ft, imu = spec.force_torque, spec.imu
    return SensorSuite(
        name=key,
        position=Channel(step=np.array(spec.encoders.position_step_urad) * 1e-6),
        velocity=Channel(step=np.array(spec.encoders.velocity_step_urad_s) * 1e-6),
        current=Channel(step=np.array(spec.currents.step_ma) * 1e-3, noise=np.array(spec.currents.noise_ma) * 1e-3),
        current_moving=np.array(spec.currents.noise_moving_ma) * 1e-3,
        current_pole=spec.currents.noise_moving_pole,
        ft=Channel(
            delay=ft.delay_ms * 1e-3,
            bandwidth=ft.bandwidth_hz,
            bias=np.array(ft.bias),
            drift=np.array(ft.drift_per_root_s),
            slow_noise=np.array(ft.slow_noise),
            slow_pole=_pole(ft.slow_noise_hz, ft.rate_hz),
            noise=np.array(ft.noise_counts),
            full_scale=np.array(ft.full_scale),
            gauges=_gauges(ft, key),
        ),
        ft_clock=Clock(ft.rate_hz, ft.jitter_ms * 1e-3, ft.clock_offset_ms * 1e-3, 0.0, ft.clock_drift_ppm * 1e-6),
        acceleration=_axes(imu.acceleration, imu),
        rate=_axes(imu.rate, imu),
        field=_axes(imu.field, imu),
        imu_clock=Clock(
            imu.rate_hz, 0.0, imu.clock_offset_ms * 1e-3, imu.stamp_step_ms * 1e-3, imu.clock_drift_ppm * 1e-6
        ),
        earth_field=np.array(imu.earth_field),
        ft_mount=np.array(ft.mount_rotation_rad),
        imu_mount=np.array(imu.mount_rotation_rad),
        imu_shift=np.array(imu.mount_shift_mm) * 1e-3,
        late_packages=late_packages,
        source={
            "encoders": spec.encoders.source,
            "currents": spec.currents.source,
            "ft": ft.source,
            "imu": imu.source,
        },
    )


def _axes(axes: AxesSpec, imu: ImuSpec) -> Channel:
    # Signed, so one bit less for the size.
    step = axes.full_scale / 2 ** (imu.bits - 1)
    return Channel(
        delay=imu.delay_ms * 1e-3,
        bandwidth=axes.bandwidth_hz,
        gain=np.array(axes.gain),
        bias=np.array(axes.bias),
        slow_noise=np.full(3, axes.slow_noise),
        slow_pole=_pole(axes.slow_noise_hz, imu.rate_hz),
        noise=np.full(3, axes.noise),
        step=np.full(3, step),
        full_scale=np.full(3, axes.full_scale),
    )


def _pole(bandwidth: float, rate: float) -> float:
    """Of noise that falls by 3 dB at a bandwidth, first order, sampled at a rate; both in Hz."""
    return float(np.exp(-2.0 * np.pi * bandwidth / rate))


def _gauges(ft: ForceTorqueSpec, name: str) -> np.ndarray:
    gauges = np.array(ft.gauges)
    if np.linalg.matrix_rank(gauges) < len(gauges):
        raise ModelError(f"{name}: the columns of force_torque.gauges cannot tell forces from moments")
    return gauges


def _ideal(spec: SuiteSpec, late_packages: bool) -> SensorSuite:
    plain, none = Channel(), "without any fault"
    return SensorSuite(
        name=IDEAL,
        position=plain,
        velocity=plain,
        current=plain,
        current_moving=np.zeros(6),
        current_pole=0.0,
        ft=plain,
        ft_clock=Clock(spec.force_torque.rate_hz, 0.0, 0.0, 0.0),
        acceleration=plain,
        rate=plain,
        field=plain,
        imu_clock=Clock(spec.imu.rate_hz, 0.0, 0.0, 0.0),
        earth_field=np.array(spec.imu.earth_field),
        ft_mount=np.zeros(3),
        imu_mount=np.zeros(3),
        imu_shift=np.zeros(3),
        late_packages=late_packages,
        source={"encoders": none, "currents": none, "ft": none, "imu": none},
    )
