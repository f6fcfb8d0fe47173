"""What ``identify sensor`` leaves behind: devices for the twin, mounted and biased as the logs' are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from ur5_twin.arm.parameters import FT_SENSOR, IMU_SENSOR, ArmModel
from ur5_twin.errors import IdentificationError
from ur5_twin.identification import force_torque, imu
from ur5_twin.identification.force_torque import FtFit
from ur5_twin.identification.imu import ImuFit
from ur5_twin.identification.results import Numbers, Result, provenance
from ur5_twin.identification.spread import NINETY_FIVE, together
from ur5_twin.recording.table import Recording
from ur5_twin.sensing import load_sensors
from ur5_twin.sensing.specs import SuiteSpec, load_suite
from ur5_twin.spatial import WRENCH_AXES

#: Name of the file, and of its table.
FILE, TABLE = "sensors.toml", "mine"
#: A turn is told if its standard deviation is below this, rad.
_TOLD = 0.1
_IMU_UNITS = np.concatenate([[1e3, 1e6], np.full(3, 1e3), np.full(3, 1e3), np.ones(6), np.ones(3), np.full(3, 1e3)])
_IMU_HEADS = (
    ("Clock and mounting of the IMU", slice(0, 8), "shift ms, drift ppm, rotation mrad, place mm"),
    ("Gain and bias of the accelerometer", slice(8, 14), "gain 1, bias m/s^2"),
    ("Gain and bias of the gyroscope", slice(14, 20), "gain 1, bias mrad/s"),
)
_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Found:
    """What one log says of its devices; None where it has no such device.

    Attributes:
        ft, imu: the fits.
        p_FA: (3,) where the tool says that the IMU measures, flange frame, m.
        mount: (3,) the known rotation vector of R_FS, rad.
    """

    source: str
    ft: FtFit | None
    imu: ImuFit | None
    p_FA: np.ndarray
    mount: np.ndarray


def fit(recording: Recording, arm_with: Callable[[str], ArmModel], tool: str | None, sensors: str) -> Found:
    """Fit every device of a log.

    Args:
        recording: the log.
        arm_with: the arm with a tool of a name.
        tool: that carries the devices; None for the bare devices that the log has.
        sensors: the devices as they are known, a preset or a file.

    Raises:
        IdentificationError: the log has no device, or the tool does not carry it.
    """
    has = {name: device in recording.tables for name, device in ((FT_SENSOR, "ft"), (IMU_SENSOR, "imu"))}
    if not any(has.values()):
        raise IdentificationError(f"{recording.source}: neither force sensor nor IMU in it; record one of them")
    arm = arm_with("+".join(name for name, there in has.items() if there) if tool is None else tool)
    carried = {} if arm.tool is None else arm.tool.sensors
    lacking = [name for name, there in has.items() if there and name not in carried]
    if lacking:
        raise IdentificationError(
            f"{recording.source}: the tool '{tool}' carries no {' and no '.join(lacking)}, which the log has; "
            f"give --tool "
            "with it"
        )
    suite = load_sensors(sensors)
    return Found(
        recording.source,
        force_torque.fit_ft(recording, arm, suite) if has[FT_SENSOR] else None,
        imu.fit_imu(recording, arm, carried[IMU_SENSOR], suite) if has[IMU_SENSOR] else None,
        carried.get(IMU_SENSOR, np.zeros(3)),
        suite.ft_mount,
    )


def result(found: Sequence[Found], recordings: Sequence[Recording], sensors: str, command: str) -> Result:
    """The devices in the layout of ``models/sensors.toml``: what was found over what is known of them."""
    spec = msgspec.to_builtins(load_suite(sensors))
    made_of = provenance(recordings, command)
    source = f"{command}, on {', '.join(made_of['logs'])}; what the logs do not tell from '{sensors}'"
    tables: list[Numbers] = []
    findings: list[str] = []
    uncertainty: dict[str, Any] = {}
    imus = [item for item in found if item.imu is not None]
    fts = [item for item in found if item.ft is not None]
    if imus:
        spec["imu"] |= _imu(imus, findings, tables, uncertainty) | {"source": source}
    if fts:
        spec["force_torque"] |= _ft(fts, findings, tables, uncertainty) | {"source": source}
    spec["provenance"] = made_of | {"half_width_95": uncertainty}
    model = _without_nothing({TABLE: _merged(msgspec.to_builtins(load_suite(sensors)), spec)})
    return Result(FILE, dict[str, SuiteSpec], model, "Devices", tuple(findings), tuple(tables), spec["provenance"])


def ft_shift(fit: FtFit) -> tuple[float, float, float, float]:
    """Shift and drift with their deviations, by weight if that tells the axes, else by the pushes."""
    if fit.pushes is not None and np.isnan(fit.std[force_torque.ROTATION]).any():
        return fit.pushes.shift, fit.pushes.shift_std, fit.pushes.drift, fit.pushes.drift_std
    values, std = fit.values, fit.std
    at = (force_torque.SHIFT, force_torque.DRIFT)
    return tuple(float(part[k]) for k in at for part in (values, std))  # type: ignore[return-value]


def ft_turn(fit: FtFit) -> tuple[np.ndarray, np.ndarray]:
    """Rotation vector of R_FS (3,) and its deviation, by weight if that tells the axes, else by the pushes; NaN if
    not."""
    values, std = fit.values[force_torque.ROTATION], fit.std[force_torque.ROTATION]
    if np.isnan(std).any() and fit.pushes is not None:
        return fit.pushes.turn, fit.pushes.turn_std
    return values, std


def _imu(
    found: Sequence[Found], findings: list[str], tables: list[Numbers], uncertainty: dict[str, Any]
) -> dict[str, Any]:
    fits = [item.imu for item in found if item.imu is not None]
    values, std = np.array([item.values for item in fits]), np.array([item.std for item in fits])
    mean, mean_std = together(values, std)
    half = NINETY_FIVE * mean_std
    logs = tuple(item.source for item in fits)
    for title, which, units in _IMU_HEADS:
        names, scale = imu.NAMES[which], _IMU_UNITS[which]
        rows = np.concatenate([values, mean[None]])[:, which] * scale
        widths = np.concatenate([NINETY_FIVE * std, half[None]])[:, which] * scale
        tables.append(Numbers(title, units, (*logs, "together"), names, rows))
        tables.append(Numbers(f"{title}, half width of 95 % intervals", units, (*logs, "together"), names, widths))
    errors = np.array([np.concatenate([item.before, item.after]) for item in fits])
    heads = tuple(f"{what} {axis} {when}" for when in ("before", "after") for what in ("acc", "gyro") for axis in _AXES)
    tables.append(Numbers("Error below 4 Hz, root mean square", "m/s^2, rad/s", logs, heads, errors))
    place, apart = mean[imu.PLACE], mean[imu.PLACE] - np.mean([item.p_FA for item in found], axis=0)
    findings += [
        "IMU: measures at " + _listed(1e3 * place, 1e3 * half[imu.PLACE]) + " mm in the flange frame (95 %), "
        f"{1e3 * np.linalg.norm(apart):.1f} mm from where the tool says",
        "IMU: turned against the flange by " + _listed(1e3 * mean[imu.ROTATION], 1e3 * half[imu.ROTATION]) + " mrad",
        f"IMU: the robot's clock gains {1e6 * mean[imu.DRIFT]:.0f} ± {1e6 * half[imu.DRIFT]:.0f} ppm on its stamps",
        f"IMU: its time 0 lies {1e3 * mean[imu.SHIFT]:.1f} ± {1e3 * half[imu.SHIFT]:.1f} ms on the robot's "
        f"clock beside "
        "where the log puts it",
    ]
    uncertainty["imu"] = {name: float(width) for name, width in zip(imu.NAMES, half, strict=True)}
    shift, offset = float(mean[imu.SHIFT]), [item.offset for item in fits if item.offset is not None]
    return _clock(shift, offset, float(mean[imu.DRIFT])) | {
        "mount_rotation_rad": mean[imu.ROTATION].tolist(),
        "mount_shift_mm": (1e3 * apart).tolist(),
        "acceleration": {"gain": mean[imu.ACC_GAIN].tolist(), "bias": mean[imu.ACC_BIAS].tolist()},
        "rate": {"gain": mean[imu.GYRO_GAIN].tolist(), "bias": mean[imu.GYRO_BIAS].tolist()},
    }


def _ft(
    found: Sequence[Found], findings: list[str], tables: list[Numbers], uncertainty: dict[str, Any]
) -> dict[str, Any]:
    fits = [item.ft for item in found if item.ft is not None]
    logs = tuple(item.source for item in fits)
    values, std = np.array([item.values for item in fits]), np.array([item.std for item in fits])
    clock = np.array([ft_shift(item) for item in fits])
    turns = np.array([np.concatenate(ft_turn(item)) for item in fits])
    bias, bias_std = together(values[:, force_torque.BIAS], std[:, force_torque.BIAS])
    # At rest gears stick and the servo's integral answers late: logs in motion know better.
    moved = np.array([item.turns for item in fits])
    best = moved if moved.any() else np.ones(len(fits), dtype=bool)
    shift, shift_std = together(clock[best, :1], clock[best, 1:2])
    drift, drift_std = together(clock[best, 2:3], clock[best, 3:])
    axes = force_torque.NAMES[force_torque.BIAS]
    tables.append(
        Numbers(
            "Bias of the force sensor",
            "N, Nm",
            (*logs, "together"),
            axes,
            np.vstack([values[:, force_torque.BIAS], bias]),
        )
    )
    tables.append(
        Numbers(
            "Bias, half width of 95 % intervals",
            "N, Nm",
            (*logs, "together"),
            axes,
            NINETY_FIVE * np.vstack([std[:, force_torque.BIAS], bias_std]),
        )
    )
    beyond = slice(force_torque.MASS, force_torque.MOMENT.stop)
    heads = ("mass", "m cx", "m cy", "m cz", *(f"± {name}" for name in ("mass", "m cx", "m cy", "m cz")))
    load = 1e3 * np.concatenate([values[:, beyond], NINETY_FIVE * std[:, beyond]], axis=1)
    tables.append(Numbers("What hangs beyond the sensor", "g and g m, about the flange", logs, heads, load))
    timing = np.stack(
        [1e3 * clock[:, 0], 1e3 * NINETY_FIVE * clock[:, 1], 1e6 * clock[:, 2], 1e6 * NINETY_FIVE * clock[:, 3]], axis=1
    )
    tables.append(Numbers("Clock of the force sensor", "ms, ppm", logs, ("shift", "±", "drift", "±"), timing))
    turned = 1e3 * np.concatenate([turns[:, :3], NINETY_FIVE * turns[:, 3:]], axis=1)
    heads = (*(f"rotation {axis}" for axis in _AXES), *(f"± {axis}" for axis in _AXES))
    tables.append(Numbers("Mounting of the force sensor", "mrad", logs, heads, turned))
    shares = [np.full(6, np.nan) if item.pushes is None else item.pushes.explained for item in fits]
    joints = tuple(f"joint {j}" for j in range(1, 7))
    tables.append(Numbers("Share of the currents that the pushes explain", "1", logs, joints, np.array(shares)))
    errors = np.array([np.concatenate([item.before, item.after]) for item in fits])
    heads = tuple(f"{axis} {when}" for when in ("before", "after") for axis in WRENCH_AXES)
    tables.append(Numbers("Error without contact, root mean square", "N, Nm", logs, heads, errors))
    findings += [
        "force sensor: bias " + _listed(bias, NINETY_FIVE * bias_std) + " N and Nm (95 %)",
        f"force sensor: its rows are {-1e3 * shift[0]:.1f} ± {1e3 * NINETY_FIVE * shift_std[0]:.1f} ms late"
        + ("" if best.all() else " (logs in motion alone: at rest gears stick and the servo answers late)"),
    ]
    findings += [
        f"{item.source}: one orientation, bias and weight cannot be told apart beyond what the tool's table says"
        for item in fits
        if not item.turns
    ]
    findings += [
        f"{item.source}: what the sensor reads without contact is not one weight turned about ({name}); too "
        f"little hangs on "
        "it, or something else pulls: its axes are not told by weight"
        for item in fits
        if item.turns and np.isnan(item.std[force_torque.ROTATION]).any()
        for name in (f"{1e3 * item.values[force_torque.MASS]:.0f} g",)
    ]
    uncertainty["force_torque"] = {
        "bias": (NINETY_FIVE * bias_std).tolist(),
        "shift_s": float(NINETY_FIVE * shift_std[0]),
        "drift": float(NINETY_FIVE * drift_std[0]),
    }
    offset = [item.offset for item in fits if item.offset is not None]
    slow = float(drift[0]) if abs(drift[0]) > NINETY_FIVE * drift_std[0] else 0.0
    # The shift is the logs' middle's; the twin's clock drifts from its time 0.
    middle = float(np.mean([item.time.mean() for item, used in zip(fits, best, strict=True) if used]))
    written = _clock(float(shift[0]) - slow * middle, offset, slow) | {"bias": bias.tolist()}
    told = [turn for turn in turns[best] if np.isfinite(turn).all() and (turn[3:] < _TOLD).all()]
    if told:
        turn, turn_std = together(np.array(told)[:, :3], np.array(told)[:, 3:])
        findings.append(
            "force sensor: turned against the flange by " + _listed(1e3 * turn, 1e3 * NINETY_FIVE * turn_std) + " mrad"
        )
        written["mount_rotation_rad"] = turn.tolist()
        uncertainty["force_torque"]["mount_rotation_rad"] = (NINETY_FIVE * turn_std).tolist()
    return written


def _clock(shift: float, offsets: list[float], drift: float) -> dict[str, Any]:
    """A device's clock in the layout of the file. Where the host's stamps put the device, the shift is its rows' delay;
    where nothing does, delay and begin of its clock are one number."""
    if offsets and shift <= 0.0:
        offset, delay = float(np.median(offsets)), -shift
    else:
        offset, delay = (float(np.median(offsets)) if offsets else 0.0) + shift, 0.0
    return {"clock_offset_ms": 1e3 * offset, "delay_ms": 1e3 * delay, "clock_drift_ppm": 1e6 * drift}


def _listed(values: np.ndarray, half: np.ndarray) -> str:
    return ", ".join(f"{v:.3g} ± {h:.2g}" for v, h in zip(values, half, strict=True))


def _merged(known: dict[str, Any], found: dict[str, Any]) -> dict[str, Any]:
    """``known`` with what was found over it, table by table."""
    return known | {
        key: _merged(known[key], value) if isinstance(value, dict) and isinstance(known.get(key), dict) else value
        for key, value in found.items()
    }


def _without_nothing(data: Any) -> Any:
    """TOML has no null."""
    return {k: _without_nothing(v) for k, v in data.items() if v is not None} if isinstance(data, dict) else data
