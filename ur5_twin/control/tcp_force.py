"""The real controller's own wrench estimate: how actual_TCP_force follows from the currents.

Per joint, what the measured current says beyond the target's torque, by the law of ``control.target_current`` turned
round, once for a joint that drives its load and once for one that is back-driven::

    u_driving    = (i - v_d qd) / (1/k + load) - tau
    u_backdriven = (i - v_b qd) / (1/k - load) - tau

with i = actual_current, qd = actual_qd, tau = target_moment of the tick before, and v_d, v_b scaled as the friction in
target_current shows, which the controller corrects for the drive's temperature. Friction may hide the rest: where the
two disagree in sign the external torque counts as none, else the smaller one counts. Then, in this order, an
exponential average over 30 ticks and a truncated inverse::

    y <- y + 2/31 (u - y),    F = sum over singular values s >= 0.14 of J(actual_q)' = V S U':  U S^-1 V' y

so that near a singularity the force in the lost direction drops to none at once. On the lab's logs this is
actual_TCP_force to its printed digits wherever no row is missing (docs/servo.md).

Signs: u is the motors' torque beyond what the target needs, so F is the wrench that the ARM exerts on its surroundings,
at the flange's origin in base axes: the negative of the wrench on the arm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
from numpy.typing import ArrayLike

from ur5_twin.arm import files, kinematics
from ur5_twin.arm.parameters import N_JOINTS
from ur5_twin.control.target_current import TargetCurrentLaw, load_target_current_law
from ur5_twin.filters import first_order

#: The tick that the law was found at, s.
TICK = 0.008
#: Determinant of the Jacobian below which it is not inverted, m^3.
_SINGULAR = 1e-9
#: Target speed from which six decimals of target_current tell the drive's viscous friction, rad/s.
_TELLS_VISCOUS = 0.02
#: Torque above which they tell whether the joint drives its load, Nm.
_LOADED = 1e-3
#: The drives' temperature moves viscous friction by some 20 %; beyond this the reading is not friction.
_RATIOS = (0.5, 2.0)


class TcpForceSpec(files.Strict, frozen=True):
    """``models/tcp_force.toml``."""

    source: str
    window_ticks: files.Positive
    smallest_singular_value: files.Positive


@dataclass(frozen=True)
class TcpForceLaw:
    """Numbers of the estimate.

    Attributes:
        current: the drives' law that is turned round.
        weight: of a tick of 8 ms in the exponential average, 2 / (window + 1).
        smallest: singular value of J in m and rad below which a direction carries no wrench.
        source: where the numbers come from.
    """

    current: TargetCurrentLaw
    weight: float
    smallest: float
    source: str


def load_tcp_force_law(path: Path | None = None, current: TargetCurrentLaw | None = None) -> TcpForceLaw:
    """The law with the numbers of a TOML file, by default ``models/tcp_force.toml`` and ``models/target_current.toml``.

    Raises:
        ModelError: the file is wrong.
    """
    spec = files.read(path or files.model_path("tcp_force.toml"), TcpForceSpec)
    weight = 2.0 / (spec.window_ticks + 1.0)
    return TcpForceLaw(current or load_target_current_law(), weight, spec.smallest_singular_value, spec.source)


class TcpForce:
    """The estimate with its state, for rows one after the other, in pieces of any length.

    The controller's average before the first row is not known: it starts at zero and is forgotten with 0.12 s, or is
    what ``start`` takes from a first row of actual_TCP_force.

    Args:
        arm: the arm whose kinematics the Jacobian is of.
        law: by default what ``load_tcp_force_law`` returns.
        period: between rows, s; the average is over the same time whatever it is.
    """

    def __init__(self, arm: kinematics.Arm, law: TcpForceLaw | None = None, *, period: float = TICK) -> None:
        self._arm = arm
        self._law = law or load_tcp_force_law()
        # To the bit the law's own at its own tick.
        self._weight = self._law.weight if period == TICK else 1.0 - (1.0 - self._law.weight) ** (period / TICK)
        self._average = np.zeros(N_JOINTS)
        self._moment: np.ndarray | None = None
        self._ratio = np.ones(N_JOINTS)

    def start(self, actual_q: ArrayLike, wrench: ArrayLike) -> None:
        """Begin with the average J' F that belongs to a known row: actual_q (6,) rad and actual_TCP_force (6,)."""
        self._average = kinematics.jacobian(self._arm, actual_q).T @ np.asarray(wrench, dtype=float)

    def __call__(
        self,
        actual_q: ArrayLike,
        actual_qd: ArrayLike,
        actual_current: ArrayLike,
        target_qd: ArrayLike,
        target_moment: ArrayLike,
        target_current: ArrayLike,
    ) -> np.ndarray:
        """actual_TCP_force (n, 6) of the next n rows: wrench of the arm on its surroundings, flange, base axes, N, Nm.

        Args:
            actual_q, actual_qd, actual_current: (n, 6) rad, rad/s and A.
            target_qd, target_moment, target_current: (n, 6) rad/s, Nm and A.
        """
        rows = [np.asarray(x, dtype=float).reshape(-1, N_JOINTS) for x in (actual_q, actual_qd, actual_current)]
        targets = [np.asarray(x, dtype=float).reshape(-1, N_JOINTS) for x in (target_qd, target_moment, target_current)]
        (q, qd, current), moment = rows, targets[1]
        if not len(q):
            return np.empty((0, N_JOINTS))
        before = np.concatenate([moment[:1] if self._moment is None else self._moment[None], moment[:-1]])
        self._moment = moment[-1].copy()
        ratio = last_known(viscous_ratio(self._law.current, *targets), self._ratio)
        self._ratio = ratio[-1].copy()
        torque = external_torque(self._law.current, current, qd, before, ratio)
        decay = 1.0 - self._weight
        average, _ = first_order(self._weight, decay, torque, decay * self._average[None])
        self._average = average[-1].copy()
        return truncated_wrench(kinematics.jacobian(self._arm, q), average, self._law.smallest)


def viscous_ratio(
    law: TargetCurrentLaw, target_qd: np.ndarray, target_moment: np.ndarray, target_current: np.ndarray
) -> np.ndarray:
    """Viscous friction in target_current over the law's (n, 6); NaN where the target is too slow to tell.

    Args:
        law: the drives' law, of which torque constant, load and the ratio of the viscous branches are taken for true.
        target_qd, target_moment, target_current: (n, 6) rad/s, Nm and A.
    """
    rows = np.broadcast_arrays(target_qd, target_moment, target_current)
    ratio = np.empty(rows[0].shape)
    _viscous_ratios(
        np.ascontiguousarray(rows[0], dtype=float),
        np.ascontiguousarray(rows[1], dtype=float),
        np.ascontiguousarray(rows[2], dtype=float),
        law.torque_constant,
        law.load,
        law.viscous_driving,
        law.viscous_backdriven,
        ratio,
    )
    return ratio


@numba.njit(cache=True, nogil=True, error_model="numpy")
def viscous_ratio_of(qd, moment, current, constant, load, viscous_driving, viscous_backdriven):  # pragma: no cover
    """``viscous_ratio`` for one joint at one sample."""
    if not (abs(qd) > _TELLS_VISCOUS and abs(moment) > _LOADED):
        return math.nan
    sign = 1.0 if qd > 0.0 else -1.0
    viscous = (viscous_driving if moment * sign > 0.0 else viscous_backdriven) * qd
    if viscous == 0.0:
        return math.nan
    ratio = (current - moment / constant - load * abs(moment) * sign) / viscous
    return ratio if _RATIOS[0] < ratio < _RATIOS[1] else math.nan


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _viscous_ratios(qd, moment, current, constant, load, driving, backdriven, out):  # pragma: no cover - compiled
    for k in range(qd.shape[0]):
        for j in range(qd.shape[1]):
            out[k, j] = viscous_ratio_of(
                qd[k, j], moment[k, j], current[k, j], constant[j], load[j], driving[j], backdriven[j]
            )


def external_torque(
    law: TargetCurrentLaw, current: np.ndarray, qd: np.ndarray, moment: np.ndarray, ratio: np.ndarray | float = 1.0
) -> np.ndarray:
    """u (n, 6), Nm: the motors' torque beyond ``moment`` that friction cannot explain, as the module says.

    Args:
        law: the drives' law.
        current, qd, moment: (n, 6) A, rad/s and Nm.
        ratio: viscous friction over the law's, a number or (n, 6).
    """
    driving = (current - law.viscous_driving * ratio * qd) / (1.0 / law.torque_constant + law.load) - moment
    backdriven = (current - law.viscous_backdriven * ratio * qd) / (1.0 / law.torque_constant - law.load) - moment
    smaller = np.where(np.abs(driving) < np.abs(backdriven), driving, backdriven)
    return np.where(driving * backdriven < 0.0, 0.0, smaller)


def truncated_wrench(J: np.ndarray, torque: np.ndarray, smallest: float) -> np.ndarray:
    """F (n, 6) with J' F = torque, without the directions whose singular value of J (n, 6, 6) is below ``smallest``."""
    # 1 / |J^-1| in Frobenius' norm is a lower bound of the smallest singular value that costs a third of finding it.
    singular = np.abs(np.linalg.det(J)) < _SINGULAR
    inverse = np.linalg.inv(np.where(singular[:, None, None], np.eye(J.shape[-1]), J) if singular.any() else J)
    regular = ~singular & (1.0 / np.sqrt(np.einsum("nij,nij->n", inverse, inverse)) >= smallest)
    if regular.all():
        return np.einsum("nji,nj->ni", inverse, torque)
    wrench = np.empty_like(torque)
    wrench[regular] = np.einsum("nji,nj->ni", inverse[regular], torque[regular])
    U, s, Vt = np.linalg.svd(J[~regular])
    along = np.einsum("nij,nj->ni", Vt, torque[~regular])
    kept = s >= smallest
    wrench[~regular] = np.einsum("nij,nj->ni", U, np.where(kept, along, 0.0) / np.where(kept, s, 1.0))
    return wrench


def last_known(values: np.ndarray, first: np.ndarray) -> np.ndarray:
    """The last number so far in each column of ``values`` (n, width), ``first`` (width,) where there is none yet."""
    if len(values) == 1:
        return np.where(np.isnan(values), first, values)
    rows = np.arange(len(values))[:, None]
    last = np.maximum.accumulate(np.where(np.isnan(values), -1, rows), axis=0)
    return np.where(last < 0, first, np.take_along_axis(values, np.maximum(last, 0), axis=0))
