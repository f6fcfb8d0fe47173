"""How well a plant predicts currents: by its law in a measured motion, and by simulation of the closed loop."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ur5_twin.arm.drive import JointDrives, load_drive
from ur5_twin.arm.parameters import N_JOINTS, ArmModel, load_model
from ur5_twin.control.gains import load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.errors import IdentificationError, ReplayError
from ur5_twin.identification.plant import PlantFit, fit_plant
from ur5_twin.identification.plant_windows import BODY, SLOWEST, Motion
from ur5_twin.recording.table import Recording
from ur5_twin.twin.replay import ReplaySettings, replay
from ur5_twin.twin.setup import carrying


@dataclass(frozen=True)
class Unseen:
    """Mean absolute errors of one log's actual_current by a fit on all the others, and by the base's numbers, (6,) A.

    Attributes:
        source: the log's name.
        law, base: by the law in the measured motion, over rows in which the joint moves; what was found to hang on the
            flange counts for both.
        target: target_current, over the same rows; NaN if the log has none.
        loop, base_loop: by simulation of the closed loop that follows the log's targets, over all rows; NaN if the log
            has no targets.
    """

    source: str
    law: np.ndarray
    base: np.ndarray
    target: np.ndarray
    loop: np.ndarray
    base_loop: np.ndarray


def current_of(drives: JointDrives, rotor_inertia: np.ndarray, of: Motion) -> np.ndarray:
    """(n, 6) A that the law expects in a measured motion; for rows in which a joint slides."""
    friction = drives.friction.sliding(of.qd, of.link, of.ratio)
    torque = of.link + rotor_inertia * of.qdd + friction + drives.ripple.torque(of.q) - drives.offset
    return torque / drives.torque_constant


def unseen(
    recordings: Sequence[Recording],
    motions: Sequence[Motion],
    base: ArmModel,
    drives: JointDrives,
    known: dict[str, np.ndarray] | None = None,
    progress: Callable[[int], object] | None = None,
) -> list[Unseen]:
    """Leave each log out of a fit on all the others, and predict it.

    Args:
        recordings: two logs or more; one whose others cannot carry a fit is left out of the result.
        motions: of the same logs, as ``fit_plant`` has them.
        base: links, gravity and rotors, with what is known to be bolted to the flange.
        drives: the base's motors and gears.
        known: as ``fit_plant`` has it.
        progress: called with the number of logs done.
    """
    found = []
    for k, recording in enumerate(recordings):
        try:
            fit = fit_plant([m for i, m in enumerate(motions) if i != k], drives, base.rotor_inertia, known)
        except IdentificationError:
            continue
        found.append(_predicted(recording, motions[k], fit, base, drives))
        if progress is not None:
            progress(k + 1)
    return found


def _predicted(recording: Recording, of: Motion, fit: PlantFit, base: ArmModel, drives: JointDrives) -> Unseen:
    body = fit.carried if of.sought[:, :, :BODY].any() else None
    if body is not None:
        of, base = fit.loaded(of), carrying(base, body.mass, body.center, body.inertia)
    fitted = replace(base, rotor_inertia=fit.values["rotor_inertia"])
    own = fit.drives(drives, "fit")
    moving = of.joined[:, None] & (np.abs(of.qd) > SLOWEST)
    measured = recording.robot["actual_current"]

    def error(predicted: np.ndarray) -> np.ndarray:
        off = np.abs(predicted - measured)
        return np.array([off[moving[:, j], j].mean() if moving[:, j].any() else np.nan for j in range(N_JOINTS)])

    robot, none = recording.robot, np.full(N_JOINTS, np.nan)
    return Unseen(
        source=recording.source,
        law=error(current_of(own, fitted.rotor_inertia, of.late(fit.delay))),
        base=error(current_of(drives, base.rotor_inertia, of.late(fit.delay))),
        target=error(robot["target_current"]) if "target_current" in robot else none,
        loop=simulated(recording, fitted, own),
        base_loop=simulated(recording, base, drives),
    )


def simulated(recording: Recording, plant: ArmModel, drives: JointDrives) -> np.ndarray:
    """(6,) A, mean absolute error of the current that the twin's closed loop needs to follow a log's targets."""
    settings = ReplaySettings(
        model=load_model("controller").with_tool(plant.tool),
        plant=plant,
        gains=load_gains("servo"),
        drive=load_drive(),
        target_current=load_target_current_law(),
        joints=drives,
    )
    try:
        robot = replay(recording, settings).robot
    except ReplayError:
        return np.full(N_JOINTS, np.nan)
    return np.nanmean(np.abs(robot["sim_actual_current"] - robot["actual_current"]), axis=0)


def known_values(words: Sequence[str], fields: Sequence[str]) -> dict[str, np.ndarray]:
    """``FIELD=six values`` or ``FIELD.JOINT=VALUE`` as field -> (6,), NaN where nothing is said.

    Raises:
        IdentificationError: a word is no such assignment.
    """
    found: dict[str, np.ndarray] = {}
    for word in words:
        left, _, right = word.partition("=")
        name, _, joint = left.strip().partition(".")
        example = f"--known {fields[1]}.6=0.16 or --known {fields[1]}=1.9,1.9,1.9,0.16,0.16,0.16"
        if name not in fields:
            raise IdentificationError(f"--known {word}: '{name}' is none of {', '.join(fields)}; {example}")
        try:
            values = np.array([float(x) for x in right.split(",")])
        except ValueError:
            raise IdentificationError(f"--known {word}: '{right}' is no number; {example}") from None
        where = [int(joint) - 1] if joint in tuple("123456") else [] if joint else list(range(N_JOINTS))
        if len(where) != len(values) or not np.isfinite(values).all():
            raise IdentificationError(f"--known {word}: one number a joint, joints 1 to 6; {example}")
        least = 0.0 if name not in ("stribeck",) else -np.inf
        if (values < least).any() or (name in ("torque_constant", "stribeck_speed") and (values == 0.0).any()):
            raise IdentificationError(f"--known {word}: {name} cannot be {values.min():g}")
        row = found.setdefault(name, np.full(N_JOINTS, np.nan))
        for j, value in itertools.zip_longest(where, values):
            row[j] = value
    return found
