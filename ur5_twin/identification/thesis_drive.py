"""The thesis' two-step method for the map from current to torque (equations 6.1 to 6.6), the baseline.

First friction (6.1): the torque of the model plus Coulomb and viscous friction is to be proportional to the current,

    tau_mu + nu_c s(qd) + nu_v qd = k~ i,

with s = sgn outside a dead zone (6.4). The thesis prints a sum of the differences themselves, which has no minimum, and
sets the numbers by hand; their squares are least where k~ and friction are nearly zero, so that here they are divided
by k~ first: least squares in the current, with no friction below zero. Then a straight line through torque with that
friction over current (6.5):

    tau_mu + tau_fr = k i + b.

The line is a regression on a noisy current: k comes out too small, the smaller the less a joint's current varies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from ur5_twin.arm.drive import LinearDrive
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import N_JOINTS, ArmModel
from ur5_twin.errors import IdentificationError
from ur5_twin.recording.table import Recording

#: Equation 6.4's dead zone, rad/s.
DEAD_ZONE = 0.02
_NEEDED = ("target_q", "target_qd", "target_qdd", "actual_current")
#: Rows outside the dead zone below which no friction can be told, 1 s.
_ENOUGH = 125
#: No UR5 has a larger torque constant, Nm/A.
_LARGEST_CONSTANT = 30.0


@dataclass(frozen=True)
class TwoStep:
    """What the method finds.

    Attributes:
        drive: equation 6.6 with its friction.
        preliminary: k~ of the first step, (6,) Nm/A.
        explained: share of the torque's variance that the line explains, (6,): of the model's torque alone (figure 6.1)
            and with friction (figure 6.2).
    """

    drive: LinearDrive
    preliminary: np.ndarray
    explained: tuple[np.ndarray, np.ndarray]


def fit_two_step(recordings: Sequence[Recording], links: ArmModel) -> TwoStep:
    """The method on logs of free motion.

    Args:
        recordings: logs with targets and actual_current.
        links: the thesis' model C, with what hangs on the flange.

    Raises:
        IdentificationError: a signal is missing or a joint moves for less than 1 s.
    """
    torque = np.concatenate([model_torque(recording, links) for recording in recordings])
    qd, current = (np.concatenate([r.robot[name] for r in recordings]) for name in ("target_qd", "actual_current"))
    direction = np.where(np.abs(qd) > DEAD_ZONE, np.sign(qd), 0.0)
    found = np.empty((N_JOINTS, 5))
    explained = np.empty((2, N_JOINTS))
    for j in range(N_JOINTS):
        if np.abs(direction[:, j]).sum() < _ENOUGH:
            names = ", ".join(recording.source for recording in recordings) or "no logs"
            raise IdentificationError(f"joint {j + 1} moves for less than 1 s in {names}")
        columns = np.stack([torque[:, j], direction[:, j], qd[:, j]], axis=1)
        scaled = lsq_linear(columns, current[:, j], bounds=([1.0 / _LARGEST_CONSTANT, 0.0, 0.0], np.inf)).x
        k_first, coulomb, viscous = 1.0 / scaled[0], *(scaled[1:] / scaled[0])
        rubbing = torque[:, j] + coulomb * direction[:, j] + viscous * qd[:, j]
        constant, offset = np.polyfit(current[:, j], rubbing, 1)
        if not constant > 0:
            raise IdentificationError(f"joint {j + 1}: the line of equation 6.5 falls; torque and current disagree")
        found[j] = k_first, coulomb, viscous, constant, offset
        for row, values in enumerate((torque[:, j], rubbing)):
            explained[row, j] = np.corrcoef(current[:, j], values)[0, 1] ** 2
    k_first, coulomb, viscous, constant, offset = found.T
    names = ", ".join(recording.source for recording in recordings)
    source = f"thesis method (6.1) to (6.6) on {names}"
    drive = LinearDrive("two_step", source, constant, offset, coulomb, viscous, DEAD_ZONE)
    return TwoStep(drive, k_first, (explained[0], explained[1]))


def model_torque(recording: Recording, links: ArmModel) -> np.ndarray:
    """tau_mu (n, 6): what the target motion needs by the model, Nm.

    Raises:
        IdentificationError: a signal is missing.
    """
    robot = recording.robot
    missing = [name for name in _NEEDED if name not in robot]
    if missing:
        raise IdentificationError(f"{recording.source}: no {', '.join(missing)}; a drive needs {', '.join(_NEEDED)}")
    return Dynamics(links).inverse(*(robot[name] for name in _NEEDED[:3]))


def current(drive: LinearDrive, recording: Recording, links: ArmModel) -> np.ndarray:
    """actual_current (n, 6) in A that a linear map expects for the target motion."""
    return drive.current(model_torque(recording, links), recording.robot["target_qd"])


def table(drive: LinearDrive) -> dict[str, object]:
    """A linear map in the layout of a table of ``models/drives.toml``."""
    return {
        "source": drive.source,
        "torque_constant_nm_a": np.round(drive.torque_constant, 4).tolist(),
        "offset_nm": np.round(drive.offset, 4).tolist(),
        "coulomb_nm": np.round(drive.coulomb, 4).tolist(),
        "viscous_nm_s_rad": np.round(drive.viscous, 4).tolist(),
        "dead_zone_rad_s": drive.dead_zone,
    }
