"""The estimators' nominal model, identified as a user would: free motion recorded, drives fitted to it.

The recordings are the twin's, of the arm without any deviation, with the lab's noise, on motions and noise that no task
has. ``identify drive``'s fits make three files of them: the drives' current map, the motors and gears, and the thesis'
straight line. Nothing else of the simulated drives gets to an estimator.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import tomli_w

from ur5_twin.arm import files
from ur5_twin.arm.parameters import load_model
from ur5_twin.atomic import write_text
from ur5_twin.drives import current_map, terms
from ur5_twin.errors import BenchmarkError
from ur5_twin.estimation.nominal import NominalModel, load_nominal
from ur5_twin.evaluation.benchmark.arms import generator
from ur5_twin.evaluation.benchmark.keys import digest, source_digest
from ur5_twin.identification import drive, drive_plant, thesis_drive
from ur5_twin.recording.table import Recording
from ur5_twin.scenario import MoveJ, Scenario, Wait, load_scenario
from ur5_twin.twin.scenario_run import ScenarioRun

#: Recordings, each of about a minute; seeds of their own stream.
RECORDINGS = 5
#: What hung at the flange, and the scenario whose postures the motions go through.
_TOOL, _POSTURES = "ati_gamma", "free_motion"
#: How far a posture is moved, rad; speeds between postures, rad/s; share of stops; their length, s.
_MOVED, _SPEEDS, _STOPS, _STOP = 0.25, (0.15, 1.5), 0.4, (0.5, 2.5)
#: Motions tried until one touches nothing, not even itself.
_TRIES = 20
_TABLE = "benchmark"
_JOINTS, _LINE, _MAP = "joints.toml", "thesis.toml", "drive.toml"


def prepare(folder: Path, progress: Callable[[int], object] = lambda done: None) -> Path:
    """The folder of the identified drives, made where it is not there yet.

    Args:
        folder: of the benchmark; the files lie in ``nominal/<key>`` below it.
        progress: called with the number of recordings and joints done, of ``STEPS``.

    Raises:
        BenchmarkError: no free motion was found that touches nothing.
    """
    home = folder / "nominal" / key()[:16]
    if (home / _MAP).is_file():
        progress(STEPS)
        return home
    recordings = []
    for k in range(RECORDINGS):
        recordings.append(free_motion(k))
        progress(k + 1)
    links = load_model("c", _TOOL)
    rides = [terms.ride(recording, load_model(drive.MODEL, _TOOL)) for recording in recordings]
    said = f"identified from {RECORDINGS} simulated runs of free motion (docs/benchmark.md)"
    line = replace(thesis_drive.fit_two_step(recordings, links).drive, source=said)
    plant = drive_plant.fit_plant(rides)
    # The simulated motors' constants are not the ones in the controller's own law, which the real arm's seem to be.
    found = drive.fit_drive(rides, torque_constant=plant.torque_constant)
    found = drive.with_residuals(found, drive.FREE, rides, lambda done: progress(RECORDINGS + done))
    made = (
        (_JOINTS, files.JointDrivesSpec, plant.table(said)),
        (_LINE, files.DriveSpec, thesis_drive.table(line)),
        # The last one: it tells that all are there.
        (_MAP, files.CurrentMapSpec, current_map.table(replace(found, source=said))),
    )
    for name, layout, table in made:
        files.convert({_TABLE: table}, dict[str, layout], name)
    for name, _, table in made:
        write_text(home / name, tomli_w.dumps({_TABLE: table}))
    return home


#: Recordings, and joints of the map's errors.
STEPS = RECORDINGS + 6


def key() -> str:
    """Of what the preparation makes: its sources, and how much it records."""
    return digest({"preparation": RECORDINGS, "source": source_digest()})


def nominal(home: Path, tool: str) -> NominalModel:
    """What every estimator is made from, with the tool that it was told of."""
    return load_nominal("plant", tool, home / _JOINTS, drive=home / _LINE, current_map=home / _MAP)


def free_motion(k: int) -> Recording:
    """The k-th run of free motion of the arm as it is known.

    Raises:
        BenchmarkError: all tries touch something.
    """
    for attempt in range(_TRIES):
        made = ScenarioRun(_motion(k, attempt), seed=int(generator(k, "free", str(attempt)).integers(2**31))).finish()
        if "contact" not in made.tables:
            return replace(made, source=f"free_{k + 1}")
    raise BenchmarkError(f"no free motion of {_TRIES} without contact; {_POSTURES} has no room around it")


def _motion(k: int, attempt: int) -> Scenario:
    """The postures of a shipped scenario in another order, moved, at other speeds."""
    rng, of = generator(k, "motion", str(attempt)), load_scenario(_POSTURES)
    postures = [motion.q for motion in of.motions if isinstance(motion, MoveJ)]
    moves = []
    for i in rng.permutation(len(postures)):
        q = postures[i] + rng.uniform(-_MOVED, _MOVED, 6)
        moves.append(MoveJ(q, speed=float(rng.uniform(*_SPEEDS)), acceleration=1.4, blend=0.0))
        if rng.random() < _STOPS:
            moves.append(Wait(float(rng.uniform(*_STOP))))
    return replace(of, q_start=np.array(moves[0].q), motions=(Wait(1.0), *moves[1:]))
