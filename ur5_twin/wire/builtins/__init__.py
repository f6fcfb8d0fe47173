"""URScript's functions that need the robot. Names, parameters and units (m, rad, kg, N, Nm, s) are URScript's."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ur5_twin.wire.builtins.arguments import NOT_SIMULATED, refused
from ur5_twin.wire.builtins.arm_state import ArmState
from ur5_twin.wire.builtins.exchange import Exchange
from ur5_twin.wire.builtins.force import Force
from ur5_twin.wire.builtins.moving import Moving
from ur5_twin.wire.builtins.settings import Settings
from ur5_twin.wire.builtins.sockets import Sockets

if TYPE_CHECKING:
    from ur5_twin.wire.controller import VirtualController

#: Methods of the groups that are no functions of URScript.
_OURS = ("claim", "close_all")


def robot_functions(controller: VirtualController, sockets: Sockets) -> dict[str, Callable[..., Any]]:
    """All of them, of a controller: name -> callable. Those that wait are generator functions, a tick a ``yield``."""
    found: dict[str, Callable[..., Any]] = {name: refused(name) for name in NOT_SIMULATED}
    moving = Moving(controller)
    groups = (moving, Force(controller, moving), ArmState(controller), Settings(controller), Exchange(controller))
    for group in (*groups, sockets):
        for name in dir(group):
            if not name.startswith("_") and name not in _OURS:
                found[name] = getattr(group, name)
    found["force"] = found.pop("tcp_force_size")
    return found
