"""Force mode: the tool gives way along chosen axes until what the controller believes to press with is what was asked.

An admittance, not the robot's own unpublished law: in the task frame the tool centre point moves along compliant axes
at a speed that is proportional to the force that is missing, within the limits, and stands along the others::

    v = gain scaling (1 - 0.9 damping) (wrench - believed)

The belief is actual_TCP_force, which friction blinds by several N (docs/servo.md): the tool presses with so much more
or less. Force mode is a motion of its own: another motion ends it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ur5_twin import spatial
from ur5_twin.errors import ScriptError
from ur5_twin.wire.builtins.arguments import number, numbers
from ur5_twin.wire.motion import Move
from ur5_twin.wire.urscript import costs

if TYPE_CHECKING:
    from ur5_twin.wire.builtins.moving import Moving
    from ur5_twin.wire.controller import VirtualController

#: Speed for a force that is missing, m/s per N and rad/s per Nm: against 20 N/mm and the 0.12 s over which the belief
#: is averaged it does not overshoot by much.
_GAIN = np.array([3e-4] * 3 + [3e-3] * 3)
#: The tool's acceleration, m/s^2 and rad/s^2.
_ACCELERATION = 1.0
#: The only type: forces in the task frame as it is.
_AS_IT_IS = 2


class Force:
    def __init__(self, controller: VirtualController, moving: Moving) -> None:
        self._controller, self._moving = controller, moving
        self._scaling, self._damping = 1.0, 0.0
        self._move: Move | None = None

    @costs(100)
    def force_mode(self, task_frame: Any, selection_vector: Any, wrench: Any, type: Any, limits: Any) -> None:
        """Press with a wrench, N and Nm, along the axes of the task frame whose selection is 1, until further notice.

        Args:
            task_frame: pose in the base; only its rotation counts.
            selection_vector: six of 0 and 1.
            wrench: of the tool on its surroundings.
            type: 2, the task frame as it is.
            limits: speeds along compliant axes, m/s and rad/s; those of the others do not count.
        """
        R_BT = spatial.rotation_from_vector(numbers("force_mode: task_frame", task_frame)[3:])
        chosen = numbers("force_mode: selection_vector", selection_vector)
        if not np.isin(chosen, (0.0, 1.0)).all():
            raise ScriptError("force_mode: selection_vector holds zeros and ones")
        asked = numbers("force_mode: wrench", wrench)
        if number("force_mode: type", type) != _AS_IT_IS:
            raise ScriptError("force_mode: only type 2, the task frame as it is, is simulated")
        fastest = np.abs(numbers("force_mode: limits", limits))
        p_FT = self._controller.tcp_offset[:3].copy()

        def twist() -> np.ndarray:
            believed = np.array(self._controller.state.signals["actual_TCP_force"], dtype=float)
            # About the tool centre point, in the task frame.
            believed[3:] -= spatial.cross(self._controller.tool_arm(p_FT), believed[:3])
            in_task = np.concatenate([R_BT.T @ believed[:3], R_BT.T @ believed[3:]])
            gain = _GAIN * self._scaling * (1.0 - 0.9 * self._damping)
            speed = chosen * np.clip(gain * (asked - in_task), -fastest, fastest)
            return np.concatenate([R_BT @ speed[:3], R_BT @ speed[3:]])

        self._moving.claim()
        self._move = self._controller.motion.guided(twist, _ACCELERATION, p_FT)

    def end_force_mode(self) -> None:
        """Stand, if force mode is on."""
        if self._move is not None and not self._move.over:
            self._controller.motion.stop()
        self._move = None

    def force_mode_set_damping(self, damping: Any) -> None:
        """0 to 1: at 1 the tool is ten times slower."""
        self._damping = float(np.clip(number("force_mode_set_damping: damping", damping), 0.0, 1.0))

    def force_mode_set_gain_scaling(self, scaling: Any) -> None:
        """0 to 2: the speed's factor."""
        self._scaling = float(np.clip(number("force_mode_set_gain_scaling: scaling", scaling), 0.0, 2.0))
