"""MJCF files: the ones that ship in ``models/`` and those a user asks for."""

from __future__ import annotations

from pathlib import Path

from ur5_twin.arm.mjcf.builder import build, to_xml
from ur5_twin.arm.parameters import MODEL_FILES, ArmModel, load_model
from ur5_twin.atomic import write_text
from ur5_twin.errors import ModelError

#: The files that ship: name -> (model, with the lab around it).
SHIPPED = {
    "ur5_model_a.xml": ("a", False),
    "ur5_model_b.xml": ("b", False),
    "ur5_model_c.xml": ("c", False),
    "ur5_controller.xml": ("controller", False),
    "ur5_plant.xml": ("plant", False),
    "scene.xml": ("plant", True),
}


def xml_string(model: ArmModel, *, scene: bool = False) -> str:
    """The model as MJCF text: self-contained, so that any MuJoCo viewer loads it; its header says its source."""
    return _header(model, scene) + to_xml(build(model, scene=scene))


def export(model: ArmModel, path: str | Path, scene: bool = False) -> None:
    """Write the model as an MJCF file, in one piece.

    Raises:
        ModelError: the file's name does not end in ``.xml``.
        OSError: the file cannot be written.
    """
    target = Path(path)
    if target.suffix.lower() != ".xml":
        raise ModelError(f"cannot export to '{target.name}': models are written as MJCF, give a name that ends in .xml")
    write_text(target, xml_string(model, scene=scene))


def write_models(folder: str | Path) -> list[Path]:
    """Write every file of ``SHIPPED`` into ``folder``; returns their paths."""
    paths = []
    for file, (name, scene) in SHIPPED.items():
        paths.append(Path(folder) / file)
        export(load_model(name), paths[-1], scene=scene)
    return paths


def _header(model: ArmModel, scene: bool) -> str:
    source = MODEL_FILES.get(model.name)
    origin = f"models/{source} and models/ur5.toml" if source else f"the model '{model.name}' and models/ur5.toml"
    if model.tool is None and (model.name, scene) in SHIPPED.values():
        command = "python -m ur5_twin.arm.mjcf"
    else:
        arm = repr(model.name) if model.tool is None else f"{model.name!r}, {model.tool.name!r}"
        command = f"ur5_twin.arm.mjcf.export(load_model({arm}), 'FILE.xml', scene={scene})"
    lines = (model.title, f"Made from {origin}. Change those, not this file, and make it again:", command)
    # An XML comment may not hold two hyphens in a row.
    return "<!--\n" + "".join(f"  {line.replace('--', '- -')}\n" for line in lines) + "-->\n"
