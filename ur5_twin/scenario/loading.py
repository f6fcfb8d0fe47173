"""From scenario files to scenarios."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ur5_twin import spatial
from ur5_twin.arm import inverse_kinematics, kinematics
from ur5_twin.arm.mjcf.obstacles import Obstacle
from ur5_twin.arm.parameters import ArmModel, load_model, load_tool
from ur5_twin.control.gains import load_gains
from ur5_twin.errors import ModelError, ScenarioError, unknown
from ur5_twin.resources import data_dir
from ur5_twin.scenario import files
from ur5_twin.scenario.motions import Motion, MoveJ, MoveL, ServoJ, Wait, Waypoints
from ur5_twin.scenario.pushes import LogPush, Push
from ur5_twin.scenario.scenario import (
    Arm,
    Mismatch,
    Payload,
    Scenario,
    Sensors,
    StopLimits,
    Temperature,
)
from ur5_twin.sensing import load_sensors

#: Where the arm stands if nothing else is said: bent, as the lab's run No9 begins.
DEFAULT_START = np.array([2.18, -2.135, -1.745, 0.276, -6.02, 0.0])


def scenario_names() -> tuple[str, ...]:
    """Names of the scenarios that ship."""
    return tuple(sorted(path.stem for path in data_dir("scenarios").glob("*.toml")))


def load_scenario(name: str | Path) -> Scenario:
    """A scenario by name or from a file.

    Args:
        name: one of ``scenario_names()``, or a path to a ``.toml`` file. Files that it names lie beside it.

    Raises:
        ScenarioError: the name is unknown, the file cannot be read, a key is unknown or missing, or a value is
            impossible; the message names the key.
    """
    if str(name).endswith(".toml"):
        path = Path(name)
    elif str(name) in scenario_names():
        path = data_dir("scenarios") / f"{name}.toml"
    else:
        said = unknown("scenario", str(name), scenario_names())
        raise ScenarioError(f"{said}, or give the path of a .toml file")
    spec = files.read(path)
    return _Loader(path, spec).scenario()


class _Loader:
    """One file on its way; it knows the file's place and the arm, which every section needs."""

    def __init__(self, path: Path, spec: files.ScenarioFile) -> None:
        self._path = path
        self._spec = spec
        self._arm, self._model = self._load_arm()

    def scenario(self) -> Scenario:
        spec = self._spec
        if not spec.title.strip() or not spec.description.strip():
            raise self._error("title" if not spec.title.strip() else "description", "must not be empty")
        q_start = self._start()
        return Scenario(
            name=self._path.stem,
            path=self._path,
            title=spec.title,
            description=spec.description,
            seed=spec.seed,
            duration=spec.duration_s,
            settle=spec.settle_s,
            arm=self._arm,
            q_start=q_start,
            motions=self._motions(q_start),
            obstacles=self._obstacles(),
            pushes=tuple(self._push(f"push[{i}]", push) for i, push in enumerate(spec.push)),
            payloads=self._payloads(),
            mismatch=self._mismatch(),
            temperature=self._temperature(),
            sensors=self._sensors(),
            limits=StopLimits(
                force=_or_infinite(spec.limits.force_n),
                deviation=spec.limits.deviation_rad,
                speed=spec.limits.speed_factor,
            ),
        )

    # ------------------------------------------------------------ the arm

    def _load_arm(self) -> tuple[Arm, ArmModel]:
        spec = self._spec.arm
        with self._at("arm.controller"):
            controller = self._beside(spec.controller)
            load_model(controller)
        with self._at("arm.plant"):
            plant = self._beside(spec.plant)
            model = load_model(plant)
        with self._at("arm.tool"):
            tool = self._tool(spec.tool)
            model = model.with_tool(load_tool(tool))
        with self._at("arm.declared_payload"):
            declared = self._tool(spec.declared_payload)
            load_tool(declared)
        with self._at("arm.gains"):
            gains = self._beside(spec.gains)
            load_gains(gains)
        return Arm(controller, plant, tool, declared, gains), model

    def _tool(self, name: str) -> str:
        return "+".join(str(self._beside(layer)) for layer in name.split("+"))

    def _sensors(self) -> Sensors:
        spec = self._spec.sensors
        with self._at("sensors.preset"):
            preset = str(self._beside(spec.preset))
            load_sensors(preset)
        return Sensors(preset, spec.late_packages)

    def _start(self) -> np.ndarray:
        spec = self._spec.start
        near = DEFAULT_START if spec.near_deg is None else np.radians(spec.near_deg)
        q = self._joint_target("start", spec, near)
        return DEFAULT_START.copy() if q is None else q

    def _joint_target(self, key: str, spec: files.StartSpec | files.MoveJSpec, near: np.ndarray) -> np.ndarray | None:
        """Joint positions from one of q_rad, q_deg or a pose; None if none of them is given."""
        given = [name for name in ("q_rad", "q_deg", "position_mm") if getattr(spec, name) is not None]
        if len(given) > 1:
            raise self._error(key, f"give one of q_rad, q_deg and position_mm, not {' and '.join(given)}")
        if spec.rotation_rad is not None and spec.position_mm is None:
            raise self._error(f"{key}.rotation_rad", "needs position_mm beside it")
        if not given:
            return None
        if spec.position_mm is not None:
            if spec.rotation_rad is None:
                raise self._error(f"{key}.rotation_rad", "is missing beside position_mm")
            X = spatial.pose(spatial.rotation_from_vector(spec.rotation_rad), np.array(spec.position_mm) * 1e-3)
            return self._reached(f"{key}.position_mm", X, near)
        q = np.array(spec.q_rad) if spec.q_rad is not None else np.radians(np.array(spec.q_deg))
        limit = self._model.limits.q
        if (np.abs(q) > limit).any():
            joint = int(np.argmax(np.abs(q) > limit))
            raise self._error(
                f"{key}.{given[0]}[{joint}]",
                f"{q[joint]:.4g} rad is beyond the joint's limit of {limit[joint]:.4g} rad",
            )
        return q

    def _reached(self, key: str, X_BF: np.ndarray, near: np.ndarray) -> np.ndarray:
        q = inverse_kinematics.nearest(self._model, X_BF, near)
        if not np.isfinite(q).all():
            place = ", ".join(f"{value * 1e3:.0f}" for value in X_BF[:3, 3])
            raise self._error(key, f"the arm cannot reach ({place}) mm with this rotation")
        return q

    # ------------------------------------------------------------ what it does

    def _motions(self, q: np.ndarray) -> tuple[Motion, ...]:
        motions: list[Motion] = []
        # Where the arm is before a motion; unknown after a file, whose rows are the program's to read.
        last: np.ndarray | None = q
        for i, spec in enumerate(self._spec.motion):
            key = f"motion[{i}]"
            if isinstance(spec, files.WaitSpec):
                motions.append(Wait(spec.duration_s))
            elif isinstance(spec, files.ServoJSpec):
                motions.append(ServoJ(self._file(f"{key}.file", spec.file), spec.lookahead_s, spec.gain))
                last = None
            elif isinstance(spec, files.WaypointsSpec):
                motions.append(Waypoints(self._file(f"{key}.file", spec.file), spec.space, spec.wait_s))
                last = None
            elif isinstance(spec, files.MoveJSpec):
                last = self._move_j(key, spec, DEFAULT_START if last is None else last)
                motions.append(MoveJ(last, spec.speed_rad_s, spec.acceleration_rad_s2, spec.blend_mm * 1e-3))
            else:
                X, last = self._move_l(key, spec, last)
                motions.append(MoveL(X, spec.speed_m_s, spec.acceleration_m_s2, spec.blend_mm * 1e-3))
        return tuple(motions)

    def _move_j(self, key: str, spec: files.MoveJSpec, near: np.ndarray) -> np.ndarray:
        q = self._joint_target(key, spec, near)
        if q is None:
            raise self._error(key, "a movej needs q_rad, q_deg or position_mm")
        fastest = float(self._model.limits.qd.max())
        if spec.speed_rad_s > fastest:
            raise self._error(f"{key}.speed_rad_s", f"the arm's limit is {fastest:.4g} rad/s, not {spec.speed_rad_s:g}")
        return q

    def _move_l(self, key: str, spec: files.MoveLSpec, last: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        before = None if last is None else kinematics.forward(self._model, last)
        if (spec.position_mm is None) == (spec.by_mm is None and spec.turn_by_rad is None):
            raise self._error(key, "a movel needs position_mm, or by_mm and turn_by_rad or one of these")
        if spec.position_mm is not None:
            if spec.frame != "base":
                raise self._error(f"{key}.frame", "belongs to by_mm; position_mm is in the base frame")
            if spec.rotation_rad is not None:
                R = spatial.rotation_from_vector(spec.rotation_rad)
            elif before is not None:
                R = before[:3, :3]
            else:
                raise self._error(f"{key}.rotation_rad", "is missing, and after a file it is not known")
            X = spatial.pose(R, np.array(spec.position_mm) * 1e-3)
            where = "position_mm"
        else:
            where = "by_mm" if spec.by_mm is not None else "turn_by_rad"
            if spec.rotation_rad is not None:
                raise self._error(f"{key}.rotation_rad", "belongs to position_mm; beside by_mm use turn_by_rad")
            if before is None:
                raise self._error(f"{key}.{where}", "after a file it is not known where the arm is; use position_mm")
            shift = np.array(spec.by_mm or (0.0, 0.0, 0.0)) * 1e-3
            turn = spatial.rotation_from_vector(spec.turn_by_rad or (0.0, 0.0, 0.0))
            R, p = before[:3, :3], before[:3, 3]
            X = spatial.pose(turn @ R, p + shift) if spec.frame == "base" else spatial.pose(R @ turn, p + R @ shift)
        return X, self._reached(f"{key}.{where}", X, DEFAULT_START if last is None else last)

    # ------------------------------------------------------------ what is done to it

    def _obstacles(self) -> tuple[Obstacle, ...]:
        found: list[Obstacle] = []
        for i, spec in enumerate(self._spec.obstacle):
            key = f"obstacle[{i}]"
            if spec.name in [other.name for other in found]:
                raise self._error(f"{key}.name", f"there is another obstacle '{spec.name}'")
            if isinstance(spec, files.SphereSpec):
                size: Sequence[float] = (spec.radius_mm,)
            elif isinstance(spec, files.CylinderSpec):
                size = (spec.radius_mm, spec.height_mm)
            else:
                size = spec.size_mm
            with self._at(key):
                found.append(
                    Obstacle(
                        name=spec.name,
                        shape=type(spec).__struct_config__.tag,  # type: ignore[arg-type]
                        position=np.array(spec.position_mm) * 1e-3,
                        rotation=np.array(spec.rotation_rad),
                        size=np.array(size) * 1e-3,
                        stiffness=spec.stiffness_n_m,
                        damping=spec.damping_n_s_m,
                        friction=spec.friction,
                    )
                )
        return tuple(found)

    def _push(self, key: str, spec: files.PushSpec) -> Push | LogPush:
        self._check_time(f"{key}.at_s", spec.at_s)
        # The flange is the frame of link 6, so that what is said of a tool also holds where there is none.
        body = "wrist_3_link" if spec.body == "tool" and self._model.tool is None else spec.body
        point = np.array(spec.point_mm) * 1e-3
        if isinstance(spec, files.LogSpec):
            if spec.last_s is not None and spec.last_s <= spec.first_s:
                raise self._error(f"{key}.last_s", f"must be later than first_s ({spec.first_s:g})")
            path = self._file(f"{key}.log", spec.log)
            return LogPush(body, point, spec.at_s, path, spec.first_s, spec.last_s, spec.scale)
        peak = np.array([*spec.force_n, *spec.moment_nm])
        if not peak.any():
            raise self._error(f"{key}.force_n", "or moment_nm must be other than zero")
        rise = 0.0
        if isinstance(spec, files.RampSpec):
            rise = spec.rise_s
            if 2 * rise > spec.duration_s:
                raise self._error(f"{key}.rise_s", f"rise and fall must fit into duration_s ({spec.duration_s:g})")
        return Push(
            body,
            point,
            spec.frame == "body",
            type(spec).__struct_config__.tag,  # type: ignore[arg-type]
            spec.at_s,
            spec.duration_s,
            rise,
            peak,
        )

    def _payloads(self) -> tuple[Payload, ...]:
        payloads: list[Payload] = []
        for i, spec in enumerate(self._spec.payload):
            key = f"payload[{i}]"
            self._check_time(f"{key}.at_s", spec.at_s)
            if payloads and spec.at_s <= payloads[-1].at:
                raise self._error(
                    f"{key}.at_s", f"payloads come in order of time; the one before is at {payloads[-1].at:g}"
                )
            if spec.declared_at_s is not None:
                self._check_time(f"{key}.declared_at_s", spec.declared_at_s)
            x, y, z = sorted(spec.inertia_kg_m2)
            if z > (x + y) * (1 + 1e-9):
                raise self._error(f"{key}.inertia_kg_m2", "no body has one moment larger than the sum of the others")
            payloads.append(
                Payload(
                    spec.at_s,
                    spec.mass_kg,
                    np.array(spec.center_mm) * 1e-3,
                    np.diag(spec.inertia_kg_m2),
                    spec.declared_at_s,
                )
            )
        return tuple(payloads)

    def _mismatch(self) -> Mismatch:
        spec = self._spec.mismatch
        return Mismatch(
            link_mass_scale=np.array(spec.link_mass_scale),
            link_center_shift=np.array(spec.link_center_shift_mm) * 1e-3,
            rotor_scale=np.array(spec.rotor_scale),
            friction_scale=np.array(spec.friction_scale),
            torque_constant_scale=np.array(spec.torque_constant_scale),
            offset=np.array(spec.offset_nm),
            ripple_phase=np.array(spec.ripple_phase_rad),
            gravity_scale=spec.gravity_scale,
        )

    def _temperature(self) -> Temperature:
        spec = self._spec.temperature
        return Temperature(_or_infinite(spec.warm_for_s), spec.cold_viscous_ratio, spec.warming_time_s)

    # ------------------------------------------------------------ places and errors

    def _check_time(self, key: str, at: float) -> None:
        duration = self._spec.duration_s
        if duration is not None and at >= duration:
            raise self._error(key, f"{at:g} s is not before the end at {duration:g} s (duration_s)")

    def _beside(self, name: str) -> str | Path:
        """A name that ships, or a file of the user's beside the scenario."""
        return self._path.parent / name if name.endswith(".toml") else name

    def _file(self, key: str, name: str) -> Path:
        path = self._path.parent / name
        if not path.exists():
            raise self._error(key, f"there is no {path}")
        return path

    def _error(self, key: str, what: str) -> ScenarioError:
        return ScenarioError(f"{self._path.name}: {key}: {what}")

    @contextmanager
    def _at(self, key: str) -> Iterator[None]:
        try:
            yield
        except ModelError as error:
            raise self._error(key, str(error)) from None


def _or_infinite(value: float | None) -> float:
    return np.inf if value is None else value
