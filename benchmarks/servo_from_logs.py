"""What the lab logs say about the real servo, its wrench estimate, and the joints' torque constants and friction.

    python benchmarks/servo_from_logs.py LOGS

LOGS is a folder with one folder per movement. Prints the tables of docs/servo.md.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import numpy as np
from lab_runs import THESIS_RUN
from scipy.spatial import KDTree

from ur5_twin.arm.parameters import load_model
from ur5_twin.control.target_current import TargetCurrentLaw, load_target_current_law
from ur5_twin.control.tcp_force import TcpForce
from ur5_twin.drives import terms
from ur5_twin.evaluation.tables import JOINT_COLUMNS, markdown
from ur5_twin.identification import drive, drive_plant, servo
from ur5_twin.recording import read
from ur5_twin.recording.table import Recording

#: Rows after which the unknown start of the controller's average counts for a thousandth: (29/31)^100.
FORGOTTEN = 100
#: Delays of the force sensor that are tried, s.
DELAYS = np.arange(0.0, 0.161, 0.005)
WRENCH = ("Fx N", "Fy N", "Fz N", "Mx Nm", "My Nm", "Mz Nm")
INPUTS = ("actual_q", "actual_qd", "actual_current", "target_qd", "target_moment", "target_current")
SAME_PATH = "No9_Singularity_Free_NoDist"
RIDES = ("No3_", "No4_", "No5_", "No6_", "No9_Singularity_Free_NoDist")


def numbers(values: np.ndarray, digits: int) -> list[str]:
    return ["-" if np.isnan(value) else f"{value:.{digits}f}" for value in values]


def wrench_tables(recordings: list[Recording]) -> str:
    """MAE of the reconstructed actual_TCP_force, and its root mean square over the signal's spread."""
    mae, relative = [], []
    for recording in recordings:
        robot = recording.robot
        estimate = TcpForce(load_model("controller"))
        estimate.start(robot["actual_q"][0], robot["actual_TCP_force"][0])
        error = (estimate(*(robot[name] for name in INPUTS)) - robot["actual_TCP_force"])[FORGOTTEN:]
        spread = robot["actual_TCP_force"][FORGOTTEN:].std(axis=0)
        mae.append((recording.source, *numbers(np.abs(error).mean(axis=0), 4)))
        relative.append((recording.source, *numbers(1e6 * np.sqrt((error**2).mean(axis=0)) / spread, 0)))
    heads = ("log", *WRENCH)
    return (
        f"actual_TCP_force, MAE:\n\n{markdown(heads, mae)}\n\n"
        f"its root mean square error over the signal's own spread, parts per million:\n\n{markdown(heads, relative)}\n"
    )


def sensor_delay(pushed: Recording, free: Recording, law: TargetCurrentLaw) -> tuple[float, str]:
    """Delay of the force sensor and torque constants, from one path driven free and pushed.

    The difference of the currents at equal targets is free of gravity, friction and ripple of the gears; it is
    explained by the push and by load-dependent friction.
    """

    def key(recording: Recording) -> np.ndarray:
        return np.concatenate([recording.robot["target_q"], 0.3 * recording.robot["target_qd"]], axis=1)

    arm = load_model("plant", "ati_gamma")
    assert arm.tool is not None
    other = terms.ride(free, load_model("plant", "xsens_mti"), law)
    distance, found = KDTree(key(free)).query(key(pushed))
    match = np.asarray(found)
    rows = []
    for delay in DELAYS:
        contact = servo.external_torque(pushed, arm, arm.tool.sensors["ati_gamma"], delay)
        ride = terms.ride(pushed, arm, law, tau_ext=contact)
        constant, explained = np.full(6, np.nan), np.full(6, np.nan)
        for j in range(5):
            use = (distance < 0.004) & (np.abs(ride.qd[:, j]) > 0.03)
            sign = np.sign(ride.qd[use, j])
            load = (np.abs(ride.link[use, j]) - np.abs(other.link[match[use], j])) * sign
            columns = np.stack([ride.torque[use, j] - other.torque[match[use], j], load, sign, np.ones(use.sum())], 1)
            answer = ride.current[use, j] - other.current[match[use], j]
            x = np.linalg.lstsq(columns, answer, rcond=None)[0]
            constant[j], explained[j] = 1.0 / x[0], 1.0 - (answer - columns @ x).var() / answer.var()
        rows.append((delay, constant, explained))
    best = max(rows, key=lambda row: np.nanmean(row[2]))
    shown = [r for r in rows if round(r[0] * 1e3) % 20 == 0 or r is best]
    table = markdown(
        ("delay ms", *(f"k {j} Nm/A" for j in range(1, 6)), *(f"explained {j}" for j in range(1, 6))),
        [(f"{d * 1e3:.0f}", *numbers(k[:5], 2), *numbers(e[:5], 3)) for d, k, e in shown],
        words=0,
    )
    return float(best[0]), table


def print_fit(fit: drive_plant.PlantDrive) -> None:
    names = (
        "torque_constant",
        "coulomb_positive",
        "coulomb_negative",
        "load",
        "stribeck",
        "stribeck_speed",
        "viscous",
    )
    rows = [(name, getattr(fit, name)) for name in names]
    rows += [(f"ripple {order[0]:.0f}", size) for order, size in zip(fit.order, fit.amplitude, strict=True)]
    for name, values in rows:
        print(f"{name:17s} [{', '.join(f'{value:.4g}' for value in values)}]")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, help="a folder with one folder per movement")
    options = parser.parse_args()
    if not any(options.logs.glob("Movement_*")):
        parser.error(f"no Movement_* folder in {options.logs}")
    recordings = [read(folder) for folder in sorted(options.logs.glob("Movement_*"))]
    named = {r.source.removeprefix("Movement_"): r for r in recordings}
    law = load_target_current_law()

    print(wrench_tables(recordings))

    print("share of the rows at rest whose target_q is actual_q of the row before:\n")
    print(markdown(("log", "share"), [(r.source, f"{servo.holds_last_position(r):.3f}") for r in recordings]) + "\n")

    still = [r for r in recordings if not np.any(r.robot["target_qd"])]
    fit = servo.fit_servo(still, load_model("controller"), law.torque_constant)
    print("the servo at standstill, in the controller's own Nm:\n")
    parts = (("Kp Nm/rad", fit.kp, 0), ("Kd Nm s/rad", fit.kd, 0), ("Ki Nm/(rad s)", fit.ki, 0))
    rows = [
        (r.source, name, *numbers(values[n], digits))
        for (n, r), (name, values, digits) in itertools.product(
            enumerate(still), (*parts, ("explained", fit.explained, 3), ("mass kg m^2", fit.mass, 3))
        )
    ]
    print(markdown(("log", "", *JOINT_COLUMNS), rows, words=2) + "\n")
    for name, values in zip(("Kp", "Kd", "Ki"), fit.means(), strict=True):
        print(f"{name}      {', '.join(numbers(values, 0))}")
    for name, values in zip(("kappa0", "kappa1", "kappai"), fit.kappas(), strict=True):
        print(f"{name}  {', '.join(numbers(values, 0))}")
    for joint, n in itertools.product(range(2), range(len(still))):
        way = 1e3 * (still[n].robot["actual_q"] - still[n].robot["actual_q"][0])[:, joint]
        print(f"joint {joint + 1} moves {way.min():.3f} to {way.max():.3f} mrad in {still[n].source}")

    delay, table = sensor_delay(named[THESIS_RUN], named[SAME_PATH], law)
    print(f"\none path free and pushed; the force sensor comes {delay * 1e3:.0f} ms late:\n\n{table}\n")
    arm = load_model("plant", "ati_gamma")
    assert arm.tool is not None
    rides = [
        terms.ride(r, load_model("plant", "xsens_mti" if "imu" in r.tables else None), law)
        for name, r in named.items()
        if name.startswith(RIDES)
    ]
    contact = servo.external_torque(named[THESIS_RUN], arm, arm.tool.sensors["ati_gamma"], delay)
    pushed = terms.ride(named[THESIS_RUN], arm, law, tau_ext=contact)
    print("friction and torque constants, free and pushed logs together:\n")
    print_fit(drive_plant.fit_plant([*rides, pushed]))
    print("\nfree logs only:\n")
    print_fit(drive_plant.fit_plant(rides))
    rows = []
    for k, unseen in enumerate(rides):
        others = drive_plant.fit_plant([*(r for i, r in enumerate(rides) if i != k), pushed])
        found = drive.score(unseen, others.current(unseen))
        for name, values in (
            ("moving", found.moving),
            ("at rest", found.resting),
            ("target_current, moving", found.own_moving),
        ):
            rows.append((unseen.source, name, *numbers(values, 3)))
    print("\nMAE of the current in A by a fit on the other logs, and the controller's own:\n")
    print(markdown(("log", "", *JOINT_COLUMNS), rows, words=2))
    print("\nviscous friction over the law's mean, by the controller's correction for temperature, median per log:\n")
    rows = [(r.source, *numbers(np.median(r.ratio, axis=0), 3)) for r in rides]
    print(markdown(("log", *JOINT_COLUMNS), rows))


if __name__ == "__main__":
    main()
