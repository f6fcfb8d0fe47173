"""The simulated plant's drives from logs: ``arm.friction``'s law and the gears' ripple as a torque.

    k i = tau + (coulomb(+/-) + load |tau_l| + stribeck exp(-(qd / v_s)^2)) sgn(qd) + viscous w qd + ripple(q)
    ripple(q) = sum over orders n: amplitude cos(n q + phase)

over rows in which the joint moves; w is the controller's correction for the drive's temperature. Coulomb, load and
viscous friction are not negative; stribeck is not positive here: all of the lab's joints rub less as they slow down.
Friction comes first, with the ripple beside it; the ripple's own torque then from what friction leaves of slow rows,
where the servo follows it one to one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from ur5_twin.arm import files
from ur5_twin.arm.friction import FRICTIONLESS
from ur5_twin.arm.parameters import N_JOINTS
from ur5_twin.drives import terms
from ur5_twin.errors import IdentificationError

#: Target speed above which friction is sliding, rad/s, and below which the servo follows the ripple, rad/s: order 202
#: passes at 6 Hz then, below the servo's corner of some 10 Hz.
SLIDING, _SLOW = 0.01, 0.2
#: Speeds tried for the fading of friction, rad/s.
_SPEEDS = (0.01, 0.02, 0.03, 0.05, 0.08)
#: Bounds that no UR5 passes: Nm/A, and A/Nm of load-dependent friction, twice the controller's own.
_LARGEST_CONSTANT, _LARGEST_LOAD = 30.0, 0.03
#: Spread of the torque behind a gear that is too small to tell load-dependent friction, Nm.
_LEAST_LOAD = 0.8
#: Rows of a block of correlated errors, 1 s.
_BLOCK = 125
#: Delay and lag with which a current shows the ripple, s (docs/drive.md).
DELAY, LAG = 0.005, 0.002
#: Orders of the ripple, periods a revolution.
ORDERS = (202, 404)


@dataclass(frozen=True)
class PlantDrive:
    """Numbers of the law, each (6,), and of the ripple, each (n_orders, 6); ``errors`` holds their standard errors.

    Attributes:
        torque_constant: Nm/A.
        coulomb_positive, coulomb_negative: Nm of a sliding joint.
        stribeck: Nm, negative.
        stribeck_speed: rad/s.
        load: Nm/Nm.
        viscous: Nm s/rad at the law's mean temperature.
        order: periods a revolution.
        amplitude: Nm.
        phase: rad.
        errors: (6, 6) per joint in the current: of 1/k, coulomb + and -, load, stribeck and viscous; A/Nm, A, A, A/Nm,
            A, A s/rad; NaN where a bound holds.
        amplitude_errors: (n_orders, 6) Nm.
    """

    torque_constant: np.ndarray
    coulomb_positive: np.ndarray
    coulomb_negative: np.ndarray
    stribeck: np.ndarray
    stribeck_speed: np.ndarray
    load: np.ndarray
    viscous: np.ndarray
    order: np.ndarray
    amplitude: np.ndarray
    phase: np.ndarray
    errors: np.ndarray
    amplitude_errors: np.ndarray

    def current(self, of: terms.Ride) -> np.ndarray:
        """(n, 6) A that the law expects of a ride; without friction where the target rests."""
        friction = replace(
            FRICTIONLESS,
            coulomb_positive=self.coulomb_positive,
            coulomb_negative=self.coulomb_negative,
            stribeck=self.stribeck,
            stribeck_speed=self.stribeck_speed,
            load=self.load,
            viscous=self.viscous,
        )
        torque = of.torque + friction.sliding(of.qd, of.link, of.ratio)
        for j in range(N_JOINTS):
            weights = self.amplitude[:, j] * np.stack([np.cos(self.phase[:, j]), -np.sin(self.phase[:, j])])
            waves = terms.ripple_columns(of, j, tuple(self.order[:, j]), DELAY, LAG, directed=False)
            torque[:, j] += waves @ weights.T.ravel()
        return torque / self.torque_constant

    def table(self, source: str) -> dict[str, Any]:
        """The numbers in the layout of a table of ``models/ur5_joints.toml``.

        What free motion cannot tell (offset, presliding, warming) is carried over from the file that ships.
        """
        known = files.read_named("ur5_joints.toml", files.JointDrivesSpec)["plant"]
        numbers = {
            "torque_constant_nm_a": (self.torque_constant, 2),
            "offset_nm": (np.array(known.offset_nm), 3),
            "coulomb_positive_nm": (self.coulomb_positive, 3),
            "coulomb_negative_nm": (self.coulomb_negative, 3),
            "stribeck_nm": (self.stribeck, 3),
            "stribeck_speed_rad_s": (self.stribeck_speed, 3),
            "load_nm_nm": (self.load, 3),
            "viscous_nm_s_rad": (self.viscous, 3),
            "presliding_mrad": (np.array(known.presliding_mrad), 3),
        }
        ripple = [
            {
                "order": float(order[0]),
                "amplitude_nm": np.round(amplitude, 3).tolist(),
                "phase_rad": np.round(phase, 2).tolist(),
            }
            for order, amplitude, phase in zip(self.order, self.amplitude, self.phase, strict=True)
        ]
        return {
            "source": source,
            **{key: np.round(values, digits).tolist() for key, (values, digits) in numbers.items()},
            "cold_viscous_ratio": known.cold_viscous_ratio,
            "warming_time_s": known.warming_time_s,
            "ripple": ripple,
        }


def fit_plant(rides: Sequence[terms.Ride], orders: Sequence[int] = ORDERS) -> PlantDrive:
    """The plant's numbers from logs of free motion, or of motion with known contacts.

    Args:
        rides: ``drives.terms.ride`` of the logs.
        orders: of the ripple, periods a revolution.

    Raises:
        IdentificationError: a joint moves less than 1 s in all logs together.
    """
    found, errors = np.empty((N_JOINTS, 7)), np.full((6, N_JOINTS), np.nan)
    amplitude, phase, spread = (np.empty((len(orders), N_JOINTS)) for _ in range(3))
    for j in range(N_JOINTS):
        rows = [np.abs(of.qd[:, j]) > SLIDING for of in rides]
        if sum(int(r.sum()) for r in rows) < _BLOCK:
            raise IdentificationError(f"joint {j + 1} slides for less than 1 s; no friction can be told")
        torque, link, qd, ratio, current = (
            np.concatenate([getattr(of, name)[r, j] for of, r in zip(rides, rows, strict=True)])
            for name in ("torque", "link", "qd", "ratio", "current")
        )
        ripple = np.concatenate(
            [
                terms.ripple_columns(of, j, tuple(orders), DELAY, LAG, directed=False)[r]
                for of, r in zip(rides, rows, strict=True)
            ]
        )
        sign, n = np.sign(qd), ripple.shape[1]
        low = np.concatenate([[1.0 / _LARGEST_CONSTANT], np.zeros(3), [-np.inf, 0.0], np.full(n, -np.inf)])
        high = np.concatenate([np.full(3, np.inf), [_LARGEST_LOAD, 0.0, np.inf], np.full(n, np.inf)])
        if link.std() <= _LEAST_LOAD:
            high[3] = 1e-12
        best = None
        for speed in _SPEEDS:
            fading = np.exp(-((qd / speed) ** 2)) * sign
            law = np.stack([torque, sign > 0, -1.0 * (sign < 0), np.abs(link) * sign, fading, ratio * qd], axis=1)
            result = lsq_linear(np.concatenate([law, ripple], axis=1), current, bounds=(low, high))
            if best is None or result.cost < best[0].cost:
                best = (result, speed, law)
        assert best is not None
        result, speed, law = best
        x = result.x[:6]
        # Friction may not push: no more may fade than there is.
        stribeck = max(x[4], -min(x[1], x[2]))
        constant = 1.0 / x[0]
        scaled = constant * np.array([x[1], x[2], stribeck, speed / constant, x[3], x[5]])
        found[j] = [constant, *scaled]
        free = result.active_mask[:6] == 0
        columns = np.concatenate([law[:, free], ripple], axis=1)
        errors[free, j] = _spread(columns, current - np.concatenate([law, ripple], axis=1) @ result.x)[: free.sum()]
        slow = np.abs(qd) < _SLOW
        left, waves = (current - law @ x)[slow], ripple[slow]
        c = np.linalg.lstsq(waves, left, rcond=None)[0]
        s = _spread(waves, left - waves @ c)
        amplitude[:, j], phase[:, j] = constant * np.hypot(c[::2], c[1::2]), np.arctan2(-c[1::2], c[::2])
        spread[:, j] = constant * np.hypot(s[::2], s[1::2]) / np.sqrt(2.0)
    order = np.repeat(np.asarray(orders, dtype=float)[:, None], N_JOINTS, axis=1)
    k, positive, negative, stribeck, stribeck_speed, load, viscous = found.T
    return PlantDrive(
        k, positive, negative, stribeck, stribeck_speed, load, viscous, order, amplitude, phase, errors, spread
    )


def _spread(columns: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Standard errors of least squares whose errors are correlated within blocks of 1 s."""
    inverse = np.linalg.pinv(columns.T @ columns)
    blocks = np.add.reduceat(columns * error[:, None], np.arange(0, len(error), _BLOCK))
    return np.sqrt(np.diagonal(inverse @ (blocks.T @ blocks) @ inverse))
