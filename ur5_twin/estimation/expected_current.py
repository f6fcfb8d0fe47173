"""The current that free motion needs, sample by sample, and what a torque on the joint does to it.

``drives.current_map`` without the servo, streaming: the same sums as ``CurrentMap.current`` over a whole log.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit

from ur5_twin.arm import dynamics
from ur5_twin.arm._dynamics_kernels import rnea_into
from ur5_twin.control.held import BRAKING
from ur5_twin.control.tcp_force import viscous_ratio_of
from ur5_twin.drives.terms import MOVING, RISE_SPEEDS
from ur5_twin.errors import EstimationError
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.protocol import Sample

_N_FRICTION = 5 + len(RISE_SPEEDS)
_RISE_SPEEDS = np.array(RISE_SPEEDS)
#: Torque behind the gear below which a push may turn its sign, and with it what load-dependent friction does, Nm.
_TURNS = 5.0


class ExpectedCurrent:
    """The map with its memory.

    Args:
        nominal: whose current map and arm it takes.

    Attributes:
        current: (6,) A that the last sample's motion needs without contact.
        friction: (6,) A of it that are friction's.
        torque: (6,) Nm of the motion and weight in it.
        slope: (6,) A by which a torque of 1 Nm against the motor changes it; load-dependent friction included.
        moving: (6,) whether the target moves.

    Raises:
        EstimationError: the map follows the measured position error, which contains every push.
    """

    def __init__(self, nominal: NominalModel) -> None:
        of = nominal.current_map
        if any(shape.servo or shape.sticking for shape in of.shapes):
            raise EstimationError(
                f"drive {of.name} follows servo or measured position, whose answer to a push it would take off; use lab"
            )
        n = max((len(shape.orders) for shape in of.shapes), default=0)
        orders, waves = np.zeros((6, n)), np.zeros((6, n, 4))
        friction = np.empty((6, _N_FRICTION))
        for j, (shape, found) in enumerate(zip(of.shapes, of.coefficients, strict=True)):
            friction[j] = found[:_N_FRICTION]
            orders[j, : len(shape.orders)] = shape.orders
            kinds = 4 if shape.directed else 2
            waves[j, : len(shape.orders), :kinds] = found[_N_FRICTION:].reshape(-1, kinds)
        times = np.array([(shape.moving, shape.forgetting, shape.delay, shape.lag) for shape in of.shapes])
        self._map = _Map(of.torque_constant, friction, orders, waves, times)
        law = nominal.law
        self._law = (law.torque_constant, law.load, law.viscous_driving, law.viscous_backdriven)
        self._arm = nominal.packed
        self._links = dynamics.pack(replace(nominal.arm, rotor_inertia=np.zeros(6)))
        self._slow = np.zeros((6, _N_FRICTION))
        self._held, self._ratio = np.zeros(6), np.ones(6)
        self.current, self.friction, self.torque = np.zeros(6), np.zeros(6), np.zeros(6)
        self.slope, self.moving = np.zeros(6), np.zeros(6, dtype=bool)

    def update(self, sample: Sample, dt: float) -> None:
        """Take in a sample without NaN (but for the IMU's), dt s after the last; 0 for the first."""
        if dt == 0.0:
            self._held[:] = sample.target_q
        _expect(
            self._map,
            self._law,
            self._arm,
            self._links,
            dt,
            sample.target_q,
            sample.target_qd,
            sample.target_qdd,
            sample.target_current,
            sample.target_moment,
            sample.actual_q,
            self._held,
            self._ratio,
            self._slow,
            (self.current, self.friction, self.torque, self.slope, self.moving),
        )


class _Map(NamedTuple):
    constant: np.ndarray
    friction: np.ndarray
    orders: np.ndarray
    waves: np.ndarray
    times: np.ndarray


@njit(cache=True, nogil=True, error_model="numpy")
def _expect(
    of, law, arm, links, dt, target_q, qd, qdd, target_current, target_moment, angle, held, ratio, slow, out
):  # pragma: no cover - compiled  # fmt: skip
    current, dry, needed, slope, moving = out
    idle = True
    for j in range(6):
        if qd[j] != 0.0 or qdd[j] != 0.0:
            idle = False
    posture = np.empty(6)
    for j in range(6):
        posture[j] = held[j] if idle else target_q[j]
        if not idle:
            # Where this row's deceleration brings the joint to rest: the servo holds that if the target rests next.
            held[j] = target_q[j]
            if qd[j] * qdd[j] < 0.0 and abs(qdd[j]) > BRAKING:
                held[j] += qd[j] * abs(qd[j]) / (2.0 * abs(qdd[j]))
    torque, link = np.empty(6), np.empty(6)
    rnea_into(arm, posture, qd, qdd, torque)
    rnea_into(links, posture, qd, qdd, link)
    x = np.empty(_N_FRICTION)
    for j in range(6):
        v = qd[j]
        moving[j] = abs(v) > MOVING
        sign = 0.0
        if moving[j]:
            sign = 1.0 if v > 0.0 else -1.0
        told = viscous_ratio_of(v, target_moment[j], target_current[j], law[0][j], law[1][j], law[2][j], law[3][j])
        if not math.isnan(told):
            ratio[j] = told
        x[0], x[1], x[2], x[3], x[4] = torque[j], sign, abs(sign), abs(link[j]) * sign, ratio[j] * v
        for r in range(_RISE_SPEEDS.shape[0]):
            x[5 + r] = sign * math.exp(-abs(v) / _RISE_SPEEDS[r])
        leak = min(dt / of.times[j, 0 if moving[j] else 1], 1.0) if dt > 0.0 else 1.0
        dry[j] = 0.0
        for c in range(_N_FRICTION):
            slow[j, c] += leak * (x[c] - slow[j, c])
            if c > 0:
                dry[j] += of.friction[j, c] * slow[j, c]
        needed[j] = slow[j, 0]
        current[j] = (1.0 / of.constant[j] + of.friction[j, 0]) * slow[j, 0] + dry[j]
        for r in range(of.orders.shape[1]):
            order = of.orders[j, r]
            phase = order * (angle[j] - of.times[j, 2] * v)
            lag = order * v * of.times[j, 3]
            cosine = (math.cos(phase) + lag * math.sin(phase)) / (1.0 + lag * lag)
            sine = (math.sin(phase) - lag * math.cos(phase)) / (1.0 + lag * lag)
            w = of.waves[j, r]
            current[j] += cosine * (w[0] + sign * w[2]) + sine * (w[1] + sign * w[3])
        load = sign * (1.0 if link[j] > 0.0 else -1.0) * min(abs(link[j]) / _TURNS, 1.0)
        slope[j] = 1.0 / of.constant[j] + of.friction[j, 0] + of.friction[j, 3] * load
