"""From an arm model's numbers to MJCF: the only place that does it."""

from __future__ import annotations

import itertools
import math
import re
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from ur5_twin.arm.mjcf import looks, scenery
from ur5_twin.arm.mjcf.obstacles import Obstacle, add_payload, tune
from ur5_twin.arm.mjcf.obstacles import add as add_obstacles
from ur5_twin.arm.parameters import JOINT_NAMES, ArmModel, Box, Part, Sphere, Tool
from ur5_twin.errors import ModelError

with warnings.catch_warnings():
    # dm_control asks for a window system on import and warns where there is none; building a model needs none.
    warnings.filterwarnings("ignore", module="glfw")
    import mujoco
    from dm_control import mjcf

#: The moving bodies, base to flange; body i carries DH frame i.
BODY_NAMES = ("shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link")

#: Joint positions of the keyframes, rad.
KEYFRAMES = {
    "home": (0.0, -math.pi / 2, 0.0, -math.pi / 2, 0.0, 0.0),  # thesis figure 4.1, position 2: upright
    "ready": (2.18, -2.135, -1.745, 0.276, -6.02, 0.0),  # bent: where the lab's run No9 begins
}

# kg m^2. MuJoCo refuses a moving body without a tensor, so a point mass gets one far below the smallest rotor (0.16).
_POINT_TENSOR = 1e-12
# Digits in the file: the tables' numbers come back to the last bit that counts, sums of them without float noise.
_DIGITS = 15
_ZERO: Any = 1e-15  # Any: dm_control calls it an int
# Digits of a keyframe's torque, Nm: engines on different machines agree to these.
_TORQUE_DECIMALS = 9

# A cylinder's own axis is z; MuJoCo normalises.
_AXIS_QUATERNIONS = {"x": [1.0, 0.0, 1.0, 0.0], "y": [1.0, -1.0, 0.0, 0.0], "z": None}


def build(
    model: ArmModel,
    *,
    scene: bool = False,
    obstacles: Sequence[Obstacle] = (),
    payload: bool = False,
) -> mjcf.RootElement:
    """The arm as MJCF.

    Body i's frame is DH frame i (thesis equation 2.19), so mass centres, tensors and cylinders enter as the tables
    print them; joint i's axis is z of frame i-1, a constant line in it. The world frame is the base frame B. A tool is
    a body of its own welded to the flange, because a force sensor measures between a body and its parent.

    Args:
        model: the numbers; its tool, if any, is bolted on.
        scene: with a lab around it (floor, stand, lights, cameras).
        obstacles: what else stands around it. Their stiffness is not in the MJCF: ``compile`` puts it into the model.
        payload: with a body ``payload`` at the flange that ``set_payload`` gives its mass.

    Raises:
        ModelError: MuJoCo cannot take the model, say because two cylinders of a link have one name.
    """
    root = mjcf.RootElement(model="ur5_" + re.sub(r"\W", "_", model.name))
    try:
        _settings(root, model)
        _defaults(root)
        if scene:
            scenery.add(root)
        _arm(root, model, payload)
        add_obstacles(root, model, BODY_NAMES, obstacles)
        _contact_excludes(root, model, scene)
        _actuators(root, model)
        _keyframes(root)
    except ValueError as error:
        raise ModelError(f"model '{model.name}' makes no MuJoCo model: {error}") from None
    return root


def to_xml(root: mjcf.RootElement) -> str:
    """The MJCF text of a root element, with as many digits as the numbers mean."""
    return root.to_xml_string(precision=_DIGITS, zero_threshold=_ZERO)


def to_mujoco(root: mjcf.RootElement) -> mujoco.MjModel:
    """Compile a root element through the same text that is exported, so that file and twin are one model."""
    return mujoco.MjModel.from_xml_string(to_xml(root))


def compile(
    model: ArmModel,
    *,
    scene: bool = False,
    collisions: bool = True,
    obstacles: Sequence[Obstacle] = (),
    payload: bool = False,
) -> mujoco.MjModel:
    """The arm as a MuJoCo model.

    Args:
        model: the numbers; its tool, if any, is bolted on.
        scene: with a lab around it.
        collisions: False switches all contacts off (free motion, replay), which saves looking for them.
        obstacles: what the arm can touch, each with its stiffness, damping and friction.
        payload: with a body ``payload`` at the flange that ``set_payload`` gives its mass.
    """
    root: Any = build(model, scene=scene, obstacles=obstacles, payload=payload)
    if not collisions:
        root.option.flag.contact = "disable"
    mj_model = to_mujoco(root)
    tune(mj_model, obstacles)
    return mj_model


def _settings(root: Any, model: ArmModel) -> None:
    root.compiler.angle = "radian"
    root.compiler.autolimits = True
    root.option.gravity = [0.0, 0.0, -model.gravity]
    root.option.timestep = 0.002
    root.option.integrator = "implicitfast"
    root.statistic.center = [0.0, 0.0, 0.35]
    root.statistic.extent = 1.1
    screen = getattr(root.visual, "global")
    screen.offwidth, screen.offheight = 1920, 1080
    screen.azimuth, screen.elevation = 140, -18
    root.visual.headlight.ambient = [0.3, 0.3, 0.3]
    root.visual.headlight.diffuse = [0.45, 0.45, 0.45]
    root.visual.headlight.specular = [0.1, 0.1, 0.1]
    root.visual.quality.shadowsize = 8192
    root.visual.quality.offsamples = 8
    root.visual.map.znear = 0.02


def _defaults(root: Any) -> None:
    root.default.joint.type = "hinge"
    link = root.default.add("default", dclass="link")
    link.geom.type, link.geom.group, link.geom.material = "cylinder", 1, looks.LINK_MATERIAL
    trim = root.default.add("default", dclass="trim")
    trim.geom.type, trim.geom.group, trim.geom.mass = "cylinder", 2, 0.0
    trim.geom.contype, trim.geom.conaffinity = 0, 0
    tool = root.default.add("default", dclass="tool")
    tool.geom.group, tool.geom.material = 1, looks.TOOL_MATERIAL
    frame = root.default.add("default", dclass="frame")
    frame.site.group, frame.site.size, frame.site.rgba = 4, [0.006], [0.9, 0.5, 0.1, 1.0]
    looks.add_materials(root)


def _arm(root: Any, model: ArmModel, payload: bool) -> None:
    body = root.worldbody.add("body", name="base")
    body.add("site", name="dh_0", dclass="frame")
    # Fixed to the world: what is seen and hit counts, its mass does not.
    radius, height = looks.BASE_RADIUS, looks.BASE_HEIGHT
    body.add("geom", name="base", dclass="link", size=[radius, height / 2], pos=[0, 0, height / 2], mass=0.0)
    looks.dress_base(body, model)
    for i, name in enumerate(BODY_NAMES):
        body = _link(body, model, i, name)
    body.add("site", name="flange", dclass="frame", group=3)
    if model.tool is not None:
        _tool(body, model.tool)
    if payload:
        add_payload(body)


def _link(parent: Any, model: ArmModel, i: int, name: str) -> Any:
    """Link i + 1 of the tables, hung on its parent; returns its body."""
    alpha, a, d = model.dh.alpha[i], model.dh.a[i], model.dh.d[i]
    cos, sin = math.cos(alpha), math.sin(alpha)
    # MuJoCo normalises: tan keeps right angles free of rounding. At half a turn it is large, not wrong.
    body = parent.add("body", name=name, pos=[a, 0.0, d], quat=[1.0, math.tan(alpha / 2), 0.0, 0.0])
    # Frame i-1 seen from frame i is the same wherever joint i stands: A_i = Rot(z, q) Trans(a, 0, d) Rot(x, alpha).
    body.add(
        "joint",
        name=JOINT_NAMES[i],
        pos=[-a, -d * sin, -d * cos],
        axis=[0.0, sin, cos],
        range=[-model.limits.q[i], model.limits.q[i]],
        armature=model.rotor_inertia[i],
        actuatorfrcrange=[-model.limits.torque[i], model.limits.torque[i]],
    )
    link = model.links[i]
    _inertial(body, link.mass, link.center, link.inertia)
    for part in link.cylinders:
        _geom(body, f"{name}_{part.name}", part, "link")
    looks.dress_link(body, model, i, name)
    body.add("site", name=f"dh_{i + 1}", dclass="frame")
    return body


def _tool(flange: Any, tool: Tool) -> None:
    body = flange.add("body", name="tool")
    _inertial(body, tool.mass, tool.center, tool.inertia)
    for part in tool.parts:
        _geom(body, f"tool_{part.name}", part, "tool")
    for name, origin in tool.sensors.items():
        body.add("site", name=name, dclass="frame", group=3, pos=origin)


def _inertial(body: Any, mass: float, center: np.ndarray, tensor: np.ndarray) -> None:
    if not tensor.any():
        tensor = np.eye(3) * _POINT_TENSOR
    packed = [tensor[row, column] for row, column in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    body.add("inertial", mass=mass, pos=center, fullinertia=packed)


def _geom(body: Any, name: str, part: Part, dclass: str) -> None:
    """A part as a geom. Its mass is the table's; dynamics use the body's inertial, which overrides geoms."""
    if isinstance(part, Box):
        body.add("geom", name=name, dclass=dclass, type="box", size=part.size / 2, pos=part.center, mass=part.mass)
        return
    if isinstance(part, Sphere):
        body.add("geom", name=name, dclass=dclass, type="sphere", size=[part.radius], pos=part.center, mass=part.mass)
        return
    body.add(
        "geom",
        name=name,
        dclass=dclass,
        type="cylinder",
        size=[part.radius, part.height / 2],
        pos=part.center,
        quat=_AXIS_QUATERNIONS[part.axis],
        mass=part.mass,
    )


def _contact_excludes(root: Any, model: ArmModel, scene: bool) -> None:
    """Pairs of bodies whose cylinders meet where the real arm's do not.

    Neighbours share a joint (MuJoCo leaves those out by itself, but not for a body fixed to the world). The upper arm
    swings past the foot. And model B's forearm, shifted onto its mass centre, reaches 125 mm past the wrist, into the
    circle the last two links move on; the lab's logs go through poses where they would touch.
    """
    pairs = [*itertools.pairwise(("base", *BODY_NAMES)), ("base", "upper_arm_link")]
    forearm, wrist_2 = model.links[2].cylinders, model.links[4].cylinders
    overhang = max((part.height / 2 - part.center[0] for part in forearm if part.axis == "x"), default=0.0)
    if overhang > model.dh.d[4] - max(part.radius for part in wrist_2):
        pairs += [("forearm_link", "wrist_2_link"), ("forearm_link", "wrist_3_link")]
        if model.tool is not None:
            pairs.append(("forearm_link", "tool"))
    if scene:  # model B's shoulder, on its mass centre, dips 1.5 mm into the plate
        pairs.append((scenery.STAND, "shoulder_link"))
    for first, second in pairs:
        root.contact.add("exclude", name=f"{first}-{second}", body1=first, body2=second)


def _actuators(root: Any, model: ArmModel) -> None:
    for name, torque in zip(JOINT_NAMES, model.limits.torque, strict=True):
        span = [-torque, torque]
        root.actuator.add("motor", name=name, joint=name, ctrlrange=span, forcerange=span)


def _keyframes(root: Any) -> None:
    """Poses with the torques that hold them against gravity, so that a viewer shows the arm at rest."""
    mj_model = to_mujoco(root)
    data = mujoco.MjData(mj_model)
    for name, q in KEYFRAMES.items():
        data.qpos[:] = q
        mujoco.mj_forward(mj_model, data)
        root.keyframe.add("key", name=name, qpos=q, ctrl=np.round(data.qfrc_bias, _TORQUE_DECIMALS))
