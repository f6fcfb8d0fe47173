"""What ``identify payload`` leaves behind: a tool for the twin, and how far it can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ur5_twin.arm import files
from ur5_twin.evaluation.tables import JOINT_COLUMNS
from ur5_twin.identification import body, payload
from ur5_twin.identification.load import Load
from ur5_twin.identification.results import Numbers, Result, provenance, sources
from ur5_twin.identification.spread import NINETY_FIVE
from ur5_twin.recording.table import Recording

#: Name of the file, and of its table.
FILE, TABLE = "payload.toml", "payload"
_TENSOR = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")


def told_result(fit: payload.PayloadFit, recordings: Sequence[Recording], command: str) -> Result:
    """What the controller was told of, by its target_moment."""
    findings = [] if fit.body is not None else ["the controller was told of no payload: no payload.toml to write"]
    if not payload.one_body(fit):
        findings.append(
            "target_moment is not that of one body throughout: the payload was set within a log (--between), or the "
            "controller's model is another (--controller)"
        )
    return _result("Payload that the controller was told of", fit, findings, recordings, (), "Nm", command)


def carried_result(
    fit: payload.PayloadFit, loaded: Sequence[Recording], bare: Sequence[Recording], command: str
) -> Result:
    """What the motors carry, by their currents."""
    findings = []
    if not fit.found:
        findings.append("the mass cannot be told from none at 95 %: so little hangs there, or the logs say too little")
    if fit.inertia is None:
        findings.append("the inertia cannot be told from the currents: the file has an aluminium ball of that mass")
    if not bare:
        findings.append(
            "no log without the load (--bare): the intervals contain what torque constants, friction and the arm's own "
            "masses may be off"
        )
    assert fit.constants is not None
    assert fit.constants_std is not None
    findings.append(
        "torque constants that went with it: "
        + ", ".join(f"{k:.2f} ± {NINETY_FIVE * s:.2f}" for k, s in zip(fit.constants, fit.constants_std, strict=True))
        + " Nm/A"
    )
    return _result("Payload that the motors carry", fit, findings, loaded, bare, "A", command)


def _result(
    title: str,
    fit: payload.PayloadFit,
    findings: list[str],
    loaded: Sequence[Recording],
    bare: Sequence[Recording],
    unit: str,
    command: str,
) -> Result:
    made_of = provenance((*loaded, *bare), command) | {"uncertainty": uncertainty(fit)}
    if bare:
        made_of["bare_logs"] = list(sources(bare))
    logs = sources(loaded)
    errors = (("with it", fit.error), ("with nothing at the flange", fit.without))
    what = "target_moment" if unit == "Nm" else "actual_current of sliding joints"
    return Result(
        FILE,
        dict[str, files.ToolSpec],
        None if fit.body is None else {TABLE: table(fit, title, f"{command}, on {', '.join(logs)}", made_of)},
        title,
        (*words(fit), *findings),
        tuple(Numbers(f"Mean absolute error of {what}, {which}", unit, logs, JOINT_COLUMNS, v) for which, v in errors),
        made_of,
        {"uncertainty": uncertainty(fit)},
    )


def words(fit: Load) -> list[str]:
    """Mass, centre and tensor with 95 % intervals, as far as they are told."""
    mass, mass_std = fit.mass
    found = [f"mass {mass:.4g} ± {NINETY_FIVE * mass_std:.2g} kg (95 %)"]
    if not fit.found:
        return found
    center, center_std = fit.center
    places = zip("xyz", 1e3 * center, 1e3 * center_std, strict=True)
    found.append(
        "mass centre in the flange frame "
        + ", ".join(f"{axis} {x:.2f} ± {NINETY_FIVE * s:.2g}" for axis, x, s in places)
        + " mm"
    )
    if fit.inertia is not None:
        moments = zip(_TENSOR, *fit.inertia, strict=True)
        found.append(
            "tensor about it "
            + ", ".join(f"{name} {x:.2g} ± {NINETY_FIVE * s:.1g}" for name, x, s in moments)
            + " kg m^2"
        )
    return found


def table(fit: Load, title: str, source: str, made_of: dict[str, Any]) -> dict[str, Any]:
    """A body in the layout of a table of ``models/tools.toml``."""
    assert fit.body is not None
    if fit.inertia is not None:
        parts = body.parts(fit.body)
    else:
        radius = float(np.sqrt(2.5 * fit.body.inertia[0, 0] / fit.body.mass))
        place = [float(x) for x in 1e3 * fit.body.center]
        parts = [
            {
                "name": "payload",
                "shape": "sphere",
                "mass_kg": fit.body.mass,
                "radius_mm": 1e3 * radius,
                "center_mm": place,
            }
        ]
    return {"title": title, "source": source, "frame": "flange", "parts": parts, "provenance": made_of}


def uncertainty(fit: Load) -> dict[str, Any]:
    """The fit without constraint and half the width of its 95 % intervals."""
    mass, mass_std = fit.mass
    known: dict[str, Any] = {"mass_kg": mass, "mass_95_kg": NINETY_FIVE * mass_std}
    if fit.found:
        center, center_std = fit.center
        known |= {"center_mm": (1e3 * center).tolist(), "center_95_mm": (1e3 * NINETY_FIVE * center_std).tolist()}
    if fit.found and fit.inertia is not None:
        tensor, tensor_std = fit.inertia
        known |= {"inertia_kg_m2": tensor.tolist(), "inertia_95_kg_m2": (NINETY_FIVE * tensor_std).tolist()}
    return known
