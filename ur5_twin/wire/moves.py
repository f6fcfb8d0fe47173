"""Moves of a program, planned as they are needed: from rest, or blended into from the move before.

A program tells its next move only when it gets there. So a move with a blend radius plans to come to rest at its goal,
and is left by the program once the tool is within the radius. What then is left of its way, d at the speed v, falls as
d (1 - t/T)^2 with T = 2 d / v, to rest, whatever follows; a move that follows at once grows as w T/2 (t/T)^2 beside it,
up to its speed w at T: a corner of ``control.blend``. Nothing exceeds the accelerations of both moves, and moves of the
same speed pass a corner of a straight way at that speed.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from ur5_twin.arm.parameters import ArmModel
from ur5_twin.control.blend import Corner, JointLine, Leg, guided, zone
from ur5_twin.control.cartesian import check_line
from ur5_twin.control.limits import check_rows
from ur5_twin.control.profile import Trapezoid, ticks
from ur5_twin.control.trajectory import still
from ur5_twin.errors import TwinError

#: Rows of a move that are computed at once, and places at which it is looked at before it begins.
_CHUNK, _PLACES = 16, 65
#: A move takes no longer, s: some years.
_LONGEST = 1e8
#: What a blend may take of a way at each end.
_HALF = 0.5


class Planned(Protocol):
    """Rows (3, 6) of a motion, one a tick: an array (n, 3, 6), or what computes them as they are needed."""

    def __len__(self) -> int: ...

    def __getitem__(self, k: int, /) -> np.ndarray: ...


class Way:
    """A move's rows, computed some at a time as they are needed, however long it takes.

    Args:
        model: the arm with its limits.
        leg: the way from where the arm rests.
        period: tick, s.
        X_FT: (4, 4) the tool in the flange.
        radius: within this distance of the tool from its goal, m, the move may be left for the next one; half of the
            way at most.
        after: the move that it is blended with, which is as good as there, and where that is, in ticks of its plan. The
            leg begins at its goal.

    Attributes:
        leg: the way.

    Raises:
        TwinError: at its beginning, or where it gets there: it passes a joint's limit or a singularity; or it takes for
            ever; or there can be no such blend.
    """

    def __init__(
        self,
        model: ArmModel,
        leg: Leg,
        period: float,
        X_FT: np.ndarray,
        radius: float = 0.0,
        after: tuple[Way, float] | None = None,
    ) -> None:
        self.leg = leg
        self._model, self._period = model, period
        self._corner, self._blend = (None, 0.0) if after is None else _corner(*after, leg)
        self._taken, speed = 0.0, 0.0
        if self._corner is not None:
            self._taken, speed = self._corner.taken, 2.0 * self._corner.taken / self._blend
        self._law = Trapezoid(leg.way.length - self._taken, leg.v, leg.a, start=speed)
        duration = self._blend + self._law.duration
        if duration > _LONGEST:
            raise TwinError(f"{leg.way.name} takes {duration:.3g} s; {_LONGEST:g} s at most")
        self._last = ticks(duration, period)
        self._near = 0.0
        if radius > 0.0:
            self._near = min(zone(model, leg.way, radius, at_goal=True, X_FT=X_FT), _HALF * leg.way.length)
        # A move that is slowed down looks at two rows for many ticks, perhaps of two chunks.
        self._chunks: dict[int, np.ndarray] = {}
        times = np.linspace(self._blend, duration, _PLACES)
        if self._corner is not None:
            times = np.concatenate([np.linspace(0.0, self._blend, _PLACES), times])
        check_rows(model.limits, self._rows(times), lambda k: self._where(times[k]))

    def __len__(self) -> int:
        return self._last + 1

    def __getitem__(self, k: int, /) -> np.ndarray:
        if k == self._last:
            return still(self.leg.way.goal, 1)[0]
        chunk, place = divmod(k, _CHUNK)
        if chunk not in self._chunks:
            # With the row before, for the step between.
            first = max(chunk * _CHUNK - 1, 0)
            times = np.arange(first, (chunk + 1) * _CHUNK) * self._period
            rows = self._rows(times)
            if not isinstance(self.leg.way, JointLine):
                check_line(self._model, rows, self._period, lambda j: self._where(times[j]))
            self._chunks = {k: old for k, old in self._chunks.items() if k == chunk - 1}
            self._chunks[chunk] = rows[chunk * _CHUNK - first :]
        return self._chunks[chunk][place]

    def left(self, at: float) -> tuple[float, float]:
        """What is left of the way, and the speed, at a place in ticks of the plan, once it is blended into."""
        x, rate, _ = self._law.at(np.array([at * self._period - self._blend]))
        return self._law.length - float(x[0]), float(rate[0])

    def near(self, at: float) -> bool:
        """Whether the goal is within the radius at a place in ticks of the plan."""
        return self._near > 0.0 and at * self._period >= self._blend and self.left(at)[0] <= self._near

    def _rows(self, times: np.ndarray) -> np.ndarray:
        """(n, 3, 6) at times (n,) in s from the beginning."""
        blending = times < self._blend
        x, rate, change = self._law.at(np.maximum(times - self._blend, 0.0))
        if self._corner is None or not blending.any():
            return self.leg.way.rows(self._taken + x, rate, change)
        rows = np.empty((len(times), 3, 6))
        rows[blending] = self._corner.rows(times[blending], self._blend)
        if not blending.all():
            later = ~blending
            rows[later] = self.leg.way.rows(self._taken + x[later], rate[later], change[later])
        return rows

    def _where(self, time: float) -> str:
        if self._corner is not None and time < self._blend:
            return self._corner.where()
        return self.leg.way.where(self._taken + float(self._law.at(np.array([time - self._blend]))[0][0]))


def _corner(before: Way, at: float, after: Leg) -> tuple[Corner, float]:
    """The blend of what is left of a move with the next one, and the time that it takes, s.

    Raises:
        TwinError: the arm cannot follow it.
    """
    left, speed = before.left(at)
    if not left > 0.0 < speed:
        raise TwinError(f"{after.way.name}: the move before it is over")
    time = 2.0 * left / speed
    # As fast as the next move, its acceleration, half of its way and its goal allow.
    stopping = after.a * (math.sqrt(0.25 * time**2 + 2.0 * after.way.length / after.a) - 0.5 * time)
    reached = min(after.v, after.a * time, 2.0 * _HALF * after.way.length / time, stopping)
    return guided(Corner(before.leg, after, left, 0.5 * reached * time)), time
