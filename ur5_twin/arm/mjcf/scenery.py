"""The lab around the arm: floor, stand, light, cameras. Scenery only; no number here enters the arm's dynamics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

#: Height of the floor in the base frame, m; the arm stands on a table-high column.
FLOOR_Z = -0.72
#: The body of the stand under the arm.
STAND = "stand"
_PLATE = 0.02


def add(root: Any, stands: Sequence[tuple[float, float]] = ((0.0, 0.0),)) -> None:
    """Put the lab around the arm. The arm's base stays at the world's origin, on the stand's plate.

    Args:
        root: the MJCF root to add to.
        stands: x and y of each stand, m; its plate's top is at z = 0.
    """
    _assets(root)
    world = root.worldbody
    world.add("geom", name="floor", type="plane", group=0, size=[0, 0, 0.05], pos=[0, 0, FLOOR_Z], material="floor")
    for number, (x, y) in enumerate(stands, start=1):
        _stand(world, STAND if number == 1 else f"{STAND}{number}", x, y)
    _lights_and_cameras(world)


def _stand(world: Any, name: str, x: float, y: float) -> None:
    body = world.add("body", name=name, pos=[x, y, 0.0])
    for part, z, half in (("foot", FLOOR_Z + _PLATE / 2, 0.24), ("plate", -_PLATE / 2, 0.15)):
        body.add(
            "geom",
            name=f"{name}_{part}",
            type="box",
            group=0,
            material="stand",
            size=[half, half, _PLATE / 2],
            pos=[0, 0, z],
            mass=0,
        )
    half = (-FLOOR_Z - 2 * _PLATE) / 2
    body.add(
        "geom",
        name=f"{name}_column",
        type="cylinder",
        group=0,
        material="stand",
        size=[0.075, half],
        pos=[0, 0, -_PLATE - half],
        mass=0,
    )


def _lights_and_cameras(world: Any) -> None:
    world.add(
        "light",
        name="key",
        type="spot",
        pos=[1.5, 0.9, 3.4],
        dir=[-0.4, -0.24, -1.0],
        castshadow=True,
        cutoff=50,
        exponent=3,
        diffuse=[0.6, 0.59, 0.57],
        specular=[0.3, 0.3, 0.3],
    )
    world.add(
        "light",
        name="fill",
        type="directional",
        pos=[-1.5, -2.0, 2.0],
        dir=[0.4, 0.6, -0.6],
        castshadow=False,
        diffuse=[0.27, 0.28, 0.31],
        specular=[0.05, 0.05, 0.05],
    )
    _camera(world, "front", np.array([0.75, 2.05, 0.55]), np.array([-0.15, 0.1, 0.12]))
    _camera(world, "side", np.array([0.95, -2.55, 0.8]), np.array([0.0, 0.0, 0.3]))


def _camera(world: Any, name: str, position: np.ndarray, target: np.ndarray) -> None:
    """A camera at ``position`` that looks at ``target``, upright."""
    back = (position - target) / np.linalg.norm(position - target)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    axes = np.round(np.concatenate([right, np.cross(back, right)]), 6)
    world.add("camera", name=name, pos=position, xyaxes=axes, fovy=40)


def _assets(root: Any) -> None:
    asset = root.asset
    asset.add(
        "texture",
        name="sky",
        type="skybox",
        builtin="gradient",
        rgb1=[0.93, 0.94, 0.95],
        rgb2=[0.62, 0.68, 0.75],
        width=256,
        height=1536,
    )
    asset.add(
        "texture",
        name="tiles",
        type="2d",
        builtin="checker",
        rgb1=[0.74, 0.75, 0.76],
        rgb2=[0.715, 0.725, 0.735],
        mark="edge",
        markrgb=[0.66, 0.67, 0.68],
        width=512,
        height=512,
    )
    asset.add("material", name="floor", texture="tiles", texrepeat=[2, 2], texuniform=True, reflectance=0.12)
    asset.add("material", name="stand", rgba=[0.24, 0.26, 0.29, 1], specular=0.3, shininess=0.3)
    root.visual.rgba.haze = [0.93, 0.94, 0.95, 1]
    root.visual.map.haze = 0.5
