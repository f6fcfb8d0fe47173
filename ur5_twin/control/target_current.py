"""The current that the real controller asks of its drives: how target_current follows from target_moment.

Per joint, to the six digits of the lab logs::

    target_current = tau / k + load |tau| sgn(qd) + viscous qd,    tau = target_moment, qd = target_qd

with one viscous coefficient while the joint drives its load (tau qd > 0), another while it is back-driven (tau qd < 0)
and their mean without load. The first two terms never change. The viscous coefficients take a few discrete values
within each log, in the ratios of thesis table 4.1 (0.4 : 0.6 for the big joints, 0.3 : 0.25 for the small ones), and
differ by 20 % between logs: the controller corrects its friction for the drive's temperature, which the lab's logs do
not hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np

from ur5_twin.arm import files

#: Torque that a log's six decimals cannot tell from none, Nm.
_NO_TORQUE = 1e-6


def driving_share(torque: np.ndarray, qd: np.ndarray) -> np.ndarray:
    """1 where a joint drives its load, 0 where it is back-driven, 1/2 without load or at rest; any shape, Nm, rad/s."""
    return 0.5 + 0.5 * np.sign(qd) * np.where(np.abs(torque) > _NO_TORQUE, np.sign(torque), 0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def feed_forward(torque, qd, load, viscous_driving, viscous_backdriven):  # pragma: no cover - compiled
    """The law's friction terms for one joint, A, from target_moment (Nm) and target_qd (rad/s)."""
    driving = 0.5
    if qd != 0.0 and abs(torque) > _NO_TORQUE:
        driving = 1.0 if torque * qd > 0.0 else 0.0
    sign = 1.0 if qd > 0.0 else -1.0 if qd < 0.0 else 0.0
    return load * abs(torque) * sign + (driving * viscous_driving + (1.0 - driving) * viscous_backdriven) * qd


@dataclass(frozen=True)
class TargetCurrentLaw:
    """Coefficients of the law above.

    Attributes:
        torque_constant: k, (6,) Nm/A at standstill.
        load: (6,) A/Nm, load-dependent friction.
        viscous_driving: (6,) A s/rad at the drive temperature of the logs it was fitted to.
        viscous_backdriven: (6,) A s/rad, likewise.
    """

    source: str
    torque_constant: np.ndarray
    load: np.ndarray
    viscous_driving: np.ndarray
    viscous_backdriven: np.ndarray

    def current(self, target_moment: np.ndarray, target_qd: np.ndarray) -> np.ndarray:
        """target_current (..., 6) in A from target_moment (..., 6) in Nm and target_qd (..., 6) in rad/s."""
        driving = driving_share(target_moment, target_qd)
        viscous = driving * self.viscous_driving + (1.0 - driving) * self.viscous_backdriven
        return (
            target_moment / self.torque_constant
            + self.load * np.abs(target_moment) * np.sign(target_qd)
            + viscous * target_qd
        )


def load_target_current_law(path: Path | None = None) -> TargetCurrentLaw:
    """The law with the coefficients of a TOML file, by default ``models/target_current.toml``.

    Raises:
        ModelError: the file is wrong.
    """
    spec = files.read(path or files.model_path("target_current.toml"), files.TargetCurrentSpec)
    return TargetCurrentLaw(
        source=spec.source,
        torque_constant=np.array(spec.torque_constant_nm_a),
        load=np.array(spec.load_a_nm),
        viscous_driving=np.array(spec.viscous_driving_a_s_rad),
        viscous_backdriven=np.array(spec.viscous_backdriven_a_s_rad),
    )
