"""What makes the cylinders look like a UR5: colours, caps over the motors, dark rings at the joints.

Nothing here has mass or collides. Where motors sit follows from the thesis (section 5.3.3); the shapes of caps, rings
and foot are drawn, not measured.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ur5_twin.arm.parameters import ArmModel, Cylinder

LINK_MATERIAL = "aluminium"
TOOL_MATERIAL = "steel"
BASE_RADIUS = 0.0745
BASE_HEIGHT = 0.022

_MATERIALS = {
    LINK_MATERIAL: {"rgba": [0.80, 0.81, 0.83, 1.0], "specular": 0.45, "shininess": 0.55, "reflectance": 0.0},
    TOOL_MATERIAL: {"rgba": [0.42, 0.43, 0.45, 1.0], "specular": 0.6, "shininess": 0.7},
    "cap": {"rgba": [0.498, 0.698, 0.851, 1.0], "specular": 0.3, "shininess": 0.4},
    "ring": {"rgba": [0.13, 0.135, 0.15, 1.0], "specular": 0.25, "shininess": 0.3},
}


class Motor(NamedTuple):
    """A motor housing of one link: the axis of its cylinders, where along x it sits, and which end the cap is on."""

    axis: str
    x: float
    cap_end: float


def motors(model: ArmModel) -> tuple[tuple[Motor, ...], ...]:
    """The motor housings of links 1 to 6: link 2 has two, link 6 none (thesis section 5.3.3)."""
    shoulder = -float(model.dh.a[1])
    return (
        (Motor("y", 0.0, 1.0),),
        (Motor("z", shoulder, 1.0), Motor("z", 0.0, 1.0)),
        (Motor("z", 0.0, -1.0),),
        (Motor("z", 0.0, -1.0),),
        (Motor("z", 0.0, -1.0),),
        (),
    )


def add_materials(root: Any) -> None:
    """The four materials of the arm and its tools."""
    for name, attributes in _MATERIALS.items():
        root.asset.add("material", name=name, **attributes)


def dress_base(body: Any, model: ArmModel) -> None:
    """The dark ring between the foot and the shoulder."""
    first = model.links[0].cylinders[0]
    _disc(body, "base_ring", "ring", "z", np.array([0.0, 0.0, BASE_HEIGHT]), first.radius * 0.94, 0.010)


def dress_link(body: Any, model: ArmModel, i: int, name: str) -> None:
    """Caps and rings on link i's motor housings, and the neck to the next link."""
    for number, motor in enumerate(motors(model)[i], start=1):
        housing = [part for part in model.links[i].cylinders if _belongs(part, motor)]
        if housing:
            _motor(body, f"{name}_motor{number}", motor, housing)
    ends = _neck(model, i)
    if ends is not None:
        radius = 0.9 * min(part.radius for part in model.links[i].cylinders + model.links[i + 1].cylinders)
        middle = np.array([0.0, 0.0, sum(ends) / 2])
        _disc(body, f"{name}_neck", "ring", "z", middle, radius, abs(ends[1] - ends[0]))


def _belongs(part: Cylinder, motor: Motor) -> bool:
    # Half a centimetre: model C's link 1 has its cylinders 1.93 mm off the joint's axis, as its mass centre is.
    return part.axis == motor.axis and abs(part.center[0] - motor.x) < 0.005


def _motor(body: Any, name: str, motor: Motor, housing: list[Cylinder]) -> None:
    along = "xyz".index(motor.axis)
    radius = max(part.radius for part in housing)
    outer = max(motor.cap_end * part.center[along] + part.height / 2 for part in housing) * motor.cap_end
    inner = min(motor.cap_end * part.center[along] - part.height / 2 for part in housing) * motor.cap_end

    def at(position: float) -> np.ndarray:
        point = np.array(housing[0].center)
        point[along] = position
        return point

    _disc(body, f"{name}_seam", "ring", motor.axis, at(outer), 0.985 * radius, 0.003)
    _disc(body, f"{name}_cap", "cap", motor.axis, at(outer + motor.cap_end * 0.004), 0.97 * radius, 0.007)
    dome = [0.97 * radius] * 3
    dome[along] = 0.012
    body.add(
        "geom",
        name=f"{name}_dome",
        dclass="trim",
        type="ellipsoid",
        material="cap",
        size=dome,
        pos=at(outer + motor.cap_end * 0.006),
    )
    _disc(body, f"{name}_ring", "ring", motor.axis, at(inner + motor.cap_end * 0.004), 1.006 * radius, 0.007)


def _neck(model: ArmModel, i: int) -> tuple[float, float] | None:
    """Where the part between links i and i + 1 begins and ends along z of frame i, both inside the links' bodies."""
    if i in (0, 3):  # turns sideways: from this link's axis to the next link's body
        return 0.0, float(model.links[i + 1].center[2] if i == 0 else model.dh.d[i + 1])
    if i == 1:  # the elbow: side by side on one axis
        return float(model.links[2].cylinders[0].center[2]), float(model.links[1].center[2])
    if i == 2:
        return float(model.links[2].cylinders[0].center[2]), float(model.dh.d[3])
    if i == 4:  # to the flange's cylinder
        return 0.0, float(model.dh.d[5] + model.links[5].center[2])
    return None


def _disc(body: Any, name: str, material: str, axis: str, center: np.ndarray, radius: float, height: float) -> None:
    half = np.zeros(3)
    half["xyz".index(axis)] = height / 2
    body.add(
        "geom",
        name=name,
        dclass="trim",
        material=material,
        fromto=np.concatenate([center - half, center + half]),
        size=[radius],
    )
