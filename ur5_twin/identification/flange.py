"""What a device at the flange feels of the arm's motion, slow enough for links that do not bend."""

from __future__ import annotations

import numpy as np

from ur5_twin import spatial
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.errors import IdentificationError
from ur5_twin.identification.clocks import smoothed
from ur5_twin.recording.table import Recording
from ur5_twin.sensing.kinetics import FlangeMotion
from ur5_twin.sensing.signals import Signals

#: Both sides of a comparison are taken below this, Hz: links bend above, and vibrate in motion.
BAND = 4.0
#: Rows a second of a comparison: twice as many as the band needs.
RATE = 20.0
#: Of a block of correlated errors, s.
BLOCK = 1.0
#: What a filter spoils at either end of a log, s.
EDGE = 0.3
#: Columns of ``flange_felt``.
LINEAR, LEVER, TURN = slice(0, 3), slice(3, 12), slice(12, 15)


def flange_felt(recording: Recording, arm: ArmModel) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) on the robot's clock, and the flange's acceleration less gravity, S(alpha) + S(omega)^2 row by row and
    omega (n, 15) there, flange axes, below the band.

    Raises:
        IdentificationError: actual_q or actual_qd is missing.
    """
    robot = recording.robot
    missing = [name for name in ("actual_q", "actual_qd") if name not in robot]
    if missing:
        raise IdentificationError(f"{recording.source}: no {', '.join(missing)}; the flange's motion comes from them")
    step = float(np.median(np.diff(robot.time)))
    time = np.arange(robot.time[0], robot.time[-1], step)
    q, qd = (
        np.stack([np.interp(time, robot.time, column) for column in robot[name].T], axis=1)
        for name in ("actual_q", "actual_qd")
    )
    none = np.zeros_like(q)
    motion = FlangeMotion.of(arm, Signals(time, q, qd, np.gradient(qd, step, axis=0), none, none))
    a, omega, alpha = (motion.into_flange(v) for v in (motion.acceleration, motion.omega, motion.alpha))
    lever = spatial.skew(alpha) + spatial.skew(omega) @ spatial.skew(omega)
    return smoothed(time, np.concatenate([a, lever.reshape(-1, 9), omega], axis=1), BAND)
