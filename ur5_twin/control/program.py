"""What the controller makes of commands: target rows, and a record of which command ran when."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike

from ur5_twin.arm.parameters import N_JOINTS, ArmModel
from ur5_twin.control.blend import Path, blended
from ur5_twin.control.commands import Command, MoveJ, MoveL, Program, Sent, ServoJ, Wait
from ur5_twin.control.limits import check_position
from ur5_twin.control.profile import ticks
from ur5_twin.control.servoj import servoj
from ur5_twin.control.trajectory import require_positive, still
from ur5_twin.errors import TwinError


@dataclass(frozen=True)
class Executed:
    """Command ``index`` of the program ran from ``start`` to ``end``, s."""

    index: int
    command: Command
    start: float
    end: float


@dataclass(frozen=True)
class Ignored:
    """Command ``index`` arrived at ``time``, s, and was dropped in favour of command ``because``."""

    index: int
    command: Command
    time: float
    because: int


@dataclass(frozen=True)
class Reference:
    """The controller's reference motion.

    Attributes:
        rows: (n, 3, 6) q, qd, qdd (rad, rad/s, rad/s^2); row k at k * period, the last one at rest. Where qdd jumps, a
            row has the value from its own time on.
        period: tick, s.
        executed: what ran, in order. A blend's middle parts its two moves.
        ignored: what arrived in vain, in order.

    Raises:
        TwinError: the rows are not (n, 3, 6) with n >= 1, or the period is not positive.
    """

    rows: np.ndarray
    period: float
    executed: tuple[Executed, ...] = ()
    ignored: tuple[Ignored, ...] = ()

    def __post_init__(self) -> None:
        require_positive("reference", period=self.period)
        if self.rows.ndim != 3 or self.rows.shape[1:] != (3, N_JOINTS) or not len(self.rows):
            raise TwinError(f"reference: rows have shape {self.rows.shape}, expected (n, 3, {N_JOINTS})")

    @property
    def time(self) -> np.ndarray:
        """(n,) s: ticks times the period."""
        return np.arange(len(self.rows)) * self.period


def plan(model: ArmModel, q_start: ArrayLike, program: Program | Sent, *, period: float = 0.008) -> Reference:
    """Execute commands as the controller does, from rest.

    A ``Program`` runs its commands one after another; moves with a blend radius that are followed by a move blend, at
    the others the arm comes to rest. ``Sent`` commands are programs of one move each, so their blend radius does not
    count: one that arrives while the arm still moves is ignored, the newest one that arrives after it came to rest runs
    (thesis section 4.4.1). Commands start on ticks.

    Args:
        model: the arm with its limits (the controller's).
        q_start: (6,) joint position at rest, rad.
        program: the commands.
        period: tick, s.

    Returns:
        The reference from time 0 to rest after the last command.

    Raises:
        TwinError: a command asks for what the arm cannot do; the message names the command by its index from 0.
    """
    require_positive("plan", period=period)
    q_start = np.asarray(q_start, dtype=float)
    if q_start.shape != (N_JOINTS,):
        raise TwinError(f"plan: the start has shape {q_start.shape}, expected ({N_JOINTS},)")
    check_position(model.limits, q_start, "plan: start")
    timeline = _Timeline(model, q_start, period)
    return timeline.run(program) if isinstance(program, Program) else timeline.receive(program)


class _Timeline:
    """Rows planned so far; the arm rests at the last of them."""

    def __init__(self, model: ArmModel, q_start: np.ndarray, period: float) -> None:
        self.model, self.period = model, period
        self.parts = [still(q_start, 1)]
        self.tick = 0
        self.executed: list[Executed] = []
        self.ignored: list[Ignored] = []

    @property
    def q(self) -> np.ndarray:
        return self.parts[-1][-1, 0]

    def run(self, program: Program) -> Reference:
        chain: list[tuple[int, MoveJ | MoveL]] = []
        for index, command in enumerate(program.commands):
            if isinstance(command, MoveJ | MoveL):
                chain.append((index, command))
                following = program.commands[index + 1 : index + 2]
                if command.r > 0.0 and following and isinstance(following[0], MoveJ | MoveL):
                    continue
                self.move(chain)
                chain = []
            else:
                self.other(index, command)
        return self.reference()

    def receive(self, sent: Sent) -> Reference:
        arrivals = [
            (ticks(time, self.period), index, command)
            for index, (time, command) in enumerate(zip(sent.times, sent.commands, strict=True))
        ]
        for tick, group in groupby(arrivals, key=lambda arrival: arrival[0]):
            *older, (_, index, command) = group
            moving = tick < self.tick
            running = self.executed[-1].index if moving else index
            dropped = [*older, (tick, index, command)] if moving else older
            self.ignored += [Ignored(i, one, sent.times[i], running) for _, i, one in dropped]
            if moving:
                continue
            self.stand(tick - self.tick)
            if isinstance(command, ServoJ):
                self.other(index, command)
            else:
                self.move([(index, command)])
        return self.reference()

    def move(self, chain: list[tuple[int, MoveJ | MoveL]]) -> None:
        names = [_label(index, command) for index, command in chain]
        path: Path = blended(self.model, self.q, [move for _, move in chain], period=self.period, names=names)
        begin = self.tick * self.period
        self.executed += [
            Executed(index, move, begin + float(start), begin + float(end))
            for (index, move), start, end in zip(chain, path.times[:-1], path.times[1:], strict=True)
        ]
        self.add(path.rows)

    def other(self, index: int, command: ServoJ | Wait) -> None:
        begin = self.tick
        if isinstance(command, Wait):
            self.stand(ticks(command.seconds, self.period))
        else:
            self.add(servoj(self.model, self.q, command, period=self.period, name=_label(index, command)))
        self.executed.append(Executed(index, command, begin * self.period, self.tick * self.period))

    def stand(self, n: int) -> None:
        self.add(still(self.q, n + 1))

    def add(self, rows: np.ndarray) -> None:
        """Rows whose first one is at the current tick: it takes the place of the last row."""
        self.parts[-1] = self.parts[-1][:-1]
        self.parts.append(rows)
        self.tick += len(rows) - 1

    def reference(self) -> Reference:
        rows = np.concatenate(self.parts)
        return Reference(rows, self.period, tuple(self.executed), tuple(self.ignored))


def _label(index: int, command: Command) -> str:
    return f"command {index} ({command.name})"
