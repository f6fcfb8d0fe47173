"""The real servo's gains from pushes at standstill, and what such a servo does in a simulation of finite steps.

At standstill a UR writes the position of the row before into target_q, so that target_q - actual_q shows nothing. The
servo itself still holds the position where it stopped: its current answers the way that actual_q has moved since::

    k (i - i_target) = -(Kp e + Kd qd + Ki int(e) dt),    e = actual_q - q_held

per joint, in the controller's own Nm (k of ``control.target_current``). Differences over a window of rows take the
unknown start of the integral out of it, and a constant column finds q_held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ur5_twin import spatial
from ur5_twin.arm import kinematics
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import N_JOINTS, ArmModel
from ur5_twin.errors import IdentificationError
from ur5_twin.identification.jackknife import half_widths
from ur5_twin.recording.table import Recording

_SIGNALS = ("actual_q", "actual_qd", "actual_current", "target_current", "target_qd")
#: Rows of a window, 0.2 s: longer than a slip (0.05 s), shorter than the way between two pushes (1 s).
_WINDOW = 25
#: A joint that moves or is loaded by less tells nothing: some ten steps of its encoder (9.6 urad), rad, and the noise
#: of the current, Nm.
_LEAST_MOTION, _LEAST_TORQUE = 1e-4, 0.3
#: A fit that explains less is not of a PID servo: integrals that were reset, or stuck joints.
_GOOD = 0.9
#: Length of the jackknife's blocks, s: longer than a window and a push.
_BLOCK = 2.0
#: Time before which nobody has touched the sensor yet, s.
_TARE = 0.3


@dataclass(frozen=True)
class ServoFit:
    """Gains per log and joint; NaN where the log does not tell.

    Attributes:
        kp, kd, ki: (n_logs, 6) Nm/rad, Nm s/rad, Nm/(rad s) in the controller's own Nm.
        explained: (n_logs, 6) share of the current's variance over 0.2 s that the fit explains.
        held: (n_logs, 6) q_held less the log's first actual_q, rad.
        mass: (n_logs, 6) diagonal of the controller's mass matrix at that posture, kg m^2.
        half: (3, n_logs, 6) half-widths of the 95 % intervals of kp, kd and ki, by a jackknife over seconds.
    """

    kp: np.ndarray
    kd: np.ndarray
    ki: np.ndarray
    explained: np.ndarray
    held: np.ndarray
    mass: np.ndarray
    half: np.ndarray

    @property
    def good(self) -> np.ndarray:
        """(n_logs, 6) whether a log says how this joint's servo works."""
        return (self.explained > _GOOD) & (self.kp > 0) & (self.kd > 0) & (self.ki > 0)

    def means(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Kp, Kd, Ki (6,) over the good logs; NaN for a joint with none."""
        return _mean(self.kp, self.good), _mean(self.kd, self.good), _mean(self.ki, self.good)

    def kappas(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """kappa0, kappa1, kappa_i (6,): the good logs' means of Kp / M, Kd / M and Ki / M; 1/s^2, 1/s, 1/s^3."""
        good = self.good
        return _mean(self.kp / self.mass, good), _mean(self.kd / self.mass, good), _mean(self.ki / self.mass, good)

    def kappa_half_widths(self) -> np.ndarray:
        """(3, 6) of the 95 % intervals of kappa0, kappa1 and kappa_i; at least half of what the good logs differ by."""
        good = np.broadcast_to(self.good, self.half.shape)
        count = np.maximum(good.sum(axis=1), 1)
        within = np.sqrt(np.where(good, (self.half / self.mass) ** 2, 0.0).sum(axis=1)) / count
        values = np.stack([self.kp, self.kd, self.ki]) / self.mass
        most, least = np.where(good, values, -np.inf).max(axis=1), np.where(good, values, np.inf).min(axis=1)
        return np.where(good.any(axis=1), np.maximum(within, 0.5 * (most - least)), np.nan)


def fit_servo(recordings: Sequence[Recording], controller: ArmModel, torque_constant: np.ndarray) -> ServoFit:
    """The servo's gains from logs of pushes at standstill.

    Args:
        recordings: logs whose target never moves.
        controller: the model the controller linearises with.
        torque_constant: (6,) the controller's own, Nm/A.

    Raises:
        IdentificationError: a signal is missing, a log is shorter than 1 s, its target moves, or no joint is pushed.
    """
    shape = (len(recordings), N_JOINTS)
    kp, kd, ki, held = (np.full(shape, np.nan) for _ in range(4))
    explained, mass, half = np.zeros(shape), np.empty(shape), np.full((3, *shape), np.nan)
    dynamics = Dynamics(controller)
    for n, recording in enumerate(recordings):
        robot = recording.robot
        _check(recording)
        period = float(np.median(np.diff(robot.time)))
        way = robot["actual_q"] - robot["actual_q"][0]
        torque = torque_constant * (robot["actual_current"] - robot["target_current"])
        mass[n] = np.diag(dynamics.mass_matrix(robot["actual_q"][0]))
        for j in range(N_JOINTS):
            signals = (way[:, j], np.cumsum(way[:, j]) * period, robot["actual_qd"][:, j])
            columns = np.stack([_over_window(x) for x in signals] + [np.full(len(way) - _WINDOW, 1.0)], axis=1)
            answer = _over_window(torque[:, j])
            if np.ptp(way[:, j]) < _LEAST_MOTION or answer.std() < _LEAST_TORQUE:
                continue
            solution = np.linalg.lstsq(columns, answer, rcond=None)[0]
            kp[n, j], ki[n, j], kd[n, j] = -solution[:3]
            block = (robot.time[_WINDOW:] - robot.time[0]) // _BLOCK
            half[[0, 2, 1], n, j] = half_widths(columns, answer - columns @ solution, block)[:3]
            held[n, j] = -solution[3] / (_WINDOW * period) / solution[1]
            explained[n, j] = 1.0 - (answer - columns @ solution).var() / answer.var()
    fit = ServoFit(kp, kd, ki, explained, held, mass, half)
    if not fit.good.any():
        raise IdentificationError(
            f"{', '.join(r.source for r in recordings)}: no joint is pushed so that its servo shows; push for a second "
            "or longer with 30 N or more, at standstill"
        )
    return fit


def external_torque(recording: Recording, arm: ArmModel, p_FS: np.ndarray, delay: float = 0.0) -> np.ndarray:
    """tau_ext = J' F (n, 6), Nm, from the force sensor's tared reading on the robot's clock; 0 where it is silent.

    The lab's readings are, as they are, the wrench that acts ON the arm (docs/servo.md); positive accelerates a joint.

    Args:
        recording: with ``ft_wrench``, sensor axes parallel to the flange's.
        arm: the arm whose kinematics are used.
        p_FS: (3,) the sensor's origin in the flange frame, m.
        delay: by which the sensor's samples come late, s.

    Raises:
        IdentificationError: no force sensor, or none of its rows in the first 0.3 s of the robot's clock.
    """
    table = recording.aligned()
    if "ft_wrench" not in table:
        raise IdentificationError(f"{recording.source}: no ft_wrench; record the force sensor")
    reading = table["ft_wrench"]
    there = ~np.isnan(reading).any(axis=1)
    early = there & (table.time - table.time[0] < _TARE)
    if not early.any():
        raise IdentificationError(f"{recording.source}: the force sensor is silent in the first {_TARE} s, its tare")
    tared = reading[there] - reading[early].mean(axis=0)
    at = table.time + delay
    wrench = np.stack([np.interp(at, table.time[there], column, left=0.0, right=0.0) for column in tared.T], axis=1)
    R_BF = kinematics.forward(arm, table["actual_q"])[:, :3, :3]
    at_flange = spatial.rotate_wrench(R_BF, spatial.shift_wrench(wrench, -np.asarray(p_FS)))
    return np.einsum("nij,ni->nj", kinematics.jacobian(arm, table["actual_q"]), at_flange)


def spectral_radius(
    kappa0: np.ndarray, kappa1: np.ndarray, kappai: np.ndarray, step: float, gain: float = 1.0
) -> np.ndarray:
    """Largest modulus (n,) of the eigenvalues of q'' = -gain (kappa0 q + kappa1 q' + kappa_i int q) in steps.

    One step is v += step a, q += step v, I += step q: MuJoCo's semi-implicit Euler. Below 1 the loop is stable.

    Args:
        kappa0, kappa1, kappai: (n,) 1/s^2, 1/s, 1/s^3.
        step: s.
        gain: torque of the plant's motors over what the controller believes, times its mass over the plant's.
    """
    radius = []
    for k0, k1, ki in zip(kappa0, kappa1, kappai, strict=True):
        v = np.array([-gain * step * k0, 1.0 - gain * step * k1, -gain * step * ki])  # next v of (q, v, I)
        q = np.array([1.0, 0.0, 0.0]) + step * v
        i = np.array([0.0, 0.0, 1.0]) + step * q
        radius.append(np.abs(np.linalg.eigvals(np.stack([q, v, i]))).max())
    return np.array(radius)


def holds_last_position(recording: Recording) -> float:
    """Share of the rows without target motion whose target_q is actual_q of the row before, to the log's digits."""
    robot = recording.robot
    still = np.all(robot["target_qd"][1:] == 0.0, axis=1)
    same = np.all(np.abs(robot["target_q"][1:] - robot["actual_q"][:-1]) < 1.5e-6, axis=1)
    return float(same[still].mean()) if still.any() else float("nan")


def _over_window(x: np.ndarray) -> np.ndarray:
    return x[_WINDOW:] - x[:-_WINDOW]


def _mean(values: np.ndarray, good: np.ndarray) -> np.ndarray:
    count = good.sum(axis=0)
    total = np.where(good, values, 0.0).sum(axis=0)
    return np.divide(total, count, out=np.full(N_JOINTS, np.nan), where=count > 0)


def _check(recording: Recording) -> None:
    robot = recording.robot
    missing = [name for name in _SIGNALS if name not in robot]
    if missing:
        raise IdentificationError(f"{recording.source}: no {', '.join(missing)}; the fit needs {', '.join(_SIGNALS)}")
    if len(robot) < 5 * _WINDOW:
        raise IdentificationError(f"{recording.source}: {len(robot)} rows, too few; record 1 s or longer")
    if np.any(robot["target_qd"]):
        raise IdentificationError(f"{recording.source}: the target moves; the fit needs a log of pushes at standstill")
