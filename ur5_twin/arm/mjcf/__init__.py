"""The arm as MJCF: ``build`` makes it, ``compile`` gives the MuJoCo model, ``export`` the file."""

from __future__ import annotations

from ur5_twin.arm.mjcf.builder import BODY_NAMES, KEYFRAMES, build, compile, to_mujoco
from ur5_twin.arm.mjcf.export import SHIPPED, export, write_models, xml_string
from ur5_twin.arm.mjcf.obstacles import Obstacle, set_payload

__all__ = [
    "BODY_NAMES",
    "KEYFRAMES",
    "SHIPPED",
    "Obstacle",
    "build",
    "compile",
    "export",
    "set_payload",
    "to_mujoco",
    "write_models",
    "xml_string",
]
