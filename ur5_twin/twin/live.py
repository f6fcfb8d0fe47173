"""The twin beside rows that are still coming: the columns that ``replay`` gives of them once they are a log."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ur5_twin.arm import kinematics
from ur5_twin.arm.drive import LinearDrive
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.control.held import Held, given_up
from ur5_twin.errors import ReplayError, SimulationError
from ur5_twin.twin.lockstep import LONGEST_GAP
from ur5_twin.twin.replay import ReplaySettings, new_twin, target_columns
from ur5_twin.twin.sample import Sample

_TARGETS = ("target_q", "target_qd", "target_qdd")


class LiveTwin:
    """Lockstep with a robot: each row moves the simulated arm to that row's stamp.

    After a silence of more than ``LONGEST_GAP`` seconds it begins again from the robot, as a replay does. Where the
    simulation fails, which ends a replay, it begins again too, and that row's prediction is NaN.

    Args:
        settings: as for a replay. With a current map and motors without friction there is no sim_actual_current: the
            map needs the whole log.

    Attributes:
        restarts: how often it began again after a silence or a path given up.
        failures: how often because the simulation failed.
        failure: why it did so last.

    Raises:
        ReplayError: a measured wrench is to push the arm: none comes with the robot's rows.
    """

    def __init__(self, settings: ReplaySettings) -> None:
        if settings.wrench != "none":
            raise ReplayError("live, no measured wrench pushes the twin: leave out --wrench")
        self._settings = settings
        self._loop, self._twin = new_twin(settings)
        self._simulated = settings.mode == "servo" and settings.joints is not None
        self._believed = Dynamics(settings.model)
        self._held = Held()
        self._last: float | None = None
        #: target_q and actual_q of the row before.
        self._before: tuple[np.ndarray, np.ndarray] | None = None
        self.restarts = self.failures = 0
        self.failure: str | None = None

    def follow(self, time: np.ndarray, columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Go on by rows of the robot.

        Args:
            time: (n,) s, increasing, and after the rows before.
            columns: finite, by RTDE's names; actual_q, actual_qd and, to follow targets, all three of them.

        Returns:
            ``sim_`` columns, as ``replay`` names them.

        Raises:
            ReplayError: servo replay, and there are no targets.
        """
        has_targets = all(name in columns for name in _TARGETS)
        if not has_targets and self._settings.mode == "servo":
            raise ReplayError("the robot publishes no targets to follow: use --mode shadow")
        targets = np.stack([columns[name] for name in _TARGETS], axis=1) if has_targets else None
        q, qd = (np.ascontiguousarray(columns[name]) for name in ("actual_q", "actual_qd"))
        measured_current = columns.get("actual_current")
        said = {name: np.full((len(time), 6), np.nan) for name in ("q", "qd", "moment", "current")}
        begun_again = np.zeros(len(time), dtype=bool)
        for k, stamp in enumerate(time.tolist()):
            target = None if targets is None else targets[k]
            begun_again[k] = self._last is not None and (stamp - self._last > LONGEST_GAP or self._given_up(target))
            self._last, self._before = stamp, None if target is None else (target[0], q[k])
            if self._simulated and target is not None:
                if begun_again[k]:
                    self._held.forget()
                target = self._held.update(target)
            current = None if measured_current is None else measured_current[k]
            sample = Sample(stamp, q[k], qd[k], target, None, current)
            try:
                predicted = self._twin.tick(sample)
            except SimulationError as error:
                self._begin_again(str(error))
                continue
            said["q"][k], said["qd"][k], said["moment"][k] = predicted.q, predicted.qd, predicted.moment
            if predicted.current is not None:
                said["current"][k] = predicted.current
        self.restarts += int(begun_again.sum())
        return self._columns(said, begun_again, columns, has_targets)

    def _given_up(self, target: np.ndarray | None) -> bool:
        if target is None or self._before is None:
            return False
        return bool(given_up(self._before[0], target[0], self._before[1]))

    def _begin_again(self, why: str) -> None:
        self.failures += 1
        self.failure = why
        self._loop, self._twin = new_twin(self._settings)
        self._held.forget()

    def _columns(
        self,
        said: dict[str, np.ndarray],
        begun_again: np.ndarray,
        columns: Mapping[str, np.ndarray],
        has_targets: bool,
    ) -> dict[str, np.ndarray]:
        settings = self._settings
        known = np.isfinite(said["q"]).all(axis=1)
        pose = np.full_like(said["q"], np.nan)
        pose[known] = kinematics.tcp_pose(settings.model, said["q"][known])
        predicted = {
            "sim_actual_q": said["q"],
            "sim_actual_qd": said["qd"],
            "sim_actual_TCP_pose": pose,
            "sim_moment": said["moment"],
        }
        # Where the twin begins again it is where the robot is, by definition.
        for name in ("sim_actual_q", "sim_actual_qd", "sim_actual_TCP_pose"):
            predicted[name][begun_again] = np.nan
        if self._simulated:
            predicted["sim_actual_current"] = said["current"]
        elif isinstance(settings.drive, LinearDrive):
            speed = said["qd"] if settings.mode == "servo" else columns["actual_qd"]
            predicted["sim_actual_current"] = settings.drive.current(said["moment"], speed)
        if has_targets:
            targets = (columns[name] for name in _TARGETS)
            predicted |= target_columns(self._believed, settings.target_current, *targets)
        return predicted
