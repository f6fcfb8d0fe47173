"""What a program tells the controller: payload, tool centre point, gravity."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ur5_twin.errors import ScriptError
from ur5_twin.wire.builtins.arguments import number, numbers
from ur5_twin.wire.urscript import Pose, costs, shown

if TYPE_CHECKING:
    from ur5_twin.wire.controller import VirtualController

#: The tool centre point is within this of the flange, m; parts of its rotation vector, rad.
_FARTHEST, _TURNS = 10.0, 100.0


class Settings:
    def __init__(self, controller: VirtualController) -> None:
        self._controller = controller

    @costs(300)
    def set_payload(self, m: Any, cog: Any = None) -> None:
        """Mass in kg and its centre in the flange in m; without one the centre stays."""
        self._carry("set_payload", m, cog, None)

    @costs(300)
    def set_payload_mass(self, m: Any) -> None:
        """Mass in kg alone."""
        self._carry("set_payload_mass", m, None, None)

    @costs(300)
    def set_payload_cog(self, CoG: Any) -> None:
        """Centre in the flange in m alone."""
        self._carry("set_payload_cog", self._controller.payload, CoG, None)

    @costs(300)
    def set_target_payload(self, m: Any, cog: Any = None, inertia: Any = None, transition_time: Any = 0) -> None:
        """As set_payload, with [Ixx, Iyy, Izz, Ixy, Ixz, Iyz] about the centre in kg m^2; it counts at once."""
        self._carry("set_target_payload", m, cog, inertia)

    def get_target_payload(self) -> float:
        """kg."""
        return self._controller.payload

    def get_target_payload_cog(self) -> list[float]:
        """m, in the flange."""
        return self._controller.payload_cog.tolist()

    def get_target_payload_inertia(self) -> list[float]:
        """[Ixx, Iyy, Izz, Ixy, Ixz, Iyz], kg m^2."""
        return self._controller.payload_inertia.tolist()

    def set_tcp(self, pose: Any, tcp_name: Any = "") -> None:
        """Pose of the tool centre point in the flange."""
        offset = numbers("set_tcp: the pose", pose)
        if np.abs(offset[:3]).max() > _FARTHEST or np.abs(offset[3:]).max() > _TURNS:
            raise ScriptError(f"set_tcp: {shown(pose)[:60]} is more than {_FARTHEST:g} m or {_TURNS:g} rad away")
        self._controller.tcp_offset = offset

    def get_tcp_offset(self) -> Pose:
        """Pose of the tool centre point in the flange."""
        return Pose(self._controller.tcp_offset.tolist())

    def set_gravity(self, d: Any) -> None:
        """Only straight down: the simulated arm stands upright.

        Raises:
            ScriptError: another direction.
        """
        up = numbers("set_gravity: d", d, 3)
        if up[2] <= 0.0 or np.abs(up[:2]).max() > 0.05 * up[2]:
            raise ScriptError("set_gravity: the simulated arm stands upright; only [0, 0, 9.82] is")

    def _carry(self, what: str, m: Any, cog: Any, inertia: Any) -> None:
        mass = number(f"{what}: m", m)
        center = self._controller.payload_cog if cog is None else numbers(f"{what}: the centre", cog, 3)
        tensor = np.zeros((3, 3))
        if inertia is not None:
            xx, yy, zz, xy, xz, yz = numbers(f"{what}: the inertia", inertia)
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        self._controller.carry(mass, center, tensor)
