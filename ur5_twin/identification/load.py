"""What hangs on the flange: its ten numbers, how well they are told, and the torque that they take."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import N_JOINTS, ArmModel
from ur5_twin.identification import body, spread
from ur5_twin.identification.body import Body
from ur5_twin.sensing.kinetics import FlangeMotion
from ur5_twin.sensing.signals import Signals

#: Moments about the flange's origin that no payload of a UR5 exceeds, kg m^2: what is not excited stays finite.
LARGEST_INERTIA = 0.5
#: How far the mass of a link may be off, one standard deviation, share.
LINK_MASS_OFF = 0.05
#: A mass that is none, kg.
_NOTHING = 1e-3


@dataclass(frozen=True)
class Load:
    """A body at the flange with what is known of it.

    Attributes:
        phi: (10,) or (4,) the fit without constraint (``identification.body``); (4,) where inertia is not told.
        covariance: of that.
        body: what ``likeliest`` makes of it; None if there is nothing.
    """

    phi: np.ndarray
    covariance: np.ndarray
    body: Body | None

    @property
    def mass(self) -> tuple[float, float]:
        """kg, and one standard deviation."""
        return float(self.phi[0]), float(np.sqrt(self.covariance[0, 0]))

    @property
    def found(self) -> bool:
        """Whether the mass is told from none at 95 %."""
        mass, std = self.mass
        return mass > max(spread.NINETY_FIVE * std, _NOTHING)

    @property
    def center(self) -> tuple[np.ndarray, np.ndarray]:
        """m (3,), and one standard deviation (3,), to first order."""
        center = self.phi[1:4] / self.phi[0]
        slope = np.concatenate([-center[:, None], np.eye(3)], axis=1) / self.phi[0]
        return center, np.sqrt(np.diag(slope @ self.covariance[:4, :4] @ slope.T))

    @property
    def inertia(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Tensor about the mass centre (6,): xx, yy, zz, xy, xz, yz in kg m^2, and one standard deviation; None if not
        told."""
        if len(self.phi) < 10:
            return None

        def about_center(phi: np.ndarray) -> np.ndarray:
            return body.six(body.of_phi(phi).inertia)

        step = 1e-6
        slope = np.stack(
            [(about_center(self.phi + step * e) - about_center(self.phi - step * e)) / (2 * step) for e in np.eye(10)],
            axis=1,
        )
        return about_center(self.phi), np.sqrt(np.diag(slope @ self.covariance @ slope.T))


def likeliest(phi: np.ndarray, covariance: np.ndarray) -> Body | None:
    """The body that a body can be, nearest to a fit (``Load.phi``); a ball where inertia is not told, None without
    mass."""
    if phi[0] <= 0.0:
        return None
    if len(phi) == 10:
        return body.nearest_body(phi, covariance)
    return body.ball(float(phi[0]), phi[1:4] / phi[0])


def mass_columns(model: ArmModel, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """(n, 6, 5) torque by shares of the masses of links 2 to 6 in a motion (n, 6); what joint 1 turns tells no mass."""
    bare = Dynamics(model).inverse(q, qd, qdd)
    columns = np.empty((*q.shape, N_JOINTS - 1))
    for k in range(1, N_JOINTS):
        links = list(model.links)
        links[k] = replace(links[k], mass=2.0 * links[k].mass, inertia=2.0 * links[k].inertia)
        # Linear in the mass, so that twice of it tells the slope.
        columns[:, :, k - 1] = Dynamics(replace(model, links=tuple(links))).inverse(q, qd, qdd) - bare
    return columns


def load_columns(model: ArmModel, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """(n, 6, 10) torque of a load at the flange by its ten numbers, in a motion (n, 6) of the joints."""
    none = np.zeros_like(q)
    motion = FlangeMotion.of(model, Signals(np.arange(len(q), dtype=float), q, qd, qdd, none, none))
    return body.torque_columns(model, q, motion)
