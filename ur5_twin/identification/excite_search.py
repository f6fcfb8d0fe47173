"""A tour of postures that tells most: each leg from rest to rest, chosen by what it adds to Fisher's information.

Information adds up over legs, so a tour is built greedily (of some candidates, the leg that tells most for its time)
and then exchanged (Fedorov 1972): one posture or one speed at a time is tried anew and kept if the whole tells more.
Every leg keeps to the limits when it is made, so that any tour does.

Between postures joints move together along a straight way in joint space: as a quintic with rest at both ends
(set points for servoj), or as the controller's own trapezoid of speed (movej).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ur5_twin.control.commands import MoveJ
from ur5_twin.control.profile import Trapezoid
from ur5_twin.control.trajectory import still
from ur5_twin.errors import IdentificationError
from ur5_twin.identification.excitation import Information, Question, summed
from ur5_twin.identification.workspace import Workspace

Format = Literal["waypoints", "servoj"]
FORMATS: tuple[Format, ...] = ("waypoints", "servoj")

#: Step at which the search looks at a leg, s: a third of the robot's rows tell the same.
_COARSE = 0.024
#: Rest between two legs, s: the filter of servoj settles, and a movej is over before the next one is sent.
_REST = {"servoj": 0.4, "waypoints": 0.4}
#: servoj's filter, as URScript allows it at its softest: set points are held for a tick, of which its acceleration
#: keeps a sawtooth of gain times speed times tick, up and down by half.
LOOKAHEAD, GAIN = 0.2, 100.0
_TICK = 0.008
#: Each how many seconds a waypoint file sends its next move, s.
WAIT = 4.0
#: Share of the limits that legs are made with, so that rounding and the filter stay below.
_SHARE = 0.98
#: Least speed of a leg, rad/s: slower, friction's fading is all there is, and it shows at the ends of any leg.
_SLOWEST = 0.05
#: Least way of a leg, rad.
_SHORTEST = 0.05
#: Share of rests and half moves that is left over at the end of a tour, s.
_LEFT = 0.5
#: Candidates of a greedy choice, tries for a posture until there seems to be none, and exchanges.
_CANDIDATES, _TRIES, EXCHANGES = 16, 400, 2000
#: Steps that the greedy part counts for in a progress bar.
GREEDY = 500
#: Chance that a candidate is near the posture before it, and how near, rad.
_NEARBY, _NEAR = 0.5, (0.1, 1.2)
#: Distance that the search keeps more than it must, m: the filter of servoj cuts corners, the servo errs.
_MARGIN = 0.005


def _rate(s: np.ndarray) -> np.ndarray:
    """Derivative of the quintic 10 s^3 - 15 s^4 + 6 s^5; at most 15/8."""
    return 30.0 * s**2 * (1.0 - s) ** 2


def _acceleration(s: np.ndarray) -> np.ndarray:
    return 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)


_HALF = np.linspace(0.0, 0.5, 101)
_QUINTIC_RATE, _QUINTIC_ACCELERATION = _rate(_HALF), _acceleration(_HALF)


@dataclass(frozen=True)
class Leg:
    """From one posture to the next.

    Attributes:
        goal: (6,) rad.
        speed, acceleration: of the joint that moves farthest, rad/s and rad/s^2, at most.
        duration: s, the rest after it not counted.
        told: what it tells.
    """

    goal: np.ndarray
    speed: float
    acceleration: float
    duration: float
    told: Information


@dataclass(frozen=True)
class Tour:
    """Legs from a start on.

    Attributes:
        start: (6,) rad.
        legs: in order.
        value: of the whole (``Question.value``).
    """

    start: np.ndarray
    legs: tuple[Leg, ...]
    value: float


class Search:
    """Looks for a tour.

    Args:
        question: what shall be known.
        workspace: the postures that are allowed.
        format: how a leg is moved along.
        duration: s of the whole.
        rng: of all choices.

    Raises:
        IdentificationError: the time is too short for two legs.
    """

    def __init__(
        self, question: Question, workspace: Workspace, format: Format, duration: float, rng: np.random.Generator
    ) -> None:
        self._question, self._format, self._rng = question, format, rng
        bounds = workspace.bounds
        self._bounds = bounds
        self._workspace = Workspace(workspace.plant, bounds.tightened(_MARGIN))
        self._rest = _REST[format]
        self._budget = duration - _LEFT
        # The first move of a waypoint file goes to where the arm stands.
        self._slots = int(duration / WAIT) - 1 if format == "waypoints" else None
        self._speeds = (min(_SLOWEST, 0.5 * bounds.speed), _SHARE * bounds.speed)
        self._acceleration = _SHARE * bounds.acceleration
        if self._slots is not None and self._slots < 2:
            raise IdentificationError(
                f"--duration {duration:g} s has room for {self._slots + 1} moves, one each {WAIT:g} s; give "
                f"{3 * WAIT:g} s or more"
            )
        if self._slots is None and duration < 5.0:
            raise IdentificationError(f"--duration {duration:g} s is too short to move every joint; give 5 s or more")

    def random(self, start: np.ndarray) -> Tour:
        """A tour of random postures at URScript's own speed, within the same limits: what nobody has optimised."""
        legs, q, used = [], start, 0.0
        while self._room(len(legs), used):
            leg = self._propose(q, nearby=False, speed=min(MoveJ.v, self._speeds[1]))
            used += leg.duration + self._rest
            if self._slots is None and used > self._budget:
                break
            legs.append(leg)
            q = leg.goal
        return self._tour(start, legs)

    def best(self, start: np.ndarray, exchanges: int, progress: Callable[[int], object] | None = None) -> Tour:
        """The best tour found; ``progress`` is called with the steps done of ``exchanges + GREEDY``."""
        legs = self._extended(start, [], progress)
        total = summed([leg.told for leg in legs])
        value = self._rate(total, legs)
        for done in range(1, exchanges + 1):
            k = int(self._rng.integers(len(legs)))
            changed = self._exchanged(start, legs, k)
            if changed is not None:
                other = total
                for old, new in zip(legs, changed, strict=True):
                    if old is not new:
                        other = other - old.told + new.told
                better = self._rate(other, changed)
                if better > value:
                    legs, total, value = changed, other, better
            if progress is not None:
                progress(GREEDY + done)
        return self._tour(start, self._extended(start, legs))

    def leg(self, start: np.ndarray, goal: np.ndarray, speed: float) -> Leg:
        """A leg between two postures, (6,) rad, no faster than ``speed`` rad/s; the way may not be free."""
        length = float(np.abs(goal - start).max())
        duration = self._law(length, speed)
        if self._slots is not None:
            most = WAIT - self._rest
            # Faster than asked, if that is what it takes to be there in time; what is still too long is refused later.
            while duration > most and speed < self._speeds[1]:
                speed = min(1.2 * speed, self._speeds[1])
                duration = self._law(length, speed)
        time = (np.arange(max(2, round(duration / _COARSE))) + 0.5) * _COARSE
        x = self._profile(length, speed, np.minimum(time, duration))
        direction = (goal - start) / length
        rows = x[:, :, None] * direction
        rows[:, 0] += start
        question = self._question
        told = question.information(question.ride(rows, _COARSE), step=_COARSE)
        return Leg(goal, speed, self._acceleration, duration, told)

    def samples(self, tour: Tour, period: float) -> np.ndarray:
        """Set points (n, 6) of a tour, one a ``period``, from its start to its end."""
        return self.rows(tour, period)[:, 0]

    def rows(self, tour: Tour, period: float) -> np.ndarray:
        """(n, 3, 6) q, qd, qdd along a tour, one a ``period``, with its rests (a waypoint file's are longer)."""
        rows, q = [still(tour.start, 1)], tour.start
        rest = round(self._rest / period)
        for leg in tour.legs:
            length = float(np.abs(leg.goal - q).max())
            n = int(np.ceil(leg.duration / period))
            x = self._profile(length, leg.speed, np.minimum(np.arange(1, n + 1) * period, leg.duration))
            moving = x[:, :, None] * (leg.goal - q) / length
            moving[:, 0] += q
            rows += [moving, still(leg.goal, rest)]
            q = leg.goal
        return np.concatenate(rows)

    def _law(self, length: float, speed: float) -> float:
        """Duration of a leg, s."""
        if self._format == "waypoints":
            return Trapezoid(length, speed, self._acceleration).duration
        # So long that acceleration and the filter's sawtooth together, b / T^2 + c / T, stay below the limit all along.
        b, c = length * _QUINTIC_ACCELERATION, 0.5 * GAIN * _TICK * length * _QUINTIC_RATE
        a = self._acceleration
        return max(1.875 * length / speed, float(((c + np.sqrt(c**2 + 4.0 * a * b)) / (2.0 * a)).max()))

    def _profile(self, length: float, speed: float, time: np.ndarray) -> np.ndarray:
        """(n, 3) way, rate and acceleration of the leading joint."""
        if self._format == "waypoints":
            return np.stack(Trapezoid(length, speed, self._acceleration).at(time), axis=1)
        duration = self._law(length, speed)
        s = time / duration
        way = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        return length * np.stack([way, _rate(s) / duration, _acceleration(s) / duration**2], axis=1)

    def _room(self, n: int, used: float) -> bool:
        return n < self._slots if self._slots is not None else used < self._budget

    def _fits(self, leg: Leg) -> bool:
        return self._slots is None or leg.duration <= WAIT - self._rest

    def _rate(self, total: Information, legs: list[Leg]) -> float:
        """The value of a tour made as long as there is time: a shorter one leaves room for more legs."""
        if self._slots is not None:
            return self._question.value(total)
        used = sum(leg.duration + self._rest for leg in legs)
        return self._question.value(total.times(self._budget / used)) if used <= self._budget else -np.inf

    def _extended(
        self, start: np.ndarray, legs: list[Leg], progress: Callable[[int], object] | None = None
    ) -> list[Leg]:
        """The legs, and greedily more as long as there is room."""
        legs = list(legs)
        q = legs[-1].goal if legs else start
        used = sum(leg.duration + self._rest for leg in legs)
        total = summed([leg.told for leg in legs]) if legs else None
        while self._room(len(legs), used):
            best: tuple[float, Leg] | None = None
            before = 0.0 if total is None else self._question.value(total)
            for _ in range(_CANDIDATES):
                leg = self._propose(q, nearby=bool(self._rng.random() < _NEARBY))
                cost = 1.0 if self._slots is not None else leg.duration + self._rest
                if self._slots is None and used + cost > self._budget:
                    continue
                gain = (self._question.value(leg.told if total is None else total + leg.told) - before) / cost
                if best is None or gain > best[0]:
                    best = gain, leg
            if best is None:
                break
            leg = best[1]
            legs.append(leg)
            total = leg.told if total is None else total + leg.told
            used += leg.duration + self._rest
            q = leg.goal
            if progress is not None:
                share = used / self._budget if self._slots is None else len(legs) / self._slots
                progress(round(GREEDY * min(share, 1.0)))
        if len(legs) < 2:
            raise IdentificationError(
                "no two legs fit into the time: --speed-limit and --acceleration-limit are too low, or --duration too "
                "short"
            )
        return legs

    def _exchanged(self, start: np.ndarray, legs: list[Leg], k: int) -> list[Leg] | None:
        """The legs with another posture after leg k or another speed of it; None if it cannot be."""
        before = legs[k - 1].goal if k else start
        out = list(legs)
        if self._rng.random() < 0.3:
            out[k] = self.leg(before, legs[k].goal, self._speed())
            return out if self._fits(out[k]) else None
        goal = self._posture(legs[k].goal if self._rng.random() < _NEARBY else None)
        if not self._free(before, goal):
            return None
        out[k] = self.leg(before, goal, self._speed() if self._rng.random() < 0.5 else legs[k].speed)
        if not self._fits(out[k]):
            return None
        if k + 1 < len(legs):
            after = legs[k + 1]
            if not self._free(goal, after.goal):
                return None
            out[k + 1] = self.leg(goal, after.goal, after.speed)
            if not self._fits(out[k + 1]):
                return None
        return out

    def _propose(self, q: np.ndarray, *, nearby: bool, speed: float | None = None) -> Leg:
        """A leg from a posture to somewhere that is free, at some speed.

        Raises:
            IdentificationError: there seems to be none.
        """
        why = "no posture beside it is found"
        for attempt in range(_TRIES):
            # Where far postures are all cut off, near ones may not be.
            goal = self._posture(q if nearby or attempt > _TRIES // 2 else None)
            if np.abs(goal - q).max() < _SHORTEST:
                continue
            problem = self._workspace.way_problem(q, goal)
            if problem is not None:
                why = problem
                continue
            leg = self.leg(q, goal, self._speed() if speed is None else speed)
            if self._fits(leg):
                return leg
            why = f"a leg would take {leg.duration:.1f} s, a waypoint file has {WAIT - self._rest:g} s for each"
        raise IdentificationError(
            f"within these limits the arm has nowhere to go: of {_TRIES} ways from one posture none is allowed (the "
            f"last: {why}); widen the box, the joints' range or the speed limit, or start elsewhere"
        )

    def _posture(self, near: np.ndarray | None) -> np.ndarray:
        low, high = self._bounds.low, self._bounds.high
        if near is None:
            return np.round(self._rng.uniform(low, high), 4)
        reach = self._rng.uniform(*_NEAR)
        chosen = self._rng.random(6) < 0.6
        q = near + np.where(chosen, self._rng.uniform(-reach, reach, 6), 0.0)
        return np.clip(np.round(q, 4), low, high)

    def _speed(self) -> float:
        low, high = self._speeds
        return float(np.round(np.exp(self._rng.uniform(np.log(low), np.log(high))), 4))

    def _free(self, start: np.ndarray, goal: np.ndarray) -> bool:
        if np.abs(goal - start).max() < _SHORTEST:
            return False
        return self._workspace.way_problem(start, goal) is None

    def _tour(self, start: np.ndarray, legs: list[Leg]) -> Tour:
        if not legs:
            raise IdentificationError("no leg fits into the time: give a longer --duration or a higher --speed-limit")
        return Tour(start, tuple(legs), self._question.value(summed([leg.told for leg in legs])))
