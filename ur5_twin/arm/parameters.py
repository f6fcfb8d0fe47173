"""Arm models and tools: the numbers of ``models/*.toml`` as frozen, checked objects in SI units.

Frames are the DH frames of thesis figure 5.6 (equation 2.19); link i carries frame i, frame 6 is the flange F.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from ur5_twin.arm import files, inertia
from ur5_twin.errors import ModelError, unknown

JOINT_NAMES = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
N_JOINTS = len(JOINT_NAMES)
#: Where ``Tool.sensors`` says where ``ft_wrench`` and ``imu_*`` are measured; tools of the same names carry them.
FT_SENSOR, IMU_SENSOR = "ati_gamma", "xsens_mti"
#: What the tool ``both`` stands for.
_BOTH = (FT_SENSOR, IMU_SENSOR)

#: The models that ship, by name, with the file each is read from.
MODEL_FILES: Mapping[str, str] = {
    "a": "ur5_model_a.toml",
    "b": "ur5_model_b.toml",
    "c": "ur5_model_c.toml",
    "controller": "ur5_controller.toml",
    "plant": "ur5_plant.toml",
}


@dataclass(frozen=True)
class DenavitHartenberg:
    """Standard DH parameters (thesis equation 2.19), each (6,): d and a in m, alpha in rad; theta_i = q_i."""

    d: np.ndarray
    a: np.ndarray
    alpha: np.ndarray
    source: str

    @cached_property
    def packed(self) -> np.ndarray:
        """(6, 4) cos alpha, sin alpha, a, d of each joint: the compiled kernels' view."""
        return np.stack([np.cos(self.alpha), np.sin(self.alpha), self.a, self.d], axis=1)


@dataclass(frozen=True)
class Limits:
    """Joint limits (thesis table 4.1), each (6,): rad, rad/s, rad/s^2, Nm, symmetric about zero."""

    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    torque: np.ndarray
    source: str


@dataclass(frozen=True)
class Cylinder:
    """A homogeneous cylinder in the frame of the body that carries it: kg, m; ``axis`` is x, y or z."""

    name: str
    mass: float
    height: float
    radius: float
    axis: Literal["x", "y", "z"]
    center: np.ndarray

    def inertia(self) -> np.ndarray:
        """(3, 3) tensor about its own centre, kg m^2 (thesis equations 2.47, 2.48)."""
        return inertia.cylinder(self.mass, self.radius, self.height, self.axis)


@dataclass(frozen=True)
class Box:
    """A homogeneous box, edges along the axes of the frame of the body that carries it: kg, m."""

    name: str
    mass: float
    size: np.ndarray
    center: np.ndarray

    def inertia(self) -> np.ndarray:
        """(3, 3) tensor about its own centre, kg m^2."""
        return inertia.box(self.mass, self.size)


@dataclass(frozen=True)
class Sphere:
    """A homogeneous sphere in the frame of the body that carries it: kg, m."""

    name: str
    mass: float
    radius: float
    center: np.ndarray

    def inertia(self) -> np.ndarray:
        """(3, 3) tensor about its own centre, 2/5 m r^2 along every axis, kg m^2."""
        return np.eye(3) * (0.4 * self.mass * self.radius**2)


Part = Cylinder | Box | Sphere


@dataclass(frozen=True)
class Link:
    """One link of the arm.

    Attributes:
        mass: kg.
        center: (3,) mass centre in the link's DH frame, m.
        inertia: (3, 3) tensor about ``center`` in the link's axes, kg m^2; zero for a point mass.
        cylinders: the bodies it is drawn with and, unless it is a point mass, the tensor comes from.
        sources: where mass, center and inertia come from.
    """

    mass: float
    center: np.ndarray
    inertia: np.ndarray
    cylinders: tuple[Cylinder, ...]
    sources: Mapping[str, str]

    def cylinder_center(self) -> np.ndarray:
        """(3,) common mass centre of the cylinders, m. Model C's link 2 has it 0.93 mm from ``center``."""
        masses = np.array([cylinder.mass for cylinder in self.cylinders])
        return masses @ np.array([cylinder.center for cylinder in self.cylinders]) / masses.sum()


@dataclass(frozen=True)
class Tool:
    """What is bolted to the flange: mass in kg, centre (3,) in m and tensor (3, 3) about it, in the flange frame.

    Attributes:
        parts: the bodies it is made of, in the flange frame.
        sensors: name -> (3,) origin of the sensor's frame in the flange frame, m; its axes are the flange's.
        tops: name -> height over the flange of the face that each sensor offers to what is mounted on it, m.
        height: of the face that another tool can be mounted on, m over the flange; None where there is none.
    """

    name: str
    title: str
    mass: float
    center: np.ndarray
    inertia: np.ndarray
    parts: tuple[Part, ...]
    sensors: Mapping[str, np.ndarray]
    tops: Mapping[str, float]
    height: float | None
    source: str

    def distal_to(self, sensor: str) -> tuple[float, np.ndarray, np.ndarray]:
        """What hangs beyond a sensor: the load of it that a force sensor feels besides contact.

        The sensor's own body does not count, be it on the sensor's far side: no table splits its mass, and a tare takes
        it off.

        Args:
            sensor: one of ``sensors``.

        Returns:
            Mass in kg, mass centre (3,) in m and tensor (3, 3) about that in kg m^2 of all parts mounted on the sensor,
            in the flange frame; zeros if nothing is.

        Raises:
            ModelError: the tool has no such sensor.
        """
        if sensor not in self.tops:
            raise ModelError(f"tool '{self.name}': {unknown('sensor', sensor, self.tops)}")
        beyond = [part for part in self.parts if part.center[2] > self.tops[sensor]]
        return _together(beyond) if beyond else (0.0, np.zeros(3), np.zeros((3, 3)))


@dataclass(frozen=True)
class ArmModel:
    """A rigid-body model of the arm; everything the dynamics need.

    Attributes:
        gravity: m/s^2, along -z of the base frame.
        rotor_inertia: (6,) rotor inertia reflected through the gear, kg m^2, added to the diagonal of M.
        tool: what is bolted to the flange, None if nothing; its mass is part of the model's dynamics.
        joints: file with its motors and gears (``arm.drive.load_joint_drives``), None for a model without.
    """

    name: str
    title: str
    source: str
    dh: DenavitHartenberg
    limits: Limits
    links: tuple[Link, ...]
    gravity: float
    gravity_source: str
    rotor_inertia: np.ndarray
    rotor_source: str
    tool: Tool | None = field(default=None)
    joints: Path | None = field(default=None)

    def with_tool(self, tool: Tool | None) -> ArmModel:
        """The same arm with another tool at its flange."""
        return replace(self, tool=tool)

    def bodies(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Masses (6,), mass centres (6, 3) and tensors about them (6, 3, 3) in the link frames, the tool in link 6."""
        masses = np.array([link.mass for link in self.links])
        centers = np.array([link.center for link in self.links])
        tensors = np.array([link.inertia for link in self.links])
        if self.tool is not None:
            masses[5], centers[5], tensors[5] = inertia.combine(
                np.array([masses[5], self.tool.mass]),
                np.array([centers[5], self.tool.center]),
                np.array([tensors[5], self.tool.inertia]),
            )
        return masses, centers, tensors


def model_names() -> tuple[str, ...]:
    """Names of the models that ship."""
    return tuple(MODEL_FILES)


def load_model(name: str | Path, tool: str | None = None) -> ArmModel:
    """An arm model by name or from a TOML file of the same layout.

    Args:
        name: one of ``model_names()`` (upper case too), or a path to a ``.toml`` file.
        tool: what to bolt on (``load_tool``).

    Raises:
        ModelError: the name is unknown, the file cannot be read, a key is unknown or a value impossible.
    """
    path = model_file(name)
    spec = files.read(path, files.ModelFile)
    base = files.read(files.model_path("ur5.toml"), files.BaseFile)
    link_specs = spec.links
    if spec.links_from is not None:
        if spec.links:
            raise ModelError(f"{path.name}: give either 'links' or 'links_from', not both")
        link_specs = files.read(beside_or_shipped(path, spec.links_from), files.ModelFile).links
    if len(link_specs) != N_JOINTS:
        raise ModelError(f"{path.name}: {len(link_specs)} links, a UR5 has {N_JOINTS}")
    point = spec.inertia is not None and spec.inertia.kind == "point"
    sources = {"inertia": f"point mass: {spec.inertia.source}"} if spec.inertia is not None and point else {}
    links = [_link(item, point=point, sources=sources) for item in link_specs]
    for change in spec.changes:
        links[change.link - 1] = _moved(links[change.link - 1], change)
    dh = DenavitHartenberg(
        d=np.array(base.dh.d_mm) * 1e-3,
        a=np.array(base.dh.a_mm) * 1e-3,
        alpha=np.array(base.dh.alpha_rad),
        source=base.dh.source,
    )
    limits = Limits(
        q=np.array(base.limits.q_max_rad),
        qd=np.array(base.limits.qd_max_rad_s),
        qdd=np.array(base.limits.qdd_max_rad_s2),
        torque=np.array(base.limits.torque_max_nm),
        source=base.limits.source,
    )
    model = ArmModel(
        name=spec.name,
        title=spec.title,
        source=spec.source,
        dh=dh,
        limits=limits,
        links=tuple(links),
        gravity=spec.gravity.value_m_s2,
        gravity_source=spec.gravity.source,
        rotor_inertia=np.array(spec.rotors.inertia_kg_m2),
        rotor_source=spec.rotors.source,
        joints=None if spec.joints_from is None else beside_or_shipped(path, spec.joints_from),
    )
    return model.with_tool(load_tool(tool))


def model_file(name: str | Path) -> Path:
    """The file of a model: one of ``model_names()`` (upper case too), or the path of a ``.toml`` file.

    Raises:
        ModelError: it is neither.
    """
    key = str(name).lower()
    if key in MODEL_FILES:
        return files.model_path(MODEL_FILES[key])
    if str(name).endswith(".toml"):
        return Path(name)
    raise ModelError(unknown("model", str(name), MODEL_FILES) + ", or give the path of a .toml file")


def beside_or_shipped(path: Path, name: str) -> Path:
    """A file that another one names: beside it, or one of ours, on which a user's file may build."""
    beside, shipped = path.parent / name, files.model_path(name)
    return shipped if shipped.exists() and not beside.exists() else beside


def tool_names() -> tuple[str, ...]:
    """Names of the tools that can be bolted on, alone or on each other; ``none`` is the bare flange."""
    return ("none", *files.read_named("tools.toml", files.ToolSpec), "both")


def load_tool(name: str | None) -> Tool | None:
    """A tool by name, or several mounted on each other.

    Args:
        name: one of ``tool_names()``; names joined by ``+`` stand on each other, the lowest first:
            ``ati_gamma+ball_probe``. ``both`` is ``ati_gamma+xsens_mti``, ``none`` the bare flange. The path of a
            ``.toml`` file with one table in the layout of ``models/tools.toml`` is a name too. What says ``frame =
            "flange"``, as an identified payload does, is where it says, whatever it is named after.

    Raises:
        ModelError: there is no such tool, one comes twice, or one has no face to mount the next on.
    """
    if name is None or name == "none":
        return None
    specs: dict[str, files.ToolSpec] = dict(files.read_named("tools.toml", files.ToolSpec))
    layers = [layer for word in name.split("+") for layer in (_BOTH if word == "both" else (word,))]
    tool: Tool | None = None
    for layer in layers:
        if layer.endswith(".toml"):
            specs[layer] = files.choose(layer, "tools.toml", files.ToolSpec, "tool")[1]
        if layer not in specs:
            known = tool_names() if len(layers) == 1 else specs
            raise ModelError(
                unknown("tool", layer, known) + "; '+' mounts one on another, a path ending in .toml is a file's"
            )
        if layers.count(layer) > 1:
            raise ModelError(f"the tool '{name}' has '{layer}' twice; there is one of each")
        tool = _tool(layer, specs[layer]) if tool is None else _stack(name, tool, layer, specs[layer])
    return tool if tool is None else replace(tool, name=name)


def _link(spec: files.LinkSpec, *, point: bool, sources: Mapping[str, str]) -> Link:
    center = np.array(spec.center_mm) * 1e-3
    cylinders = tuple(
        Cylinder(
            name=item.name,
            mass=item.mass_kg,
            height=item.height_mm * 1e-3,
            radius=item.radius_mm * 1e-3,
            axis=item.axis,
            center=center + np.array(item.offset_mm) * 1e-3,
        )
        for item in spec.cylinders
    )
    # Thesis equation 2.56: the tensor is taken about the link's mass centre, wherever the cylinders' own centre is.
    tensor = (
        np.zeros((3, 3))
        if point
        else sum(
            (inertia.shift(part.inertia(), part.mass, part.center - center) for part in cylinders), np.zeros((3, 3))
        )
    )
    return Link(spec.mass_kg, center, tensor, cylinders, {**spec.sources, **sources})


def _moved(link: Link, change: files.LinkChange) -> Link:
    """The link with another mass centre; its cylinders stay where they are."""
    return replace(link, center=np.array(change.center_mm) * 1e-3, sources={**link.sources, "center": change.source})


def _tool(name: str, spec: files.ToolSpec, shift: float = 0.0) -> Tool:
    """A tool of the file, mounted ``shift`` m over the flange."""
    offset = np.array([0.0, 0.0, shift])
    parts = tuple(_part(name, item, offset) for item in spec.parts)
    height = None if spec.mount_height_mm is None else spec.mount_height_mm * 1e-3 + shift
    sensors, tops = {}, {}
    if spec.sensor_frame_mm is not None:
        if height is None:
            raise ModelError(f"tools.toml: {name}: a sensor needs 'mount_height_mm', the face that it measures at")
        sensors[name] = np.array(spec.sensor_frame_mm) * 1e-3 + offset
        tops[name] = height
    return Tool(name, spec.title, *_together(parts), parts, sensors, tops, height, spec.source)


def _part(tool: str, item: files.PartSpec, offset: np.ndarray) -> Part:
    center = np.array(item.center_mm) * 1e-3 + offset
    if item.shape == "box":
        if item.size_mm is None:
            raise ModelError(f"tools.toml: {tool}.{item.name}: a box needs 'size_mm'")
        return Box(item.name, item.mass_kg, np.array(item.size_mm) * 1e-3, center)
    if item.shape == "sphere":
        if item.radius_mm is None:
            raise ModelError(f"tools.toml: {tool}.{item.name}: a sphere needs 'radius_mm'")
        return Sphere(item.name, item.mass_kg, item.radius_mm * 1e-3, center)
    if item.height_mm is None or item.radius_mm is None:
        raise ModelError(f"tools.toml: {tool}.{item.name}: a cylinder needs 'height_mm' and 'radius_mm'")
    return Cylinder(item.name, item.mass_kg, item.height_mm * 1e-3, item.radius_mm * 1e-3, "z", center)


def _stack(name: str, below: Tool, layer: str, spec: files.ToolSpec) -> Tool:
    """``below`` with another tool mounted on it."""
    at_flange = spec.frame == "flange"
    if below.height is None and not at_flange:
        raise ModelError(f"the tool '{name}': nothing can be mounted on what is below '{layer}'; put that last")
    above = _tool(layer, spec, 0.0 if below.height is None or at_flange else below.height)
    parts = (*below.parts, *above.parts)
    return Tool(
        name,
        f"{below.title}, and on it {above.title}",
        *_together(parts),
        parts,
        {**below.sensors, **above.sensors},
        {**below.tops, **above.tops},
        below.height if at_flange else above.height,
        f"{below.source}; {above.source}",
    )


def _together(parts: Sequence[Part]) -> tuple[float, np.ndarray, np.ndarray]:
    return inertia.combine(
        np.array([part.mass for part in parts]),
        np.array([part.center for part in parts]),
        np.array([part.inertia() for part in parts]),
    )
