"""What programs give to the robot's functions, checked."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript import shown
from ur5_twin.wire.urscript.values import is_number

#: What the cell's controller cannot do. A program may name them, as ur_rtde's does, but not call them.
NOT_SIMULATED = (
    "direct_torque",
    "end_screw_driving",
    "enable_external_ft_sensor",
    "ft_rtde_input_enable",
    "optimovej",
    "optimovel",
    "path_offset_enable",
    "screw_driving",
    "servoc",
    "socket_get_var",
    "torque_command",
)


def refused(name: str) -> Callable[..., Any]:
    """A function that says that it is not simulated."""

    def call(*args: Any, **named: Any) -> None:
        raise ScriptError(f"{name} is not simulated")

    return call


def number(what: str, value: Any) -> float:
    """A number.

    Raises:
        ScriptError: it is none, or not finite.
    """
    if not is_number(value) or not np.isfinite(value):
        raise ScriptError(f"{what} is {shown(value)[:40]}, it must be a number")
    return float(value)


def numbers(what: str, value: Any, n: int = 6) -> np.ndarray:
    """(n,) a list of numbers.

    Raises:
        ScriptError: it is none of that length.
    """
    if not isinstance(value, list) or len(value) != n or not all(is_number(item) for item in value):
        raise ScriptError(f"{what} is {shown(value)[:60]}, it must be a list of {n} numbers")
    found = np.array(value, dtype=float)
    if not np.isfinite(found).all():
        raise ScriptError(f"{what} is {shown(value)[:60]}, its numbers must be finite")
    return found
