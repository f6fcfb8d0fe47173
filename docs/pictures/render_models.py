"""Draw the pictures of ``docs/models.md``.

    MUJOCO_GL=egl python docs/pictures/render_models.py [--folder docs/pictures]

(``MUJOCO_GL=osmesa`` where there is no graphics driver.)
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import matplotlib.image
import mujoco
import numpy as np
from dm_control import mjcf as dm_mjcf

from ur5_twin.arm import mjcf
from ur5_twin.arm.mjcf import scenery
from ur5_twin.arm.parameters import load_model

# Drawn twice as large and averaged: clean edges whatever the driver.
_OVERSAMPLING = 2


def main() -> None:
    """Write models.png and scene.png."""
    parser = argparse.ArgumentParser(description="Draw the pictures of docs/models.md.")
    parser.add_argument("--folder", type=Path, default=Path(__file__).parent, help="where to write")
    folder = parser.parse_args().folder
    _save(folder / "models.png", _models())
    _save(folder / "scene.png", _scene())


def _models() -> np.ndarray:
    """Models A, B and C side by side, in the manner of thesis figures 5.7 and 5.8."""
    root: Any = dm_mjcf.RootElement(model="models")
    azimuth = 68.0
    across = np.array([np.sin(np.radians(azimuth)), -np.cos(np.radians(azimuth))])  # the picture's horizontal
    places = [(float(x), float(y)) for x, y in np.outer([-0.85, 0.0, 0.85], across)]
    scenery.add(root, stands=places)
    q = []
    for name, (x, y) in zip("abc", places, strict=True):
        arm = mjcf.build(load_model(name))
        arm.keyframe.remove()
        root.worldbody.add("site", name=f"place_{name}", pos=[x, y, 0.0], rgba=[0, 0, 0, 0]).attach(arm)
        q += [-0.2, -1.35, 0.95, -1.17, -1.57, 0.0]
    mj_model = mjcf.to_mujoco(root)
    data = mujoco.MjData(mj_model)
    data.qpos[:] = q
    mj_model.vis.global_.fovy = 20  # from afar, so that the outer arms are seen as the middle one
    return _shot(mj_model, data, (1600, 640), _camera(azimuth, -5, 3.7, [-0.16, 0.1, 0.33]))


def _scene() -> np.ndarray:
    """The plant with the force sensor in the scene that ships."""
    mj_model = mjcf.compile(load_model("plant", "ati_gamma"), scene=True)
    data = mujoco.MjData(mj_model)
    mujoco.mj_resetDataKeyframe(mj_model, data, mj_model.key("ready").id)
    return _shot(mj_model, data, (1280, 960), "front")


def _camera(azimuth: float, elevation: float, distance: float, lookat: list[float]) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = azimuth, elevation, distance
    camera.lookat[:] = lookat
    return camera


def _shot(
    mj_model: mujoco.MjModel, data: mujoco.MjData, size: tuple[int, int], camera: mujoco.MjvCamera | str
) -> np.ndarray:
    """A picture (height, width, 3)."""
    width, height = (side * _OVERSAMPLING for side in size)
    mj_model.vis.global_.offwidth, mj_model.vis.global_.offheight = width, height
    mujoco.mj_forward(mj_model, data)
    with mujoco.Renderer(mj_model, height, width) as renderer:
        renderer.update_scene(data, camera)
        pixels = renderer.render().astype(float)
    blocks = pixels.reshape(height // _OVERSAMPLING, _OVERSAMPLING, width // _OVERSAMPLING, _OVERSAMPLING, 3)
    return blocks.mean(axis=(1, 3)).astype(np.uint8)


def _save(path: Path, picture: np.ndarray) -> None:
    matplotlib.image.imsave(path, picture)
    print(f"{path.name}: {path.stat().st_size // 1024} kB")


main()
