"""What a joint's current is explained by, averaged over short windows of a measured motion.

At each tick k i = tau_link + J_r qdd + friction + ripple - b holds with the motion as it IS at that tick; the arm lags
its targets, so that the targets would bias it. Speed is measured to 13 urad/s, only the acceleration is not. Its mean
over two ticks is (qd_k+1 - qd_k-1) / 2T; what stands beside it is averaged likewise, by Simpson's rule (1, 4, 1) / 6,
which agrees with the mean of a sine to 1e-4 up to 10 Hz (1 % at 30 Hz). The controller's feed-forward of friction steps
once a tick and a current is read right after the step; the mean about it is half a step less, else inertias come out 1
to 3 % too large.

Windows of Hann's shape, 0.128 s long, then take out what 125 rows a second cannot show: the ripple of the motors at
speed, which is folded down to 28 Hz or more as long as order * |qd| / 2 pi stays a quarter away from multiples of 125
Hz. Windows lie within sliding: a window has one direction of motion and no row slower than ``SLOWEST``, so that
friction has its sign and nothing sticks. That costs what is next to a reversal, where a joint accelerates most. The
big joints, whose ripple is small beside their inertia and friction, therefore have windows of 0.04 s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import N_JOINTS, ArmModel
from ur5_twin.control.target_current import TargetCurrentLaw, load_target_current_law
from ur5_twin.control.tcp_force import last_known, viscous_ratio
from ur5_twin.errors import IdentificationError
from ur5_twin.identification.load import load_columns, mass_columns
from ur5_twin.recording.table import Recording

#: Slowest speed of a row in a window, rad/s: a joint has left its presliding (0.1 mrad) 3 ms after it turned round.
SLOWEST = 0.03
#: Numbers of a payload, the first of what is sought.
BODY = 10
#: s within which errors are taken for correlated.
BLOCK = 1.0
_NEEDED = ("actual_q", "actual_qd", "actual_current")
_TARGETS = ("target_qd", "target_moment", "target_current")
#: Two rows further apart than this times the usual step are no neighbours.
_GAP = 1.5


@dataclass(frozen=True)
class Shape:
    """A window of Hann's shape.

    Attributes:
        length: rows, beside the one at either end that Simpson's rule looks at.
        hop: rows from one window to the next.
    """

    length: int
    hop: int

    @property
    def rates(self) -> np.ndarray:
        """(length,) what a row of an acceleration counts for."""
        hann = np.hanning(self.length + 2)[1:-1]
        return hann / hann.sum()

    @property
    def rows(self) -> np.ndarray:
        """(length + 2,) what a row of all else counts for: the same with Simpson's rule."""
        return np.convolve(self.rates, np.array([1.0, 4.0, 1.0]) / 6.0)


LONG, SHORT = Shape(16, 4), Shape(5, 2)
#: Of each joint.
SHAPES = (SHORT, SHORT, SHORT, LONG, LONG, LONG)


@dataclass(frozen=True)
class Motion:
    """The measured motion of one log, each (n, 6) but time and joined.

    Attributes:
        source: the log's name.
        time: (n,) s.
        joined: (n,) whether a row has both neighbours at the usual step.
        q, qd: rad, rad/s.
        qdd: rad/s^2, the mean over the two ticks about a row.
        link: torque that the links need, without the rotors', Nm.
        ratio: viscous friction over its mean, by the controller's correction for the drive's temperature.
        current: A.
        sought: (n, 6, 15) torque of an unknown payload by its ten numbers (``identification.body``), zeros where it did
            not hang, and by shares of the masses of links 2 to 6, Nm; (n, 6, 0) if no payload is sought.
    """

    source: str
    time: np.ndarray
    joined: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    link: np.ndarray
    ratio: np.ndarray
    current: np.ndarray
    sought: np.ndarray

    def carrying(self, numbers: np.ndarray) -> Motion:
        """The motion with a payload of ten numbers (10,) on the links, or with all that is sought (15,)."""
        return replace(self, link=self.link + self.sought[:, :, : len(numbers)] @ numbers)

    def bare(self) -> Motion:
        """The motion as one in which the payload that is sought did not hang."""
        sought = self.sought.copy()
        sought[:, :, :BODY] = 0.0
        return replace(self, sought=sought)

    def late(self, seconds: float) -> Motion:
        """The motion as a current shows it that is reported ``seconds`` late, at most one row."""
        share = seconds / float(np.median(np.diff(self.time)))
        if share == 0.0:
            return self

        def before(x: np.ndarray) -> np.ndarray:
            return (1.0 - share) * x + share * np.concatenate([x[:1], x[:-1]])

        moved = {name: before(getattr(self, name)) for name in ("q", "qd", "qdd", "link", "ratio", "sought")}
        return replace(self, joined=self.joined & np.concatenate([[False], self.joined[:-1]]), **moved)


def motion(
    recording: Recording, model: ArmModel, law: TargetCurrentLaw | None = None, *, payload: bool = False
) -> Motion:
    """A log's measured motion.

    Args:
        recording: with actual_q, actual_qd and actual_current; with target_qd, target_moment and target_current too the
            controller's correction for the drives' temperature is taken from them.
        model: the links with whatever is bolted to the flange.
        law: the controller's drive law, by default the one that ships.
        payload: something unknown hangs on the flange beside that, and is sought.

    Raises:
        IdentificationError: a signal is missing, or the log is shorter than 10 windows.
    """
    robot = recording.robot
    missing = [name for name in _NEEDED if name not in robot]
    if missing:
        raise IdentificationError(f"{recording.source}: no {', '.join(missing)}; a plant needs {', '.join(_NEEDED)}")
    least = 10 * LONG.length
    if len(robot) < least:
        raise IdentificationError(
            f"{recording.source}: {len(robot)} rows, too few for a plant; {least} at least, better 15,000 (120 s)"
        )
    time, q, qd = robot.time, robot["actual_q"], robot["actual_qd"]
    step = np.diff(time)
    near = step < _GAP * np.median(step)
    joined = np.zeros(len(time), dtype=bool)
    joined[1:-1] = near[:-1] & near[1:]
    qdd = np.zeros_like(qd)
    qdd[1:-1] = (qd[2:] - qd[:-2]) / (time[2:] - time[:-2])[:, None]
    ratio, current = np.ones_like(q), robot["actual_current"]
    if all(name in robot for name in _TARGETS):
        law = law or load_target_current_law()
        told = viscous_ratio(law, *(robot[name] for name in _TARGETS))
        ratio = last_known(told, np.ones(N_JOINTS))
        # Half of the step that the feed-forward has just made; see the module.
        forward = robot["target_current"] - robot["target_moment"] / law.torque_constant
        current = current.copy()
        current[1:] -= 0.5 * np.diff(forward, axis=0)
    without_rotors = Dynamics(replace(model, rotor_inertia=np.zeros(N_JOINTS)))
    link = without_rotors.inverse(q, qd, qdd)
    sought = np.empty((*q.shape, 0))
    if payload:
        sought = np.concatenate([load_columns(model, q, qd, qdd), mass_columns(model, q, qd, qdd)], axis=2)
    return Motion(recording.source, time, joined, q, qd, qdd, link, ratio, current, sought)


@dataclass(frozen=True)
class Windows:
    """Window means of one joint over all logs.

    Attributes:
        speed: (n,) rad/s.
        block: (n,) number of the second of a log that a window begins in, the same for all joints.
        blocks: how many seconds the logs have.
        current: (n,) A.
        rotor: (n,) rad/s^2.
        link: (n,) Nm.
        load: (n,) |torque of the links| sgn(qd), Nm.
        forward, backward: (n,) the direction's share, 1 and -1 or 0.
        viscous: (n,) ratio qd, rad/s.
        ripple: (n, 2 per order) cosine and sine.
        sought, sought_load: (n, 15) derivatives of link and load in what is sought of payload and masses; (n, 0) if
            nothing is.
        rows: (n, shape.length + 2) the rows of qd that a window is of, for friction that fades with speed.
        shape: of the windows.
    """

    speed: np.ndarray
    block: np.ndarray
    blocks: int
    current: np.ndarray
    rotor: np.ndarray
    link: np.ndarray
    load: np.ndarray
    forward: np.ndarray
    backward: np.ndarray
    viscous: np.ndarray
    ripple: np.ndarray
    sought: np.ndarray
    sought_load: np.ndarray
    rows: np.ndarray
    shape: Shape

    def at(self, which: np.ndarray) -> Windows:
        """Some of the windows."""
        return replace(self, **{name: getattr(self, name)[which] for name in _COLUMNS})

    def fading(self, speed: float) -> tuple[np.ndarray, np.ndarray]:
        """(n,) means of sgn(qd) exp(-(qd / speed)^2), and of its derivative in speed."""
        squares = (self.rows / speed) ** 2
        fade = np.sign(self.rows) * np.exp(-squares)
        return fade @ self.shape.rows, (2.0 / speed * squares * fade) @ self.shape.rows


def windows(motions: Sequence[Motion], joint: int, orders: Sequence[float], shape: Shape | None = None) -> Windows:
    """Means over all windows in which a joint slides; see the module.

    Args:
        motions: the logs.
        joint: from 0.
        orders: of the ripple, periods a revolution.
        shape: of the windows, by default the joint's in ``SHAPES``.
    """
    shape = SHAPES[joint] if shape is None else shape
    parts, first = [], 0
    for one in motions:
        part = _of_one(one, joint, orders, shape)
        parts.append(replace(part, block=part.block + first))
        first += part.blocks
    columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _COLUMNS}
    return Windows(blocks=first, shape=shape, **columns)


_COLUMNS = tuple(name for name in Windows.__dataclass_fields__ if name not in ("blocks", "shape"))


def _of_one(of: Motion, joint: int, orders: Sequence[float], shape: Shape) -> Windows:
    qd = of.qd[:, joint]
    slides = of.joined & (np.abs(qd) > SLOWEST)
    # The rows that Simpson's rule looks at, one more at either end.
    width = shape.length + 2
    start = np.arange(0, max(len(qd) - width, 0), shape.hop)
    index = start[:, None] + np.arange(width)
    sign = np.sign(qd)
    whole = slides[index].all(axis=1) & (np.abs(sign[index].sum(axis=1)) == width)
    index = index[whole]
    angle = of.q[:, joint]
    waves = [wave(order * angle) for order in orders for wave in (np.cos, np.sin)]

    def mean(x: np.ndarray) -> np.ndarray:
        return x[index] @ shape.rows

    def mean_of_rate(x: np.ndarray) -> np.ndarray:
        return np.moveaxis(x[index[:, 1:-1]], 1, -1) @ shape.rates

    link, sought = of.link[:, joint], of.sought[:, joint]
    return Windows(
        speed=mean(qd),
        block=((of.time[index[:, 0]] - of.time[0]) // BLOCK).astype(int),
        blocks=int((of.time[-1] - of.time[0]) // BLOCK) + 1,
        current=mean(of.current[:, joint]),
        rotor=mean_of_rate(of.qdd[:, joint]),
        # Mostly inertia where it is quick, so averaged as the acceleration is.
        link=mean_of_rate(link),
        load=mean_of_rate(np.abs(link) * sign),
        forward=mean(1.0 * (sign > 0)),
        backward=mean(-1.0 * (sign < 0)),
        viscous=mean(of.ratio[:, joint] * qd),
        ripple=np.stack([mean(wave) for wave in waves], axis=1) if waves else np.empty((len(index), 0)),
        sought=mean_of_rate(sought),
        sought_load=mean_of_rate((np.sign(link) * sign)[:, None] * sought),
        rows=qd[index],
        shape=shape,
    )
