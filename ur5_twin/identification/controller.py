"""The real controller's own model, from what it says about itself: target_moment and target_current.

Both are computed by the controller without noise, so that ordinary least squares finds its numbers and what is left
shows what the model lacks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.control.target_current import TargetCurrentLaw, driving_share
from ur5_twin.errors import IdentificationError
from ur5_twin.evaluation.metrics import mean_absolute
from ur5_twin.recording.table import Recording

#: Torque whose sign six decimals of a log do not tell with certainty, Nm.
_UNLOADED = 1e-4
#: Step of the derivative with respect to link 6's mass centre, m: the torque is quadratic in it, so central is exact.
_DZ = 1e-3
#: A joint whose target moves for less than this says too little, s.
_SHORTEST_MOTION = 10.0
#: Target speed that counts as motion, rad/s.
_MOVING = 1e-3
#: Rows at rest under load from which a torque constant is taken; a few are ends of moves, not rest.
_ENOUGH_REST = 500
#: Signals each fit reads.
_RIGID_SIGNALS = ("target_q", "target_qd", "target_qdd", "target_moment")
_CURRENT_SIGNALS = ("target_qd", "target_moment", "target_current")


@dataclass(frozen=True)
class RigidFit:
    """Numbers of the controller's rigid-body model with one standard deviation.

    Attributes:
        gravity, gravity_std: m/s^2.
        tensor_share, tensor_share_std: share of the given model's link tensors that target_moment contains.
        link6_z, link6_z_std: mass centre of link 6 along the flange's axis, m.
        rotor_inertia, rotor_inertia_std: (6,) kg m^2.
        mae: (6,) mean absolute error left on the logs of the fit, Nm.
    """

    gravity: float
    gravity_std: float
    tensor_share: float
    tensor_share_std: float
    link6_z: float
    link6_z_std: float
    rotor_inertia: np.ndarray
    rotor_inertia_std: np.ndarray
    mae: np.ndarray

    @property
    def knows_tensors(self) -> bool:
        """Whether the controller computes with the link tensors: with all of them or with none."""
        return self.tensor_share > 0.5

    def arm(self, model: ArmModel) -> ArmModel:
        """The controller's model: masses and centres of the ``model`` that was fitted, and what the fit found."""
        links = [link if self.knows_tensors else replace(link, inertia=np.zeros((3, 3))) for link in model.links]
        links[5] = replace(links[5], center=np.array([0.0, 0.0, self.link6_z]))
        return replace(model, links=tuple(links), gravity=self.gravity, rotor_inertia=self.rotor_inertia)


def fit_rigid(recordings: Sequence[Recording], model: ArmModel) -> RigidFit:
    """Gravity, share of the link tensors, link 6's mass centre and the rotor inertias from target_moment.

    target_moment = (masses' torque) + g G(q) + f (tensors' torque) + z d/dz (link 6's torque) + J_r qdd is linear in
    g, f, z and J_r near z = 0; the masses and the other mass centres are those of ``model``. Joints are weighted by
    what a first fit leaves in each.

    Args:
        recordings: logs with target_q, target_qd, target_qdd and target_moment, no payload set.
        model: masses, centres and the tensors to be scaled; its gravity is where the derivative in z is taken.

    Raises:
        IdentificationError: a signal is missing, a joint moves for less than 10 s in all of the logs, or a rotor
            inertia comes out negative.
    """
    _check(recordings, _RIGID_SIGNALS)
    robots = [recording.robot for recording in recordings]
    q, qd, qdd, moment = (np.concatenate([robot[name] for robot in robots]) for name in _RIGID_SIGNALS)

    def torque(*, tensors: bool, gravity: float, z: float = 0.0) -> np.ndarray:
        links = [link if tensors else replace(link, inertia=np.zeros((3, 3))) for link in model.links]
        links[5] = replace(links[5], center=np.array([0.0, 0.0, z]))
        changed = replace(model, links=tuple(links), rotor_inertia=np.zeros(6), gravity=gravity)
        return Dynamics(changed).inverse(q, qd, qdd)

    masses = torque(tensors=False, gravity=0.0)
    columns = np.zeros((len(q), 6, 9))
    columns[:, :, 0] = torque(tensors=False, gravity=1.0) - masses
    columns[:, :, 1] = torque(tensors=True, gravity=0.0) - masses
    columns[:, :, 2] = (
        torque(tensors=False, gravity=model.gravity, z=_DZ) - torque(tensors=False, gravity=model.gravity, z=-_DZ)
    ) / (2 * _DZ)
    columns[:, range(6), range(3, 9)] = qdd
    left = moment - masses
    solution = np.linalg.lstsq(columns.reshape(-1, 9), left.ravel(), rcond=None)[0]
    weight = 1.0 / (left - columns @ solution).std(axis=0)
    a, b = (columns * weight[:, None]).reshape(-1, 9), (left * weight).ravel()
    solution = np.linalg.lstsq(a, b, rcond=None)[0]
    residual = left - columns @ solution
    std = np.sqrt(np.diag(np.linalg.inv(a.T @ a)) * np.mean((b - a @ solution) ** 2))
    rotors, rotors_std = solution[3:], std[3:]
    if (rotors < -3.0 * rotors_std).any():
        joints = ", ".join(str(j + 1) for j in np.flatnonzero(rotors < -3.0 * rotors_std))
        raise IdentificationError(
            f"the rotor inertia of joint {joints} comes out negative: target_moment is not that of the given masses"
        )
    return RigidFit(
        gravity=float(solution[0]),
        gravity_std=float(std[0]),
        tensor_share=float(solution[1]),
        tensor_share_std=float(std[1]),
        link6_z=float(solution[2]),
        link6_z_std=float(std[2]),
        rotor_inertia=np.maximum(rotors, 0.0),
        rotor_inertia_std=rotors_std,
        mae=np.abs(residual).mean(axis=0),
    )


@dataclass(frozen=True)
class CurrentFit:
    """Coefficients of the target_current law, per joint.

    Attributes:
        torque_constant: (6,) Nm/A at standstill.
        load: (6,) A/Nm.
        viscous: (2, n_logs, 6) A s/rad, driving and back-driven, one per log: it follows the drive's temperature.
        mae: (n_logs, 6) error left with each log's own viscous coefficients, A.
        mae_common: (n_logs, 6) with the logs' mean coefficients, A.
        viscous_mean: (2, 6) A s/rad, the logs' mean, each log counted by the way its joint travels.
    """

    torque_constant: np.ndarray
    load: np.ndarray
    viscous: np.ndarray
    mae: np.ndarray
    mae_common: np.ndarray
    viscous_mean: np.ndarray

    def law(self, source: str) -> TargetCurrentLaw:
        """The law with the mean viscous coefficients."""
        load = np.maximum(self.load, 0.0)  # a small joint's comes out at plus or minus rounding
        return TargetCurrentLaw(source, self.torque_constant, load, self.viscous_mean[0], self.viscous_mean[1])


def fit_target_current(recordings: Sequence[Recording]) -> CurrentFit:
    """target_current = tau / k + load |tau| sgn(qd) + viscous qd, k from the rows at rest, viscous per log and branch.

    The branches are those of ``control.target_current.driving_share``. Rows in motion with less torque than
    ``_UNLOADED`` tell nothing about them, since the log's rounding hides the sign; the fit leaves them out, the errors
    count them.

    Raises:
        IdentificationError: a signal is missing, or a joint moves for less than 10 s in all of the logs.
    """
    _check(recordings, _CURRENT_SIGNALS)
    robots = [recording.robot for recording in recordings]
    count = len(robots)
    constant, load = np.empty(6), np.empty(6)
    viscous = np.empty((2, count, 6))
    mae, mae_common = np.empty((count, 6)), np.empty((count, 6))
    viscous_mean = np.empty((2, 6))
    for joint in range(6):
        at_rest = _constant_at_rest(robots, joint)
        blocks, current = [], []
        for k, robot in enumerate(robots):
            tau, qd = robot["target_moment"][:, joint], robot["target_qd"][:, joint]
            block = np.zeros((len(robot), 2 + 2 * count))
            block[:, 0], block[:, 1] = tau, np.abs(tau) * np.sign(qd)
            driving = driving_share(tau, qd)
            block[:, 2 + k], block[:, 2 + count + k] = driving * qd, (1.0 - driving) * qd
            blocks.append(block)
            current.append(robot["target_current"][:, joint])
        told = [
            (np.abs(robot["target_moment"][:, joint]) > _UNLOADED) | (robot["target_qd"][:, joint] == 0)
            for robot in robots
        ]
        a = np.concatenate([block[rows] for block, rows in zip(blocks, told, strict=True)])
        b = np.concatenate([i[rows] for i, rows in zip(current, told, strict=True)])
        if at_rest is None:
            solution = np.linalg.lstsq(a, b, rcond=None)[0]
        else:
            moving = np.linalg.lstsq(a[:, 1:], b - a[:, 0] / at_rest, rcond=None)[0]
            solution = np.concatenate([[1.0 / at_rest], moving])
        constant[joint], load[joint] = 1.0 / solution[0], solution[1]
        viscous[:, :, joint] = solution[2:].reshape(2, count)
        viscous_mean[:, joint] = _mean_moving(viscous[:, :, joint], robots, joint)
        common = np.concatenate([solution[:2], np.repeat(viscous_mean[:, joint], count)])
        mae[:, joint] = [np.abs(b @ solution - i).mean() for b, i in zip(blocks, current, strict=True)]
        mae_common[:, joint] = [np.abs(b @ common - i).mean() for b, i in zip(blocks, current, strict=True)]
    return CurrentFit(constant, load, viscous, mae, mae_common, viscous_mean)


def _constant_at_rest(robots: Sequence, joint: int) -> float | None:
    """Torque constant in Nm/A from the rows at rest, which no temperature disturbs; None for a joint without load."""
    still = [
        (robot["target_qd"] == 0).all(axis=1) & (np.abs(robot["target_moment"][:, joint]) > 0.1) for robot in robots
    ]
    tau = np.concatenate([robot["target_moment"][rows, joint] for robot, rows in zip(robots, still, strict=True)])
    current = np.concatenate([robot["target_current"][rows, joint] for robot, rows in zip(robots, still, strict=True)])
    # The median: the last tick of a move looks like rest and still has its friction in the current.
    return float(np.median(tau / current)) if len(tau) >= _ENOUGH_REST else None


def _mean_moving(viscous: np.ndarray, robots: Sequence, joint: int) -> np.ndarray:
    """(2,) mean of the logs' coefficients, each log counted by the way its joint travels."""
    travel = np.array([np.abs(robot["target_qd"][:, joint]).sum() for robot in robots])
    moved = travel > 0
    return viscous[:, moved] @ travel[moved] / travel[moved].sum()


def held_out_moment(recordings: Sequence[Recording], model: ArmModel) -> np.ndarray:
    """MAE (n_logs, 6) in Nm of each log's target_moment by a fit on all the other logs; NaN where they cannot carry it.

    Args:
        recordings: two logs or more.
        model: what ``fit_rigid`` takes.
    """
    errors = np.full((len(recordings), 6), np.nan)
    for k, unseen in enumerate(recordings):
        others = [recording for i, recording in enumerate(recordings) if i != k]
        try:
            dynamics = Dynamics(fit_rigid(others, model).arm(model))
        except IdentificationError:
            continue
        q, qd, qdd, moment = (unseen.robot[name] for name in _RIGID_SIGNALS)
        errors[k] = mean_absolute(moment, dynamics.inverse(q, qd, qdd))
    return errors


def _check(recordings: Sequence[Recording], signals: Sequence[str]) -> None:
    """Refuse logs that cannot carry a fit."""
    for recording in recordings:
        missing = [name for name in signals if name not in recording.robot]
        if missing:
            raise IdentificationError(
                f"{recording.source}: no {', '.join(missing)}; the fit needs {', '.join(signals)}"
            )
    moving = np.zeros(6)
    for recording in recordings:
        period = np.diff(recording.robot.time, prepend=recording.robot.time[0])
        moving += period @ (np.abs(recording.robot["target_qd"]) > _MOVING)
    short = [f"joint {j + 1} ({seconds:.1f} s)" for j, seconds in enumerate(moving) if seconds < _SHORTEST_MOTION]
    if short:
        raise IdentificationError(
            f"too little motion in {', '.join(recording.source for recording in recordings) or 'no logs'}: each joint "
            f"must move for {_SHORTEST_MOTION:.0f} s in all; too short: {', '.join(short)}"
        )
