"""An arm model as tables for people: every number the dynamics use, in the units it was printed in, with its source."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ur5_twin.arm.parameters import JOINT_NAMES, ArmModel, Cylinder, Link, Sphere, Tool

# The thesis prints cylinders and centres to 0.01 mm; sums of a few of them differ by that much without meaning it.
_NOTABLE_MM = 0.05
_WORDS = frozenset({"joint", "cylinder", "axis", "part", "shape [mm]"})
_TENSOR_COLUMNS = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
_TENSOR_INDEX = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@dataclass(frozen=True)
class Table:
    """One table of a model: a row per joint, link or body, and what to know about the numbers."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]


def tables(model: ArmModel) -> tuple[Table, ...]:
    """Joints, links, cylinders and, where there is one, the tool."""
    found = (_joints(model), _links(model), _cylinders(model))
    return found if model.tool is None else (*found, _tool(model.tool))


def render_markdown(model: ArmModel) -> str:
    """The model as Markdown that also reads well in a terminal: a heading, gravity, then ``tables(model)``."""
    total = model.bodies()[0].sum()
    parts = [
        f"# {model.title}",
        f"Model `{model.name}`. Source: {model.source}.",
        f"Gravity {model.gravity:g} m/s^2 along -z of the base ({model.gravity_source}). Moving mass {total:.4f} kg.",
    ]
    for table in tables(model):
        parts += [f"## {table.title}", _markdown(table), *(f"- {note}" for note in table.notes)]
    return _join(parts) + "\n"


def _joints(model: ArmModel) -> Table:
    dh, limits = model.dh, model.limits
    columns = (
        "joint",
        "d [mm]",
        "a [mm]",
        "alpha [rad]",
        "q [rad]",
        "qd [rad/s]",
        "qdd [rad/s^2]",
        "torque [Nm]",
        "rotor [kg m^2]",
    )
    numbers = np.column_stack(
        [dh.d * 1e3, dh.a * 1e3, dh.alpha, limits.q, limits.qd, limits.qdd, limits.torque, model.rotor_inertia]
    )
    rows = tuple((name, *(_number(value) for value in row)) for name, row in zip(JOINT_NAMES, numbers, strict=True))
    notes = (
        f"d, a, alpha: {dh.source}; standard Denavit-Hartenberg, no offsets on theta",
        f"limits, plus and minus: {limits.source}",
        f"rotor, reflected through the gear: {model.rotor_source}",
    )
    return Table("Joints", columns, rows, notes)


def _links(model: ArmModel) -> Table:
    columns = ("link", "mass [kg]", "x [mm]", "y [mm]", "z [mm]", *_TENSOR_COLUMNS)
    rows = tuple((str(i), *_body(link.mass, link.center, link.inertia)) for i, link in enumerate(model.links, start=1))
    notes = ["mass centre in the link's DH frame; tensor about it in the frame's axes, kg m^2"]
    for what in ("mass", "center", "inertia"):
        notes += _sources(what, model.links)
    return Table("Links", columns, rows, tuple(notes))


def _cylinders(model: ArmModel) -> Table:
    columns = ("link", "cylinder", "mass [kg]", "height [mm]", "radius [mm]", "axis", "x [mm]", "y [mm]", "z [mm]")
    rows = tuple(
        (
            str(i),
            part.name,
            _number(part.mass),
            _number(part.height * 1e3),
            _number(part.radius * 1e3),
            part.axis,
            *_millimetres(part.center),
        )
        for i, link in enumerate(model.links, start=1)
        for part in link.cylinders
    )
    notes = ["centre in the link's DH frame"]
    for i, link in enumerate(model.links, start=1):
        notes += _differences(i, link)
    return Table("Cylinders", columns, rows, tuple(notes))


def _tool(tool: Tool) -> Table:
    columns = ("part", "mass [kg]", "shape [mm]", "x [mm]", "y [mm]", "z [mm]", *_TENSOR_COLUMNS)
    rows = []
    for part in tool.parts:
        mass, *rest = _body(part.mass, part.center, part.inertia())
        if isinstance(part, Cylinder):
            shape = f"cylinder, height {_number(part.height * 1e3)}, radius {_number(part.radius * 1e3)}"
        elif isinstance(part, Sphere):
            shape = f"sphere, radius {_number(part.radius * 1e3)}"
        else:
            shape = "box " + " x ".join(_number(edge * 1e3) for edge in part.size)
        rows.append((part.name, mass, shape, *rest))
    mass, *rest = _body(tool.mass, tool.center, tool.inertia)
    rows.append(("together", mass, "", *rest))
    notes = ["centre in the flange frame; tensor about it, kg m^2", f"source: {tool.source}"]
    for name, origin in tool.sensors.items():
        notes.append(f"sensor frame {name} at ({', '.join(_millimetres(origin))}) mm, axes of the flange")
    return Table(f"Tool: {tool.title}", columns, tuple(rows), tuple(notes))


def _differences(i: int, link: Link) -> list[str]:
    """What the cylinders of link ``i`` say otherwise than the link's own mass and centre."""
    notes = []
    offset_mm = (link.cylinder_center() - link.center) * 1e3
    distance = float(np.linalg.norm(offset_mm))
    if distance > _NOTABLE_MM:
        offset = ", ".join(f"{value + 0.0:.2f}" for value in np.round(offset_mm, 2))
        notes.append(
            f"link {i}: the cylinders' common centre is {distance:.2f} mm from the link's, by ({offset}) mm; "
            f"the model uses the link's ({link.sources['center']})"
        )
    mass = sum(part.mass for part in link.cylinders)
    if abs(mass - link.mass) > 1e-9:
        tensor = "; the tensor is the cylinders'" if link.inertia.any() else ""
        notes.append(
            f"link {i}: the cylinders weigh {_number(mass)} kg, the link {_number(link.mass)} kg; "
            f"the model weighs the latter ({link.sources['mass']}){tensor}"
        )
    return notes


def _sources(what: str, links: Sequence[Link]) -> list[str]:
    """One line for links that share a source, else one a link."""
    by_source: dict[str, list[str]] = {}
    for i, link in enumerate(links, start=1):
        by_source.setdefault(link.sources.get(what, "not given"), []).append(str(i))
    if len(by_source) == 1:
        return [f"{what}: {next(iter(by_source))}"]
    return [f"{what} of link {', '.join(numbers)}: {source}" for source, numbers in by_source.items()]


def _body(mass: float, center: np.ndarray, tensor: np.ndarray) -> tuple[str, ...]:
    moments = (tensor[index] for index in _TENSOR_INDEX)
    return (_number(mass), *_millimetres(center), *(f"{moment:.6f}" if moment else "0" for moment in moments))


def _millimetres(point: np.ndarray) -> tuple[str, ...]:
    return tuple(_number(value * 1e3) for value in point)


def _number(value: float) -> str:
    # Rounding takes off what the step from mm to m and back added; adding zero turns -0 into 0.
    return f"{round(float(value), 9) + 0.0:.6g}"


def _markdown(table: Table) -> str:
    """Padded, so that it reads in a terminal: words to the left, numbers to the right."""
    columns = list(zip(table.columns, *table.rows, strict=True))
    padded = []
    for name, *cells in columns:
        width = max(len(cell) for cell in (name, *cells))
        if name in _WORDS:
            padded.append([cell.ljust(width) for cell in (name, ":" + "-" * (width - 1), *cells)])
        else:
            padded.append([cell.rjust(width) for cell in (name, "-" * (width - 1) + ":", *cells)])
    return "\n".join(f"| {' | '.join(row)} |" for row in zip(*padded, strict=True))


def _join(parts: list[str]) -> str:
    """Blocks with a blank line between them, the notes under a table close together."""
    text = parts[0]
    for before, part in itertools.pairwise(parts):
        text += ("\n" if before.startswith("- ") and part.startswith("- ") else "\n\n") + part
    return text
