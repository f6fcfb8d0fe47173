"""What ``identify drive`` leaves behind: motors and gears for the twin, and how well such a fit predicts new logs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ur5_twin.arm import files
from ur5_twin.evaluation.tables import JOINT_COLUMNS
from ur5_twin.identification.drive import HeldOut
from ur5_twin.identification.drive_plant import PlantDrive
from ur5_twin.identification.results import Numbers, Result, provenance, sources
from ur5_twin.recording.table import Recording

#: Name of the file, and of its table.
FILE, TABLE = "joints.toml", "mine"


def drive_result(
    plant: PlantDrive, held_out: Sequence[HeldOut], recordings: Sequence[Recording], command: str
) -> Result:
    """The numbers in the layout of ``models/ur5_joints.toml``.

    Args:
        plant: the fit to all logs.
        held_out: each log predicted by a fit on the others; empty for a single log.
        recordings: the logs.
        command: the command line, for provenance.
    """
    findings = [f"joint {j}: {k:.2f} Nm/A" for j, k in enumerate(plant.torque_constant, start=1)]
    if not held_out:
        findings.append("one log cannot check itself: give more of them to see how a fit predicts what it has not seen")
    return Result(
        FILE,
        dict[str, files.JointDrivesSpec],
        {TABLE: plant.table(f"{command}, on {', '.join(sources(recordings))}")},
        "Drives",
        tuple(findings),
        _tables(held_out),
        provenance(recordings, command),
        {"ripple_amplitude_standard_error_nm": plant.amplitude_errors.tolist()},
    )


def _tables(held_out: Sequence[HeldOut]) -> tuple[Numbers, ...]:
    if not held_out:
        return ()
    logs = tuple(item.source for item in held_out)
    what = (
        ("moving", "A", "moving"),
        ("own_moving", "A", "moving, target_current's"),
        ("resting", "A", "at rest"),
        ("own_resting", "A", "at rest, target_current's"),
        ("ratio", "ratio", "all rows, over target_current's"),
    )
    return tuple(
        Numbers(
            f"Mean absolute error of actual_current, each log by a fit on all the others, {title}",
            unit,
            logs,
            JOINT_COLUMNS,
            np.stack([getattr(item, key) for item in held_out]),
        )
        for key, unit, title in what
    )
