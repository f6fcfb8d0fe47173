"""The controller's reference, tick by tick: one motion at a time, each from wherever the reference is.

What ``control.program`` plans from beginning to end happens here on line. A motion is a generator of target rows
(3, 6): q, qd, qdd; the speed slider and a pause slow down the planned ones.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from functools import lru_cache

import numpy as np
from scipy.linalg import expm

from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.control.blend import leg
from ur5_twin.control.commands import GAIN_RANGE, LOOKAHEAD_RANGE, MoveC, MoveJ, MoveL
from ur5_twin.control.limits import check_position
from ur5_twin.control.profile import ticks
from ur5_twin.control.trajectory import require_positive
from ur5_twin.errors import TwinError
from ur5_twin.wire.moves import Planned, Way

#: How fast the speed slider and a pause change the speed of motion, 1/s.
_RAMP = 2.0
#: A motion that is broken off brakes at this, rad/s^2.
BRAKING = 4.0
#: Damping of the Jacobian's inverse near singularities, m and rad.
_DAMPING = 0.02
#: Joints closer than this to their limits turn no further, rad.
_MARGIN = 1e-3
#: A line's joints are followed at points this far from one another or more, m.
_GUIDE = 1e-3
#: No tool goes faster, m/s and rad/s.
_FASTEST = 20.0

Rows = Generator[np.ndarray, None, None]


class Move:
    """A motion under way.

    Attributes:
        over: it has come to its end, or was broken off.
        reached: a stream's speed is what was asked for; a move is within its blend radius; of other motions, that they
            are over.
        error: why the arm could not go on; None if it could.
        way, at: of a move to a goal, its plan and how far it is, in ticks of the plan.
    """

    def __init__(self, rows: Rows) -> None:
        self.rows = rows
        self.over = False
        self.reached = False
        self.way: Way | None = None
        self.at = 0.0
        self.error: TwinError | None = None


class Motion:
    """The reference.

    Args:
        model: the controller's arm, for kinematics and limits.
        q: (6,) where it rests, rad.
        period: tick, s.

    Attributes:
        target: (3, 6) the reference now: q, qd, qdd.
        slider: speed of planned motion as asked for, 0 to 1.
        scaling: as it is now: ``slider``, or less while it changes or is paused.
        paused: whether it is.
        move: the motion under way; None at rest.
    """

    def __init__(self, model: ArmModel, q: np.ndarray, period: float) -> None:
        self.model, self.period = model, period
        self.target = np.stack([q, np.zeros(6), np.zeros(6)])
        self.slider, self.scaling, self.paused = 1.0, 1.0, False
        self.move: Move | None = None

    @property
    def arriving(self) -> bool:
        """Whether a move is within its blend radius, where it needs no program any more."""
        return self.move is not None and self.move.way is not None and self.move.reached

    @property
    def moving(self) -> bool:
        """Whether the reference moves, or is about to."""
        return self.move is not None or bool(self.target[1:].any())

    def step(self) -> np.ndarray:
        """The reference (3, 6) of the next tick. A move that cannot go on has an ``error``; the arm brakes."""
        wanted = 0.0 if self.paused else self.slider
        change = _RAMP * self.period
        self.scaling += min(max(wanted - self.scaling, -change), change)
        if self.move is not None:
            try:
                row = next(self.move.rows, None)
            except TwinError as error:
                row, self.move.error = None, error
            if row is not None:
                self.target = row
                return row
            self.move.over = self.move.reached = True
            self.move = None
        if self.target[1:].any():
            self.move = Move(self._braking(BRAKING))
            self.target = next(self.move.rows)
        return self.target

    def rest_at(self, q: np.ndarray) -> None:
        """Begin anew from rest, as after a protective stop; what was under way is broken off."""
        self._begin(None)
        self.target = np.stack([q, np.zeros(6), np.zeros(6)])

    # Motions; each breaks off the one before

    def rows(self, rows: Planned) -> Move:
        """Follow planned rows, one a tick, the first where the reference rests."""
        move = Move(_NOTHING)
        move.rows = self._planned(rows, move)
        return self._begin(move)

    def along(self, command: MoveJ | MoveL | MoveC, X_FT: np.ndarray) -> Move:
        """A movej, movel or movec of the tool at X_FT (4, 4) in the flange.

        A move within its blend radius is blended with, if the arm can; it comes to rest first if it cannot. An arm that
        moves otherwise brakes.

        Raises:
            TwinError: out of reach or beyond the joints' limits.
        """
        before = self.move
        if self.arriving and before is not None and before.way is not None:
            move, first = self._blended(before, before.way, command, X_FT)
        else:
            rows = list(self._braking(BRAKING)) if self.target[1].any() else []
            move, first = Move(_NOTHING), iter(rows)
            move.way = self._way(rows[-1][0] if rows else self.target[0], command, X_FT)
        way = move.way

        def both() -> Rows:
            yield from first
            if way is not None:
                yield from self._planned(way, move)

        move.rows = both()
        return self._begin(move)

    def servoj(self, q: np.ndarray, lookahead_time: float, gain: float) -> Move:
        """Go after a set point by the law of ``control.servoj`` until another motion begins, from any motion."""
        check_position(self.model.limits, q, "servoj")
        for name, value, (low, high) in (
            ("lookahead_time", lookahead_time, LOOKAHEAD_RANGE),
            ("gain", gain, GAIN_RANGE),
        ):
            if not low <= value <= high:
                raise TwinError(f"servoj: {name} is {value:g}, URScript allows {low:g} to {high:g}")
        return self._begin(self._following(np.asarray(q, dtype=float), lookahead_time, gain))

    def speedj(self, qd: np.ndarray, a: float) -> Move:
        """Bring the joints to speeds (6,) rad/s with ``a`` rad/s^2 of the leading one, and keep them."""
        require_positive("speedj", a=a)
        qd = np.clip(qd, -self.model.limits.qd, self.model.limits.qd)
        move = Move(_NOTHING)
        move.rows = self._joint_speed(qd, a, move)
        return self._begin(move)

    def speedl(self, xd: np.ndarray, a: float, p_FT: np.ndarray) -> Move:
        """Bring the tool centre point, at ``p_FT`` (3,) m in the flange, to a twist (6,) in base axes, and keep it.

        Args:
            xd: m/s and rad/s.
            a: m/s^2, and rad/s^2 of the turn.
            p_FT: the point.
        """
        require_positive("speedl", a=a)
        move = Move(_NOTHING)
        wanted = np.clip(xd, -_FASTEST, _FASTEST)
        move.rows = self._tool_speed(lambda: wanted, a, p_FT, move)
        return self._begin(move)

    def guided(self, wanted: Callable[[], np.ndarray], a: float, p_FT: np.ndarray) -> Move:
        """As ``speedl``, at a twist (6,) that is asked for anew each tick."""
        move = Move(_NOTHING)
        move.rows = self._tool_speed(lambda: np.clip(wanted(), -_FASTEST, _FASTEST), a, p_FT, move)
        return self._begin(move)

    def stop(self, a: float = BRAKING) -> Move:
        """Come to rest, the joints keeping their direction, with ``a`` rad/s^2 of the fastest."""
        require_positive("stopj", a=a)
        return self._begin(self._braking(a))

    def free(self, measured: Generator[np.ndarray, None, None]) -> Move:
        """Give way: the reference is where the arm is, at rest; ``measured`` gives (6,) rad each tick."""

        def rows() -> Rows:
            for q in measured:
                yield np.stack([q, np.zeros(6), np.zeros(6)])

        return self._begin(rows())

    def _begin(self, rows: Rows | Move | None) -> Move:
        if self.move is not None:
            self.move.over = True
            self.move.rows.close()
        move = rows if isinstance(rows, Move) else Move(_NOTHING if rows is None else rows)
        self.move = None if rows is None else move
        return move

    # Generators of rows

    def _way(
        self, q: np.ndarray, command: MoveJ | MoveL | MoveC, X_FT: np.ndarray, after: tuple[Way, float] | None = None
    ) -> Way | None:
        # Only the distance of a line's guiding points depends on the period here.
        found = leg(self.model, q, command, max(self.period, _GUIDE / command.v), command.name, X_FT)
        return None if found is None else Way(self.model, found, self.period, X_FT, command.r, after)

    def _blended(
        self, before: Move, way: Way, command: MoveJ | MoveL | MoveC, X_FT: np.ndarray
    ) -> tuple[Move, Iterator]:
        """The move that follows upon one near its goal, and rows of that one that come first, if they do not blend."""
        goal, move = way.leg.way.goal, Move(_NOTHING)
        try:
            move.way = self._way(goal, command, X_FT, (way, before.at))
        except TwinError:
            # Out of reach, or no more than too fast for a blend.
            move.way = self._way(goal, command, X_FT)
        else:
            if move.way is not None:
                return move, iter(())
        rest = Move(_NOTHING)
        rest.at = before.at
        return move, self._planned(way, rest)

    def _planned(self, rows: Planned, move: Move) -> Rows:
        """Rows at the speed that slider and pause allow."""
        last = len(rows) - 1
        while move.at < last:
            before = self.scaling
            move.at = at = min(move.at + before, last)
            k = min(int(at), last - 1)
            row = rows[int(at)] if before == 1.0 and at == int(at) else None
            if row is None:
                row = _between(rows[k], rows[k + 1], at - k, self.period, before)
            move.reached = move.way is not None and move.way is rows and move.way.near(at)
            yield row

    def _following(self, u: np.ndarray, lookahead: float, gain: float) -> Rows:
        A = _filter(gain, lookahead, self.period)
        fastest = self.model.limits.qd
        while True:
            q, qd = self.target[0], self.target[1]
            offset = q - u
            speed = A[1, 0] * offset + A[1, 1] * qd
            q_next = u + A[0, 0] * offset + A[0, 1] * qd
            too_fast = np.abs(speed) > fastest
            if too_fast.any():
                # Not faster than a joint can, and on from there.
                speed = np.clip(speed, -fastest, fastest)
                q_next = np.where(too_fast, q + self.period * speed, q_next)
            yield np.stack([q_next, speed, (speed - qd) / self.period])

    def _joint_speed(self, wanted: np.ndarray, a: float, move: Move) -> Rows:
        while True:
            qd = self.target[1]
            missing = wanted - qd
            share = min(1.0, a * self.period / max(np.abs(missing).max(), 1e-12))
            move.reached = share == 1.0
            yield self._with_speed(qd + share * missing)

    def _tool_speed(self, wanted: Callable[[], np.ndarray], a: float, p_FT: np.ndarray, move: Move) -> Rows:
        twist = self._twist(p_FT)
        while True:
            missing = wanted() - twist
            size = max(np.linalg.norm(missing[:3]), np.linalg.norm(missing[3:]), 1e-12)
            share = min(1.0, a * self.period / size)
            move.reached = share == 1.0
            twist = twist + share * missing
            J = self._jacobian(p_FT)
            qd = J.T @ np.linalg.solve(J @ J.T + _DAMPING**2 * _weak(J) * np.eye(6), twist)
            beyond = float((np.abs(qd) / self.model.limits.qd).max())
            yield self._with_speed(qd / max(beyond, 1.0))

    def _with_speed(self, qd: np.ndarray) -> np.ndarray:
        """The next row, with joint speeds (6,) that keep within the joints' range."""
        q, before = self.target[0], self.target[1]
        limit = self.model.limits.q - _MARGIN
        # Straight from one speed to the other; a joint at its limit stays there.
        ahead = np.clip(q + 0.5 * self.period * (before + qd), -limit, limit)
        qd = np.where(np.abs(ahead) >= limit, 0.0, qd)
        return np.stack([ahead, qd, (qd - before) / self.period])

    def _braking(self, a: float) -> Rows:
        """``trajectory.stop``, row by row: however softly it brakes. Before a joint's limit it brakes harder."""
        q, qd = self.target[0], self.target[1]
        limit = self.model.limits.q
        speed = np.abs(qd)
        if not speed.any():
            yield np.stack([q, np.zeros(6), np.zeros(6)])
            return
        room = np.where(qd > 0.0, limit - q, limit + q)[speed > 0.0]
        # A joint that creeps takes longer than a float can say.
        with np.errstate(over="ignore"):
            within = float(np.max([0.0, np.min(2.0 * room / speed[speed > 0.0])])) / self.period
        n = max(1, ticks(min(speed.max() / a, 1e15), self.period))
        n = max(1, min(n, int(min(within, 1e18))))
        duration = n * self.period
        end, rate = np.clip(q + 0.5 * qd * duration, -limit, limit), -qd / duration
        for k in range(n - 1, 0, -1):
            left = k * self.period
            yield np.stack([end + 0.5 * left**2 * rate, -left * rate, rate])
        yield np.stack([end, np.zeros(6), np.zeros(6)])

    def _jacobian(self, p_FT: np.ndarray) -> np.ndarray:
        return kinematics.point_jacobian(self.model, self.target[0], 6, p_FT)

    def _twist(self, p_FT: np.ndarray) -> np.ndarray:
        return self._jacobian(p_FT) @ self.target[1]


def _nothing() -> Rows:
    yield from ()


_NOTHING = _nothing()


@lru_cache(maxsize=16)
def _filter(gain: float, lookahead: float, period: float) -> np.ndarray:
    return expm(np.array([[0.0, 1.0], [-gain, -gain * lookahead]]) * period)


def _weak(J: np.ndarray) -> float:
    """How near to a singularity, 0 to 1: damping grows there, and is none elsewhere."""
    smallest = float(np.linalg.svd(J, compute_uv=False)[-1])
    return max(0.0, 1.0 - (smallest / 0.1) ** 2)


def _between(a: np.ndarray, b: np.ndarray, share: float, period: float, scaling: float) -> np.ndarray:
    """The row between two rows of a plan that is followed at less than its speed: a cubic through both."""
    h, s = period, share
    q = (
        (1 + 2 * s) * (1 - s) ** 2 * a[0]
        + s * (1 - s) ** 2 * h * a[1]
        + s**2 * (3 - 2 * s) * b[0]
        + s**2 * (s - 1) * h * b[1]
    )
    qd = 6 * s * (1 - s) * (b[0] - a[0]) / h + (1 - s) * (1 - 3 * s) * a[1] + s * (3 * s - 2) * b[1]
    qdd = a[2] + s * (b[2] - a[2])
    return np.stack([q, scaling * qd, scaling**2 * qdd])
