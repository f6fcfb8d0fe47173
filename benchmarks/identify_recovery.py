"""Whether ``identify plant`` finds the numbers of a plant that is known, and whether its intervals hold.

    python benchmarks/identify_recovery.py [--seeds 120] [--jobs 2] [--ideal] [--out out/recovery.jsonl]

The twin records 120 s of ``control.excitation`` eight times, with the sensors of the preset "lab" and a known load off
the flange's axis. Each seed draws the noise anew and fits the first recording alone, then all eight. Two more are of
the motion for a payload, with one that is sought and with none: the first is fitted alone, then beside the second.
Every fourth seed is of a plant whose every number differs from the base's that the fit is given. Seeds that are in the
file already are not run again; the tables of docs/plant.md are printed from all that are. With ``--ideal`` there is no
noise: what is left is what the windows bias.
"""

from __future__ import annotations

import os

# One thread a process: the matrices are small.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import math
import multiprocessing
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from ur5_twin.arm.drive import JointDrives, load_joint_drives
from ur5_twin.arm.parameters import ArmModel, load_model
from ur5_twin.control.excitation import DRIVES, PAYLOAD, Waves, excitation
from ur5_twin.control.gains import load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.evaluation.tables import JOINT_COLUMNS, markdown
from ur5_twin.identification.body import Body
from ur5_twin.identification.plant import fit_plant
from ur5_twin.identification.plant_solve import FIELDS
from ur5_twin.identification.plant_windows import motion
from ur5_twin.identification.spread import NINETY_FIVE
from ur5_twin.recording.table import Recording
from ur5_twin.sensing import Measuring, Signals, load_sensors
from ur5_twin.terminal import progress
from ur5_twin.twin.cell import PERIOD, Cell, Setup
from ur5_twin.twin.closed_loop import Limits
from ur5_twin.twin.setup import carrying
from ur5_twin.twin.telemetry import Telemetry

#: s of each recording, and their number.
DURATION, LOGS = 120.0, 8
#: Seed of the first recording's motion; it is the one that the excitation was searched with.
MOTION = 41
#: The load that is known: 2.2 kg, its centre in the flange frame in m, and 30 mm of gyration.
KNOWN = Body(2.2, np.array([0.19, 0.0, 0.05]), 2.2 * 0.03**2 * np.eye(3))
#: The one that is sought, and none.
SOUGHT = Body(4.4, np.array([0.19, 0.0, 0.05]), 4.4 * 0.03**2 * np.eye(3))
NONE = Body(0.0, np.zeros(3), np.zeros((3, 3)))
#: Every how many seeds the plant is another one, and by how much its numbers spread (logarithm).
OTHER, SPREAD = 4, 0.15
#: What was aimed at, share of the truth.
AIMS = {
    "torque_constant": 0.01,
    "rotor_inertia": 0.02,
    "coulomb_positive": 0.05,
    "coulomb_negative": 0.05,
    "viscous": 0.05,
    "load": 0.10,
}


def other_plant(seed: int) -> tuple[ArmModel, JointDrives]:
    """A plant with other numbers than the one that ships, small joints' load-dependent friction among them."""
    rng = np.random.default_rng([2026, seed])
    plant, drives = load_model("plant"), load_joint_drives()

    def spread() -> np.ndarray:
        return np.exp(SPREAD * rng.standard_normal(6))

    friction = drives.friction
    level = spread()
    friction = replace(
        friction,
        coulomb_positive=friction.coulomb_positive * level,
        coulomb_negative=friction.coulomb_negative * level * np.exp(0.05 * rng.standard_normal(6)),
        # The shares that fade differ too, but never more than there is.
        stribeck=friction.stribeck * level * rng.uniform(0.6, 0.95, 6),
        stribeck_speed=friction.stribeck_speed * spread(),
        load=np.where(friction.load > 0, friction.load * spread(), rng.uniform(0.0, 0.05, 6)),
        viscous=friction.viscous * spread(),
    )
    drives = replace(drives, torque_constant=drives.torque_constant * spread(), friction=friction)
    return replace(plant, rotor_inertia=plant.rotor_inertia * spread()), drives


def record(plant: ArmModel, drives: JointDrives, body: Body, waves: Waves, seed: int) -> tuple[Recording, Signals]:
    """One recording without sensor noise, and what its noise is to be added to."""
    rows = excitation(DURATION, waves, seed=seed)
    load = (body.mass, body.center, body.inertia)
    setup = Setup(
        controller=carrying(load_model("controller"), *load),
        plant=carrying(plant, *load),
        gains=load_gains("servo"),
        law=load_target_current_law(),
        drives=drives,
        limits=Limits(math.inf, math.inf, math.inf),
        q_start=rows[0, 0],
    )
    cell = Cell(setup)
    telemetry = Telemetry(setup, cell.geoms, load_sensors("ideal"), np.random.default_rng(0))
    for begin in range(1, len(rows), 1000):
        for piece in cell.advance(rows[begin : begin + 1000]):
            telemetry.observe(piece)
    assert cell.failure is None, cell.failure
    recording = telemetry.recording(f"excitation {seed}")
    robot = recording.robot
    q, qd, qdd, wrench = (robot[name] for name in ("truth_q", "truth_qd", "truth_qdd", "truth_wrench"))
    return recording, Signals(robot.time, q, qd, qdd, robot["actual_current"], wrench)


def records_of(plant: ArmModel, drives: JointDrives) -> list[tuple[Recording, Signals]]:
    """Those with the known load, one with the load that is sought, and one without."""
    known = [record(plant, drives, KNOWN, DRIVES, MOTION + k) for k in range(LOGS)]
    return [*known, *(record(plant, drives, body, PAYLOAD, MOTION + k) for k, body in enumerate((SOUGHT, NONE)))]


@lru_cache(maxsize=1)
def usual_records() -> list[tuple[Recording, Signals]]:
    return records_of(load_model("plant"), load_joint_drives())


def one_seed(seed: int, ideal: bool = False) -> dict:
    """Errors and intervals of one seed, as JSON has them."""
    base_plant, base = load_model("plant"), load_joint_drives()
    differs = seed % OTHER == OTHER - 1
    plant, drives = other_plant(seed) if differs else (base_plant, base)
    records = records_of(plant, drives) if differs else usual_records()
    suite = load_sensors("lab")
    motions = []
    for k, (recording, clean) in enumerate(records):
        noise = Measuring(suite, base_plant, np.random.default_rng([seed, k]), period=PERIOD)
        measured = noise.robot(clean, 0, 1)
        columns = {name: measured[name] for name in ("actual_q", "actual_qd", "actual_current")}
        seen = recording if ideal else recording.with_table(recording.robot.with_columns(columns))
        motions.append(motion(seen, base_plant, payload=True))
    known = [replace(of.carrying(KNOWN.phi), sought=of.sought[:, :, :0]) for of in motions[:LOGS]]
    loaded, bare = motions[LOGS], motions[LOGS + 1].bare()
    truth = {name: getattr(drives.friction, name) for name in tuple(FIELDS)[2:]}
    truth |= {"torque_constant": drives.torque_constant, "rotor_inertia": plant.rotor_inertia}
    found = {"seed": seed, "other_plant": differs, "truth": {name: truth[name].tolist() for name in FIELDS}}
    cases = {"one": known[:1], "all": known, "one_sought": [loaded], "one_bare": [loaded, bare]}
    for name, used in cases.items():
        fit = fit_plant(used, base, base_plant.rotor_inertia)
        found[name] = {
            field: {
                "value": fit.values[field].tolist(),
                "low": [None if np.isnan(x) else float(x) for x in fit.low[field]],
                "high": [None if np.isnan(x) else float(x) for x in fit.high[field]],
            }
            for field in FIELDS
        } | {"delay": fit.delay}
        if fit.payload is not None:
            (mass, std), (center, center_std) = fit.payload.mass, fit.payload.center
            found[name]["payload"] = {"value": [mass, *center.tolist()], "std": [std, *center_std.tolist()]}
    return found


def payload_table(rows: Sequence[dict], which: str, title: str) -> str:
    """Error and coverage of the payload's mass and centre."""
    value, std = (np.array([row[which]["payload"][what] for row in rows]) for what in ("value", "std"))
    error = value - np.array([SOUGHT.mass, *SOUGHT.center])
    holds = (np.abs(error) <= NINETY_FIVE * std).mean(axis=0)
    unit = np.array([1.0, 1e3, 1e3, 1e3])
    lines = [
        ("mean error", *(f"{x:.3g}" for x in unit * error.mean(axis=0))),
        ("spread", *(f"{x:.3g}" for x in unit * error.std(axis=0))),
        ("intervals that hold, %", *(f"{100 * x:.0f}" for x in holds)),
    ]
    return f"{title}:\n\n{markdown(('', 'mass, kg', 'x, mm', 'y, mm', 'z, mm'), lines)}\n"


def tables(rows: Sequence[dict], which: str, title: str) -> str:
    """Error, share within the aim and coverage for each number and joint."""
    lines = []
    for field in FIELDS:
        truth = np.array([row["truth"][field] for row in rows])
        value = np.array([row[which][field]["value"] for row in rows])
        low, high = (np.array([row[which][field][end] for row in rows], dtype=float) for end in ("low", "high"))
        told = np.isfinite(low)
        holds = np.where(told, (low <= truth) & (truth <= high), False)
        relative = np.divide(value - truth, truth, out=np.full(truth.shape, np.nan), where=truth != 0)
        relative[~told] = np.nan

        def line(what: str, numbers: np.ndarray, digits: int, field: str = field) -> tuple[str, ...]:
            return (field, what, *("-" if not np.isfinite(x) else f"{x:.{digits}f}" for x in numbers))

        with np.errstate(invalid="ignore", divide="ignore"):
            count = told.sum(axis=0)
            counted = np.isfinite(relative).sum(axis=0)
            mean = np.nansum(relative, axis=0) / counted
            spread = np.sqrt(np.nansum((relative - mean) ** 2, axis=0) / counted)
            lines.append(line("mean error, %", 100 * mean, 2))
            lines.append(line("spread, %", 100 * spread, 2))
            if field in AIMS:
                within = np.nansum(np.abs(relative) <= AIMS[field], axis=0) / counted
                lines.append(line(f"within {100 * AIMS[field]:.0f} %, % of seeds", 100 * within, 0))
            lines.append(line("intervals that hold, %", 100 * holds.sum(axis=0) / count, 0))
            lines.append(line("told, % of seeds", 100 * told.mean(axis=0), 0))
    return f"{title}, {len(rows)} seeds:\n\n{markdown(('number', '', *JOINT_COLUMNS), lines, words=2)}\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=120)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--out", type=Path, default=Path("out/recovery.jsonl"), help="one line a seed; goes on from there"
    )
    parser.add_argument("--ideal", action="store_true", help="without noise; give another --out")
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    done = {}
    if options.out.exists():
        done = {row["seed"]: row for row in map(json.loads, options.out.read_text(encoding="utf-8").splitlines())}
    left = [seed for seed in range(options.seeds) if seed not in done]
    context = multiprocessing.get_context("spawn")
    with (
        context.Pool(options.jobs) as pool,
        options.out.open("a", encoding="utf-8") as file,
        progress("seeds", options.seeds) as advance,
    ):
        for row in pool.imap_unordered(partial(one_seed, ideal=options.ideal), left):
            done[row["seed"]] = row
            file.write(json.dumps(row) + "\n")
            file.flush()
            advance(len(done))
    rows = [done[seed] for seed in sorted(done)]
    same, other = [r for r in rows if not r["other_plant"]], [r for r in rows if r["other_plant"]]
    for which, logs in (
        ("one", "One recording of 120 s"),
        ("all", f"{LOGS} recordings of 120 s"),
        ("one_sought", "One recording of 120 s, the load sought"),
        ("one_bare", "One recording of 120 s with the load, which is sought, and one without it"),
    ):
        print(tables(rows, which, f"{logs}, all plants"))
        if "payload" in rows[0][which]:
            print(payload_table(rows, which, f"{logs}, what is found of it"))
        if which == "all" and same and other:
            print(tables(other, which, f"{logs}, other plants only"))


if __name__ == "__main__":
    main()
