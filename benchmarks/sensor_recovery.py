"""How well ``identify sensor`` finds how simulated devices are mounted, biased and late.

    python benchmarks/sensor_recovery.py [SEEDS]

Each seed draws other devices (mounting, place, gain, bias, delay, drift) over the lab's noise and lets the arm move
freely with both sensors at its flange, the IMU of 50 g on the force sensor, pushed three times. Prints what was found
less what is true with 95 % intervals, and how many of the intervals hold.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import tomli_w

from ur5_twin.arm.parameters import load_model, load_tool
from ur5_twin.cli.common import quiet_engine
from ur5_twin.evaluation.tables import markdown
from ur5_twin.identification import force_torque, imu, sensor_result
from ur5_twin.identification.spread import NINETY_FIVE
from ur5_twin.scenario import load_scenario
from ur5_twin.scenario.pushes import Push
from ur5_twin.sensing.specs import load_suite
from ur5_twin.twin.scenario_run import ScenarioRun

_TOOL = "ati_gamma+xsens_mti"
#: When somebody pushes, s, and with what, N in the base's axes.
_PUSHES = ((9.0, (30.0, 0.0, 15.0)), (22.0, (0.0, 35.0, -20.0)), (38.0, (-25.0, 20.0, 25.0)))


def main() -> None:
    """Print the tables."""
    quiet_engine()
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    rows: dict[str, list[tuple[float, float]]] = {}
    for seed in range(seeds):
        for name, off, std in _of(seed):
            rows.setdefault(name, []).append((off, NINETY_FIVE * std))
    print(
        markdown(
            ("", "seed by seed: off ± half width of 95 %", "hold"), [_row(*item) for item in rows.items()], words=2
        )
    )
    inside = [abs(off) <= width for pairs in rows.values() for off, width in pairs]
    print(f"\n{np.mean(inside):.3f} of {len(inside)} intervals hold")


def _row(name: str, pairs: list[tuple[float, float]]) -> tuple[str, str, str]:
    told = ", ".join(f"{off:.2g} ± {width:.1g}" for off, width in pairs)
    return name, told, f"{sum(abs(off) <= width for off, width in pairs)}/{len(pairs)}"


def _of(seed: int) -> list[tuple[str, float, float]]:
    """Name, error and standard deviation of each number."""
    rng = np.random.default_rng(seed)
    turn = np.array([0.02, 0.02, 0.6]) * rng.standard_normal(3)
    true = {
        "ft_bias": np.array([5.0, 5.0, 5.0, 0.3, 0.3, 0.3]) * rng.standard_normal(6),
        "ft_mount": turn,
        "ft_shift": rng.uniform(-0.09, -0.02),
        "ft_drift": 2e-4 * rng.standard_normal(),
        "rotation": 0.05 * rng.standard_normal(3),
        "place": 0.02 * rng.standard_normal(3),
        "acc_gain": 1.0 + 0.02 * rng.standard_normal(3),
        "acc_bias": 0.1 * rng.standard_normal(3),
        "gyro_gain": 1.0 + 0.02 * rng.standard_normal(3),
        "gyro_bias": 0.03 * rng.standard_normal(3),
        "delay": rng.uniform(0.0, 0.05),
        "drift": 3e-3 * rng.standard_normal(),
    }
    recording = _recorded(true, seed)
    found = sensor_result.fit(recording, lambda name: load_model("plant", name), _TOOL, "lab")
    assert found.imu is not None
    assert found.ft is not None
    told: list[tuple[str, float, float]] = []
    for name, at in (("rotation", imu.ROTATION), ("acc_gain", imu.ACC_GAIN), ("acc_bias", imu.ACC_BIAS)):
        told += _compared(f"IMU {name}", found.imu.values[at], found.imu.std[at], true[name])
    told += _compared("IMU gyro_gain", found.imu.values[imu.GYRO_GAIN], found.imu.std[imu.GYRO_GAIN], true["gyro_gain"])
    told += _compared("IMU gyro_bias", found.imu.values[imu.GYRO_BIAS], found.imu.std[imu.GYRO_BIAS], true["gyro_bias"])
    told += _compared("IMU place", found.imu.values[imu.PLACE], found.imu.std[imu.PLACE], found.p_FA + true["place"])
    # Its rows are stamped on its own clock, whose time 0 the host's stamps put on the robot's: what is left is the
    # delay.
    told.append(("IMU delay s", found.imu.values[imu.SHIFT] + true["delay"], found.imu.std[imu.SHIFT]))
    told.append(("IMU drift", found.imu.values[imu.DRIFT] - true["drift"], found.imu.std[imu.DRIFT]))
    shift, shift_std, drift, drift_std = sensor_result.ft_shift(found.ft)
    own = found.ft.time.mean() - recording.robot.time[0]
    told.append(("F/T delay s", shift - true["ft_shift"] - true["ft_drift"] * own, shift_std))
    told.append(("F/T drift", drift - true["ft_drift"], drift_std))
    turned, turned_std = sensor_result.ft_turn(found.ft)
    told += _compared("F/T rotation", turned, turned_std, true["ft_mount"])
    bias = force_torque.BIAS
    told += _compared("F/T bias", found.ft.values[bias], found.ft.std[bias], true["ft_bias"])
    tool = load_tool(_TOOL)
    assert tool is not None
    mass, center, _ = tool.distal_to("ati_gamma")
    told.append(("mass beyond kg", found.ft.values[force_torque.MASS] - mass, found.ft.std[force_torque.MASS]))
    moment = force_torque.MOMENT
    told += _compared("mass times centre kg m", found.ft.values[moment], found.ft.std[moment], mass * center)
    if found.ft.pushes is not None:
        pushes = found.ft.pushes
        told.append(
            ("F/T delay by pushes s", pushes.shift - true["ft_shift"] - true["ft_drift"] * own, pushes.shift_std)
        )
    return told


def _compared(name: str, values: np.ndarray, std: np.ndarray, true: np.ndarray) -> list[tuple[str, float, float]]:
    return [(name, float(v - t), float(s)) for v, s, t in zip(values, std, true, strict=True)]


def _recorded(true: dict, seed: int):
    spec = msgspec.to_builtins(load_suite("lab"))
    spec.pop("provenance")
    spec["force_torque"] |= {
        "bias": true["ft_bias"].tolist(),
        "mount_rotation_rad": true["ft_mount"].tolist(),
        "delay_ms": -1e3 * true["ft_shift"],
        "clock_drift_ppm": 1e6 * true["ft_drift"],
    }
    spec["imu"] |= {
        "mount_rotation_rad": true["rotation"].tolist(),
        "mount_shift_mm": (1e3 * true["place"]).tolist(),
        "delay_ms": 1e3 * true["delay"],
        "clock_drift_ppm": 1e6 * true["drift"],
    }
    spec["imu"]["acceleration"] |= {"gain": true["acc_gain"].tolist(), "bias": true["acc_bias"].tolist()}
    spec["imu"]["rate"] |= {"gain": true["gyro_gain"].tolist(), "bias": true["gyro_bias"].tolist()}
    scenario = load_scenario("free_motion")
    pushes = tuple(_push(at, np.array(force)) for at, force in _PUSHES)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sensors.toml"
        path.write_text(tomli_w.dumps({"drawn": spec}), encoding="utf-8")
        scenario = replace(
            scenario,
            arm=replace(scenario.arm, tool=_TOOL),
            pushes=pushes,
            sensors=replace(scenario.sensors, preset=str(path)),
        )
        return ScenarioRun(scenario, seed).finish()


def _push(at: float, force: np.ndarray) -> Push:
    return Push(
        "tool", np.array([0.0, 0.0, 0.075]), False, "half_sine", at, 2.0, 0.0, np.concatenate([force, np.zeros(3)])
    )


if __name__ == "__main__":
    main()
