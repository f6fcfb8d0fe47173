"""Gains and levels of the estimators: the layout of ``models/estimators.toml``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec

from ur5_twin.arm import files
from ur5_twin.arm.files import NonNegative, Positive, SixPositive, Strict

_Share = Annotated[float, msgspec.Meta(gt=0, lt=1)]


class WrenchSpec(Strict, frozen=True):
    source: str
    prior_force_n: Positive
    prior_moment_nm: Positive
    prior_contact: _Share


class MotorTorqueSpec(Strict, frozen=True):
    source: str
    friction_share: NonNegative
    torque_share: NonNegative


class DirectSpec(Strict, frozen=True):
    source: str
    order: Annotated[int, msgspec.Meta(ge=1, le=10)]
    cutoff_hz: Positive


class FilteredDynamicsSpec(Strict, frozen=True):
    source: str
    order: Annotated[int, msgspec.Meta(ge=1, le=4)]
    cutoff_1_s: SixPositive


class RecursiveLeastSquaresSpec(Strict, frozen=True):
    source: str
    forgetting: _Share


class MomentumObserverSpec(Strict, frozen=True):
    source: str
    gain_1_s: SixPositive


class ExtendedStateSpec(Strict, frozen=True):
    source: str
    bandwidth_1_s: SixPositive


class SlidingModeSpec(Strict, frozen=True):
    source: str
    s1_nm_s: SixPositive
    s2_1_s2: SixPositive


class DisturbanceKalmanSpec(Strict, frozen=True):
    source: str
    walk_nm_root_s: SixPositive


class AdaptiveSpec(Strict, frozen=True):
    source: str
    gain_1_s: SixPositive
    forgetting_s: Positive
    constant_share: Positive
    friction_share: Positive
    offset_nm: SixPositive
    correlation_s: Positive
    quiet_s: NonNegative
    contact: _Share
    excitation: Positive


class AccelerometerSpec(Strict, frozen=True):
    source: str
    cutoff_1_s: SixPositive
    acceleration_noise_m_s2: Positive
    joint_noise_rad_s2: SixPositive
    bias_s: Positive


class FrictionKalmanSpec(Strict, frozen=True):
    source: str
    force_n: Positive
    moment_nm: Positive
    push_s: Positive
    doubt: Positive
    turned: Positive
    prior_contact: _Share


class OnsetSpec(Strict, frozen=True):
    source: str
    force_n: Positive
    moment_nm: Positive
    friction_share: Positive
    torque_share: Positive
    prior: _Share


class DetectionSpec(Strict, frozen=True):
    source: str
    on: _Share
    off: _Share
    rise_s: NonNegative
    fall_s: NonNegative


class LocalisationSpec(Strict, frozen=True):
    source: str
    prior_force_n: Positive
    cone: Positive
    spacing_mm: Positive
    around: Annotated[int, msgspec.Meta(ge=3, le=72)]


class Settings(Strict, frozen=True):
    """``models/estimators.toml``, a table an estimator."""

    wrench: WrenchSpec
    motor_torque: MotorTorqueSpec
    direct: DirectSpec
    filtered_dynamics: FilteredDynamicsSpec
    recursive_least_squares: RecursiveLeastSquaresSpec
    momentum_observer: MomentumObserverSpec
    extended_state_observer: ExtendedStateSpec
    sliding_mode_observer: SlidingModeSpec
    disturbance_kalman: DisturbanceKalmanSpec
    adaptive_observer: AdaptiveSpec
    accelerometer_aided: AccelerometerSpec
    friction_kalman: FrictionKalmanSpec
    onset: OnsetSpec
    detection: DetectionSpec
    localisation: LocalisationSpec


def load_settings(path: Path | None = None) -> Settings:
    """The settings of a TOML file, by default ``models/estimators.toml``.

    Raises:
        ModelError: the file is wrong.
    """
    return files.read(path or files.model_path("estimators.toml"), Settings)
