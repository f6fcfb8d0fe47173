"""Motion: one thread of a program moves the arm at a time."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import TYPE_CHECKING, Any

import numpy as np

from ur5_twin import spatial
from ur5_twin.arm import kinematics
from ur5_twin.control.commands import MoveC, MoveJ, MoveL
from ur5_twin.control.commands import Pose as ToolPose
from ur5_twin.errors import ScriptError
from ur5_twin.wire.builtins.arguments import number, numbers
from ur5_twin.wire.motion import Move
from ur5_twin.wire.urscript import Pose

if TYPE_CHECKING:
    from ur5_twin.wire.controller import VirtualController

Waiting = Generator[None, None, None]


class Moving:
    def __init__(self, controller: VirtualController) -> None:
        self._controller = controller
        self._mover: int | None = None
        self._waits = 0

    def movej(self, q: Any, a: Any = 1.4, v: Any = 1.05, t: Any = 0, r: Any = 0) -> Waiting:
        """Straight in joint space to six angles or a pose.

        With a radius ``r`` the call is over once the tool is that near, and a move that follows at once blends with it.
        """
        command = MoveJ(_goal("movej", q), **_rates("movej", a, v, t, r))
        yield from self._until_over(lambda: self._along(command))

    def movel(self, pose: Any, a: Any = 1.2, v: Any = 0.25, t: Any = 0, r: Any = 0) -> Waiting:
        """The tool straight in space, likewise."""
        command = MoveL(_goal("movel", pose), **_rates("movel", a, v, t, r))
        yield from self._until_over(lambda: self._along(command))

    def movep(self, pose: Any, a: Any = 1.2, v: Any = 0.25, r: Any = 0) -> Waiting:
        """As movel: its speed is not kept through corners."""
        yield from self.movel(pose, a, v, 0, r)

    def movec(self, pose_via: Any, pose_to: Any, a: Any = 1.2, v: Any = 0.25, r: Any = 0, mode: Any = 0) -> Waiting:
        """The tool on a circle from where it is through a position to a pose; ``r`` as for movej.

        Six joint angles stand for the tool's pose there. ``mode`` 0 turns the tool evenly to the goal's orientation, 1
        keeps it to the circle's tangent.
        """
        rates = {name: number(f"movec: {name}", value) for name, value in (("a", a), ("v", v), ("r", r))}
        via, goal = self._pose("via", pose_via), self._pose("to", pose_to)
        if number("movec: mode", mode) not in (0.0, 1.0):
            raise ScriptError(f"movec: mode is {mode:g}, it must be 0 or 1")
        command = MoveC(via, goal, **rates, turns_with=mode == 1)
        yield from self._until_over(lambda: self._along(command))

    def servoj(
        self, q: Any, a: Any = 0, v: Any = 0, t: Any = 0.002, lookahead_time: Any = 0.1, gain: Any = 300
    ) -> Waiting:
        """Go after a set point for ``t`` s, and on until the next motion; ``a`` and ``v`` do not count."""
        goal = numbers("servoj: q", q)
        ahead, stiff = number("servoj: lookahead_time", lookahead_time), number("servoj: gain", gain)
        yield from self._for(lambda: self._motion.servoj(goal, ahead, stiff), number("servoj: t", t))

    def speedj(self, qd: Any, a: Any = 1.4, t: Any = 0, aRot: Any = 0, t_min: Any = 0) -> Waiting:
        """Turn the joints at speeds, for ``t`` s or until they have them; they keep them until the next motion.

        ``t_min`` is what the first controllers called ``t``.
        """
        speeds, rate = numbers("speedj: qd", qd), number("speedj: a", a)
        yield from self._for(lambda: self._motion.speedj(speeds, rate), number("speedj: t", t or t_min))

    def speedl(self, xd: Any, a: Any = 1.2, t: Any = 0, aRot: Any = 0, t_min: Any = 0) -> Waiting:
        """Move the tool at a speed in base axes, likewise."""
        speeds, rate, point = numbers("speedl: xd", xd), number("speedl: a", a), self._controller.tcp_offset[:3]
        yield from self._for(lambda: self._motion.speedl(speeds, rate, point), number("speedl: t", t or t_min))

    def stopj(self, a: Any = 2) -> Waiting:
        """Come to rest, ``a`` in rad/s^2."""
        rate = number("stopj: a", a)
        yield from self._until_over(lambda: self._motion.stop(rate))

    def stopl(self, a: Any = 20, aRot: Any = 0) -> Waiting:
        """Come to rest; the joints keep their direction. ``a`` m/s^2 at a reach of half a metre."""
        rate = 2.0 * number("stopl: a", a)
        yield from self._until_over(lambda: self._motion.stop(rate))

    def freedrive_mode(self, freeAxes: Any = None, feature: Any = None) -> None:
        """Give way to pushes, in all axes."""
        self.claim()
        self._motion.free(self._controller.measured_positions())

    def end_freedrive_mode(self) -> None:
        """Stand again."""
        self._motion.stop()

    def teach_mode(self) -> None:
        """As freedrive_mode."""
        self.freedrive_mode()

    def end_teach_mode(self) -> None:
        """Stand again."""
        self._motion.stop()

    @property
    def _motion(self) -> Any:
        return self._controller.motion

    def _pose(self, what: str, value: Any) -> ToolPose:
        goal = _goal(f"movec: pose_{what}", value)
        if isinstance(goal, ToolPose):
            return goal
        X_BT = kinematics.forward(self._controller.model, np.array(goal)) @ self._controller.X_FT
        return ToolPose(tuple(spatial.vector_from_pose(X_BT).tolist()))

    def _along(self, command: MoveJ | MoveL | MoveC) -> Move:
        return self._motion.along(command, self._controller.X_FT)

    def claim(self) -> None:
        """Take the arm for the thread whose turn it is.

        Raises:
            ScriptError: another thread has it.
        """
        thread = self._controller.thread
        if thread is None:
            raise ScriptError("a secondary program must not move the robot")
        if self._waits and self._mover != thread:
            raise ScriptError("another thread is already controlling the robot")
        self._mover = thread

    def _until_over(self, begin: Callable[[], Move]) -> Waiting:
        self.claim()
        move = begin()
        self._waits += 1
        try:
            while not (move.over or self._motion.arriving):
                yield
            if move.error is not None:
                raise move.error
        finally:
            self._waits -= 1
            if not (move.over or self._motion.arriving):
                self._motion.stop()

    def _for(self, begin: Callable[[], Move], seconds: float) -> Waiting:
        """Wait so long, or until the speed is reached if no time is given; the motion goes on."""
        self.claim()
        move = begin()
        ticks = max(1, round(seconds / self._motion.period))
        self._waits += 1
        finished = False
        try:
            while ticks > 0 if seconds > 0.0 else not move.reached:
                yield
                ticks -= 1
            finished = True
        finally:
            self._waits -= 1
            if not finished and not move.over:
                self._motion.stop()


def _rates(what: str, a: Any, v: Any, t: Any, r: Any) -> dict[str, float]:
    return {name: number(f"{what}: {name}", value) for name, value in (("a", a), ("v", v), ("t", t), ("r", r))}


def _goal(what: str, value: Any) -> tuple[float, ...] | ToolPose:
    """Six joint angles, or a pose of the tool centre point."""
    goal = numbers(f"{what}: the goal", value)
    return ToolPose(tuple(goal.tolist())) if isinstance(value, Pose) else tuple(goal.tolist())
