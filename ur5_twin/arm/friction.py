"""Friction of the joints: what the gears take from the motors before the links see it.

Per joint, with v the joint's speed and tau_l the torque that reaches the link::

    level = coulomb(+/-) + load |tau_l| + stribeck exp(-(v / stribeck_speed)^2)
    tau_f = stiffness z + damping v (1 - |z| stiffness / level) + viscous v,    |z| <= level / stiffness

z is the deflection of a spring that is dragged along: it follows the joint, dz = dq, until its force reaches the level,
and slips at the level from there on (a Maxwell-slip element, the elasto-plastic limit of Dahl's and LuGre's models).
Below the level the joint sticks: it comes back when the push ends and does not creep however long the push lasts, as
LuGre's does. Sliding, the law is Coulomb, load-dependent, Stribeck and viscous friction. ``coulomb`` differs with the
direction, ``viscous`` falls as the drive warms (``Friction.viscous_scale``).

Sources of the terms: thesis equations 3.12 to 3.14 (Coulomb, viscous); de Wit et al. 1995 (Stribeck, presliding);
load-dependent friction of harmonic drives as the controller's own law has it (``control.target_current``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numba
import numpy as np

from ur5_twin.errors import ModelError


@dataclass(frozen=True)
class Friction:
    """Coefficients of the law above, each (6,) unless said otherwise.

    Attributes:
        coulomb_positive, coulomb_negative: Nm, while the joint moves or is pushed in that direction.
        stribeck: Nm by which breaking loose needs more than sliding; negative where friction fades at creeping speed.
        stribeck_speed: rad/s.
        load: Nm per Nm of torque that reaches the link.
        viscous: Nm s/rad of the warm drive.
        presliding: rad that a joint yields before it slips, at ``coulomb`` (the mean of both directions).
        cold: viscous friction of the cold drive over the warm one's, a number.
        warming_time: time constant with which the drive warms, s, a number.
        source: where the numbers come from.
    """

    coulomb_positive: np.ndarray
    coulomb_negative: np.ndarray
    stribeck: np.ndarray
    stribeck_speed: np.ndarray
    load: np.ndarray
    viscous: np.ndarray
    presliding: np.ndarray
    cold: float
    warming_time: float
    source: str

    def viscous_scale(self, time: np.ndarray, warm_for: float) -> np.ndarray:
        """Viscous friction over its warm value at times in s, ``warm_for`` seconds of motion before time 0.

        1 + (cold - 1) exp(-(warm_for + t) / warming_time); 1 for a drive that has been warm for ever (infinity).
        """
        return 1.0 + (self.cold - 1.0) * np.exp(-(warm_for + np.asarray(time)) / self.warming_time)

    def scaled(self, factor: np.ndarray) -> Friction:
        """The same joints with every friction torque times ``factor`` (6,), which stick as far as before."""
        return replace(
            self,
            coulomb_positive=self.coulomb_positive * factor,
            coulomb_negative=self.coulomb_negative * factor,
            stribeck=self.stribeck * factor,
            load=self.load * factor,
            viscous=self.viscous * factor,
        )

    def sliding(self, qd: np.ndarray, link_torque: np.ndarray, viscous_scale: float | np.ndarray = 1.0) -> np.ndarray:
        """Friction torque (..., 6) in Nm of joints that slide at ``qd`` (..., 6) rad/s; 0 where qd is 0."""
        coulomb = np.where(qd > 0, self.coulomb_positive, self.coulomb_negative)
        level = coulomb + self.load * np.abs(link_torque) + self.stribeck * np.exp(-((qd / self.stribeck_speed) ** 2))
        return level * np.sign(qd) + self.viscous * viscous_scale * qd


#: Square of the slip over its Stribeck speed beyond which that term is below rounding.
_FADED = 36.0
#: Damping of the presliding spring over sqrt(stiffness * rotor inertia): twice the damping ratio.
_DAMPING = 0.4

#: No friction at all.
FRICTIONLESS = Friction(
    coulomb_positive=np.zeros(6),
    coulomb_negative=np.zeros(6),
    stribeck=np.zeros(6),
    stribeck_speed=np.ones(6),
    load=np.zeros(6),
    viscous=np.zeros(6),
    presliding=np.ones(6),
    cold=1.0,
    warming_time=1.0,
    source="none",
)


class PackedFriction(NamedTuple):
    """The law's numbers for compiled code, each (6,)."""

    positive: np.ndarray
    negative: np.ndarray
    stribeck: np.ndarray
    stribeck_speed: np.ndarray
    load: np.ndarray
    viscous: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray


def pack(friction: Friction, rotor_inertia: np.ndarray) -> PackedFriction:
    """The numbers of the law for ``friction_torque``.

    The spring's own damping is a fifth of what would keep the rotor (6,) kg m^2 on it from swinging.

    Raises:
        ModelError: a joint yields by nothing before it slips.
    """
    if not (friction.presliding > 0).all():
        raise ModelError("friction: presliding must be positive for every joint (rad before it slips)")
    stiffness = 0.5 * (friction.coulomb_positive + friction.coulomb_negative) / friction.presliding
    return PackedFriction(
        friction.coulomb_positive,
        friction.coulomb_negative,
        friction.stribeck,
        friction.stribeck_speed,
        friction.load,
        friction.viscous,
        stiffness,
        _DAMPING * np.sqrt(stiffness * rotor_inertia),
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def friction_torque(p, j, z, dq, qd, link_torque, viscous_scale):  # pragma: no cover - compiled
    """Friction torque of joint j and its spring's new deflection.

    Args:
        p: ``PackedFriction``.
        z: deflection so far, rad.
        dq: how far the joint has moved since, rad.
        qd: its speed, rad/s.
        link_torque: torque that reaches the link, Nm.
        viscous_scale: of the drive's temperature.
    """
    viscous = p.viscous[j] * viscous_scale * qd
    stiffness = p.stiffness[j]
    if stiffness <= 0.0:
        return viscous, 0.0
    z += dq
    level = p.load[j] * abs(link_torque) + (p.positive[j] if z > 0.0 else p.negative[j])
    slip = qd / p.stribeck_speed[j]
    if slip * slip < _FADED:
        level += p.stribeck[j] * math.exp(-slip * slip)
    most = level / stiffness
    if z > most:
        z = most
    elif z < -most:
        z = -most
    stuck = 1.0 - abs(z) / most if most > 0.0 else 0.0
    return stiffness * z + p.damping[j] * stuck * qd + viscous, z
