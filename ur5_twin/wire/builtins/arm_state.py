"""What a program can ask of the arm: where it is, what it feels, and its kinematics and dynamics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ur5_twin import spatial
from ur5_twin.arm import inverse_kinematics, kinematics
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.control.limits import check_position
from ur5_twin.errors import ScriptError, TwinError
from ur5_twin.wire.builtins.arguments import number, numbers
from ur5_twin.wire.urscript import Pose, costs

if TYPE_CHECKING:
    from ur5_twin.wire.controller import VirtualController

#: A joint slower than this stands, rad/s; a force larger than this is a contact of the tool, N.
_STANDS, _TOUCHES = 2e-3, 20.0
#: How far a solution may miss its pose, m and rad, as URScript has it.
_MISS = 1e-10


class ArmState:
    def __init__(self, controller: VirtualController) -> None:
        self._controller = controller

    def get_actual_joint_positions(self) -> list[float]:
        """Measured, rad."""
        return self._signal("actual_q")

    def get_joint_positions(self) -> list[float]:
        """As get_actual_joint_positions."""
        return self._signal("actual_q")

    def get_actual_joint_positions_history(self, steps: Any = 0) -> list[float]:
        """Measured so many ticks ago, rad."""
        history = self._controller.history
        k = number("get_actual_joint_positions_history: steps", steps)
        if not 0 <= k < len(history):
            raise ScriptError(f"get_actual_joint_positions_history: {k:g} ticks back; {len(history)} are known")
        return history[int(k)].tolist()

    def get_actual_joint_speeds(self) -> list[float]:
        """Measured, rad/s."""
        return self._signal("actual_qd")

    def get_target_joint_positions(self) -> list[float]:
        """The reference, rad."""
        return self._controller.motion.target[0].tolist()

    def get_target_joint_speeds(self) -> list[float]:
        """The reference's, rad/s."""
        return self._controller.motion.target[1].tolist()

    def get_target_joint_accelerations(self) -> list[float]:
        """The reference's, rad/s^2."""
        return self._controller.motion.target[2].tolist()

    @costs(100)
    def get_actual_tcp_pose(self) -> Pose:
        """Of the tool centre point in the base, measured."""
        return self._pose(self._controller.measured)

    def get_actual_tool_flange_pose(self) -> Pose:
        """Of the flange in the base, measured."""
        return Pose(kinematics.tcp_pose(self._model, self._controller.measured).tolist())

    @costs(100)
    def get_target_tcp_pose(self) -> Pose:
        """Of the tool centre point, of the reference."""
        return self._pose(self._controller.motion.target[0])

    @costs(100)
    def get_target_waypoint(self) -> Pose:
        """As get_target_tcp_pose."""
        return self.get_target_tcp_pose()

    def get_actual_tcp_speed(self) -> list[float]:
        """m/s and rad/s in base axes, measured."""
        return self._signal("actual_TCP_speed")

    def get_target_tcp_speed(self) -> list[float]:
        """Of the reference."""
        return self._signal("target_TCP_speed")

    def get_tcp_force(self) -> list[float]:
        """What the controller believes the arm exerts at the flange, base axes, N and Nm."""
        return self._signal("actual_TCP_force")

    def tcp_force_size(self) -> float:
        """``force()``: the length of its force, N."""
        return float(np.linalg.norm(self.get_tcp_force()[:3]))

    def get_joint_torques(self) -> list[float]:
        """Of the motors beyond what the motion needs and friction explains, Nm: J' of get_tcp_force."""
        J = kinematics.jacobian(self._model, self._controller.measured)
        return (J.T @ np.array(self.get_tcp_force())).tolist()

    def get_joint_temp(self, j: Any) -> float:
        """Not simulated: 0."""
        return 0.0

    def get_controller_temp(self) -> float:
        """Not simulated: 0."""
        return 0.0

    @costs(100)
    def get_forward_kin(self, q: Any = None, tcp: Any = None) -> Pose:
        """Pose of the tool centre point at six angles, by default the reference's and the active one."""
        angles = self._controller.motion.target[0] if q is None else numbers("get_forward_kin: q", q)
        X_FT = self._offset("get_forward_kin", tcp)
        return Pose(spatial.vector_from_pose(kinematics.forward(self._model, angles) @ X_FT).tolist())

    @costs(400)
    def get_inverse_kin(
        self,
        x: Any,
        qnear: Any = None,
        maxPositionError: Any = _MISS,
        maxOrientationError: Any = _MISS,
        tcp: Any = None,
    ) -> list[float]:
        """The six angles nearest to ``qnear`` (the reference's) that put the tool centre point at a pose.

        They are exact, so that the errors that are allowed do not count.
        """
        found = self._inverse("get_inverse_kin", x, qnear, tcp)
        if found is None:
            raise ScriptError("get_inverse_kin: no joint position reaches that pose")
        return found.tolist()

    @costs(400)
    def get_inverse_kin_has_solution(
        self,
        pose: Any,
        qnear: Any = None,
        maxPositionError: Any = _MISS,
        maxOrientationError: Any = _MISS,
        tcp: Any = None,
    ) -> bool:
        """Whether get_inverse_kin finds one."""
        return self._inverse("get_inverse_kin_has_solution", pose, qnear, tcp) is not None

    @costs(25)
    def get_jacobian(self, q: Any = None, tcp: Any = None) -> list[list[float]]:
        """Of the tool centre point, base axes, m and rad."""
        angles = self._controller.measured if q is None else numbers("get_jacobian: q", q)
        p_FT = self._offset("get_jacobian", tcp)[:3, 3]
        return kinematics.point_jacobian(self._model, angles, 6, p_FT).tolist()

    @costs(30)
    def get_jacobian_time_derivative(self, q: Any = None, qd: Any = None, tcp: Any = None) -> list[list[float]]:
        """Of get_jacobian, at angles and speeds that are by default the measured ones."""
        angles = self._controller.measured if q is None else numbers("get_jacobian_time_derivative: q", q)
        speeds = self._signal("actual_qd") if qd is None else numbers("get_jacobian_time_derivative: qd", qd)
        p_FT = self._offset("get_jacobian_time_derivative", tcp)[:3, 3]
        return kinematics.jacobian_dot(self._model, angles, speeds, 6, p_FT).tolist()

    @costs(200)
    def get_mass_matrix(self, q: Any = None, include_rotors_inertia: Any = True) -> list[list[float]]:
        """Of the controller's model, kg m^2."""
        angles = self._controller.measured if q is None else numbers("get_mass_matrix: q", q)
        M = Dynamics(self._model).mass_matrix(angles)
        return (M if include_rotors_inertia else M - np.diag(self._model.rotor_inertia)).tolist()

    @costs(200)
    def get_coriolis_and_centrifugal_torques(self, q: Any = None, qd: Any = None) -> list[float]:
        """Of the controller's model, Nm."""
        angles = self._controller.measured if q is None else numbers("get_coriolis_and_centrifugal_torques: q", q)
        speeds = (
            np.array(self._signal("actual_qd"))
            if qd is None
            else numbers("get_coriolis_and_centrifugal_torques: qd", qd)
        )
        return (Dynamics(self._model).coriolis_matrix(angles, speeds) @ speeds).tolist()

    def is_steady(self) -> bool:
        """Whether reference and arm stand."""
        speeds = self._controller.state.signals.get("actual_qd")
        still = speeds is None or bool((np.abs(speeds) < _STANDS).all())
        return still and not self._controller.motion.moving

    @costs(400)
    def is_within_safety_limits(self, pose: Any) -> bool:
        """Whether six angles are within the joints' limits, or a pose can be reached."""
        if isinstance(pose, Pose):
            return self.get_inverse_kin_has_solution(pose)
        try:
            check_position(self._model.limits, numbers("is_within_safety_limits: q", pose), "q")
        except ScriptError:
            raise
        except TwinError:
            return False
        return True

    def tool_contact(self, direction: Any = None) -> int:
        """1 while the controller believes that the tool is pushed (against a direction, if one is given), else 0."""
        force = -np.array(self.get_tcp_force()[:3])
        if direction is not None:
            along = numbers("tool_contact: direction", direction)[:3]
            size = np.linalg.norm(along)
            if size > 0.0:
                return int(-force @ along / size > _TOUCHES)
        return int(np.linalg.norm(force) > _TOUCHES)

    def get_freedrive_status(self) -> int:
        """0: no joint is held back."""
        return 0

    @property
    def _model(self) -> Any:
        return self._controller.model

    def _signal(self, name: str) -> list[float]:
        value = self._controller.state.signals.get(name)
        return np.zeros(6).tolist() if value is None else np.asarray(value, dtype=float).tolist()

    def _pose(self, q: np.ndarray) -> Pose:
        return Pose(spatial.vector_from_pose(kinematics.forward(self._model, q) @ self._controller.X_FT).tolist())

    def _offset(self, what: str, tcp: Any) -> np.ndarray:
        if tcp is None or tcp == "active_tcp":
            return self._controller.X_FT
        return spatial.pose_from_vector(numbers(f"{what}: tcp", tcp))

    def _inverse(self, what: str, x: Any, qnear: Any, tcp: Any) -> np.ndarray | None:
        pose = spatial.pose_from_vector(numbers(f"{what}: the pose", x))
        near = self._controller.motion.target[0] if qnear is None else numbers(f"{what}: qnear", qnear)
        q = inverse_kinematics.nearest(self._model, pose @ np.linalg.inv(self._offset(what, tcp)), near)
        return q if np.isfinite(q).all() else None
