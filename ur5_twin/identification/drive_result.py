"""What ``identify drive`` leaves behind: drives for the twin and for prediction, and how well they do on new logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ur5_twin.arm import files
from ur5_twin.drives import current_map
from ur5_twin.drives.current_map import CurrentMap
from ur5_twin.evaluation.tables import JOINT_COLUMNS
from ur5_twin.identification import thesis_drive
from ur5_twin.identification.drive import HeldOut, Study
from ur5_twin.identification.drive_plant import PlantDrive
from ur5_twin.identification.results import ModelFile, Numbers, Result, provenance, sources
from ur5_twin.identification.thesis_drive import TwoStep
from ur5_twin.recording.table import Recording

#: Name of the plant's file, and of the table in each file.
FILE, TABLE = "joints.toml", "mine"
#: The maps' files: without the servo, and in the form chosen by logs left out.
MAP, CHOSEN = "drive.toml", "drive_following.toml"
_WAYS = (
    ("free", "without the servo"),
    ("following", "with the servo"),
    ("chosen", "in the form chosen by the other logs"),
    ("tared", "the same, told the current of the first 80 ms"),
    ("two_step", "thesis' two-step method"),
    ("printed", "thesis' printed numbers"),
)
_ALONE = "one log cannot check itself: give more of them to see how a fit predicts what it has not seen"


def drive_result(
    plant: PlantDrive,
    free: CurrentMap,
    chosen: CurrentMap,
    study: Study | None,
    recordings: Sequence[Recording],
    command: str,
) -> Result:
    """The plant's numbers in the layout of ``models/ur5_joints.toml``, the maps in that of ``current_maps.toml``.

    Args:
        plant: the fit to all logs.
        free, chosen: the maps of all logs, without the servo and in the chosen form.
        study: how such fits predict logs left out; None for a single log.
        recordings: the logs.
        command: the command line, for provenance.
    """
    said = f"{command}, on {', '.join(sources(recordings))}"
    about = provenance(recordings, command)
    maps = tuple(
        ModelFile(
            file,
            dict[str, files.CurrentMapSpec],
            {TABLE: current_map.table(replace(found, source=said)) | {"provenance": about}},
        )
        for file, found in ((MAP, free), (CHOSEN, chosen))
    )
    findings = [
        f"joint {j}: {k:.2f} Nm/A, {'with' if shape.servo else 'without'} the servo in {CHOSEN}"
        for j, (k, shape) in enumerate(zip(plant.torque_constant, chosen.shapes, strict=True), start=1)
    ]
    if study is None:
        findings.append(_ALONE)
    return Result(
        FILE,
        dict[str, files.JointDrivesSpec],
        {TABLE: plant.table(said)},
        "Drives",
        tuple(findings),
        () if study is None else _tables(study),
        about,
        {"ripple_amplitude_standard_error_nm": plant.amplitude_errors.tolist()},
        maps,
    )


def two_step_result(fit: TwoStep, held_out: Sequence[HeldOut], recordings: Sequence[Recording], command: str) -> Result:
    """The thesis' method's numbers in the layout of ``models/drives.toml``."""
    first, second = fit.explained
    findings = [
        f"joint {j}: tau = {k:.3f} i {b:+.3f}, nu_c {c:.3f} Nm, nu_v {v:.3f} Nm s/rad, preliminary constant {k0:.3f} "
        f"Nm/A; the line explains {a:.2f} of the model's torque, {z:.2f} with friction"
        for j, (k, b, c, v, k0, a, z) in enumerate(
            zip(
                fit.drive.torque_constant,
                fit.drive.offset,
                fit.drive.coulomb,
                fit.drive.viscous,
                fit.preliminary,
                first,
                second,
                strict=True,
            ),
            start=1,
        )
    ]
    table = thesis_drive.table(fit.drive) | {"provenance": provenance(recordings, command)}
    return Result(
        MAP,
        dict[str, files.DriveSpec],
        {TABLE: table},
        "Drives by the thesis' two-step method",
        tuple(findings if held_out else [*findings, _ALONE]),
        (_ratios("thesis' two-step method", held_out),) if held_out else (),
        provenance(recordings, command),
    )


def _tables(study: Study) -> tuple[Numbers, ...]:
    logs = tuple(item.source for item in study.free)
    kinds = (
        ("moving", "moving, without the servo"),
        ("own_moving", "moving, the controller's target_current"),
        ("resting", "at rest, without the servo"),
        ("own_resting", "at rest, the controller's target_current"),
    )
    parts = [_numbers(title, "A", logs, [getattr(item, key) for item in study.free]) for key, title in kinds]
    return (*(_ratios(title, getattr(study, way)) for way, title in _WAYS), *parts)


def _ratios(title: str, held_out: Sequence[HeldOut]) -> Numbers:
    logs = tuple(item.source for item in held_out)
    return _numbers(f"whole log, over target_current's, {title}", "ratio", logs, [item.ratio for item in held_out])


def _numbers(what: str, unit: str, logs: tuple[str, ...], values: list[np.ndarray]) -> Numbers:
    title = f"Mean absolute error of actual_current, each log by a fit on all the others: {what}"
    return Numbers(title, unit, logs, JOINT_COLUMNS, np.stack(values))
