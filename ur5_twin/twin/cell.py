"""The robot cell in lockstep: the arm under its controller, what stands around it, what pushes it, tick by tick.

A cell takes target rows and gives back the truth. Who makes the targets (a scenario's program, somebody's own loop) and
what sensors make of the truth is not its business. Row k of a piece holds the state at tick k, when the target of row k
is reached; the command of row k holds until tick k + 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import mujoco
import numpy as np

from ur5_twin.arm import inertia
from ur5_twin.arm.drive import JointDrives
from ur5_twin.arm.mjcf.obstacles import Obstacle
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.control.gains import Gains
from ur5_twin.control.target_current import TargetCurrentLaw
from ur5_twin.control.trajectory import stop
from ur5_twin.errors import ScenarioError, SimulationError
from ur5_twin.twin import _loop_kernel as kernel
from ur5_twin.twin.closed_loop import NOBODY, REST, SUBSTEP, ClosedLoop, Ending, Limits

#: The tick of a CB series' controller, s: 125 Hz.
PERIOD = 0.008
#: Deeper in an obstacle than this an arm does not start, m: the touch of a contact that is meant is less.
_START_DEPTH = 1e-3
#: Joint acceleration of a protective stop, rad/s^2: the small joints' limit of thesis table 4.1 leaves room.
_BRAKING = 15.0
#: A stopped arm that is pushed this far from where it stopped is held by nothing, rad.
_OVERPOWERED = 0.5
_STOPS = (kernel.DEVIATION, kernel.SPEED, kernel.FORCE)


class Push(Protocol):
    """A wrench on one of the arm's bodies.

    Attributes:
        body: the body's name in MuJoCo (``mjcf.BODY_NAMES`` or ``tool``).
        point: (3,) where, in the body's frame, m.
        turning: given in the body's axes, and turning with it; otherwise in the base's.
    """

    @property
    def body(self) -> str: ...

    @property
    def point(self) -> np.ndarray: ...

    @property
    def turning(self) -> bool: ...

    def acts_within(self, start: float, end: float) -> bool:
        """False if it is nothing throughout, from ``start`` to ``end``, s."""
        ...

    def wrench(self, time: np.ndarray) -> np.ndarray:
        """(n, 6) force and moment about the point, N and Nm, at times (n,) s."""
        ...


@dataclass(frozen=True)
class Payload:
    """Something that hangs on the flange from a time on.

    Attributes:
        at: s.
        mass: kg; 0 puts it down again.
        center: (3,) in the flange frame, m.
        inertia: (3, 3) about its centre in the flange's axes, kg m^2.
    """

    at: float
    mass: float
    center: np.ndarray
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))


#: An empty flange.
NOTHING = Payload(0.0, 0.0, np.zeros(3))


@dataclass(frozen=True)
class Setup:
    """What a cell is made of.

    Attributes:
        controller: the model the controller linearises with, the tool it was told of included.
        plant: the model that is simulated.
        gains, law: the controller's servo, torque constants and friction feed-forward.
        drives: the plant's motors and gears.
        limits: when the controller makes a protective stop.
        q_start: (6,) rad.
        obstacles: what stands around the arm.
        pushes: wrenches on the arm's bodies.
        payloads: what the arm picks up and puts down, in order of time.
        told: the controller's model from a time on, s, in order of time: what set_payload does.
        warm_for: s of motion before the run; infinite for drives that are warm through.
        period: the controller's tick, s; whole physics steps go into one.
    """

    controller: ArmModel
    plant: ArmModel
    gains: Gains
    law: TargetCurrentLaw
    drives: JointDrives
    limits: Limits
    q_start: np.ndarray
    obstacles: tuple[Obstacle, ...] = ()
    pushes: tuple[Push, ...] = ()
    payloads: tuple[Payload, ...] = ()
    told: tuple[tuple[float, ArmModel], ...] = ()
    warm_for: float = np.inf
    period: float = PERIOD


@dataclass(frozen=True)
class Piece:
    """Some ticks of a run.

    Attributes:
        first_tick: number of the first.
        targets: (n, 3, 6) target of each tick: q, qd, qdd.
        trace: the truth at each physics step of these ticks.
        steps: physics steps in a tick.
        controller: the model that the controller linearised with.
        payload: what the arm carried beside its tool.
        stopped: for each tick, whether a protective stop had been made (n,).
        period: of the ticks, s.
    """

    first_tick: int
    targets: np.ndarray
    trace: kernel.Trace
    steps: int
    controller: ArmModel
    payload: Payload
    stopped: np.ndarray
    period: float = PERIOD

    @property
    def time(self) -> np.ndarray:
        """(n,) s."""
        return (self.first_tick + np.arange(len(self.targets))) * self.period


class Cell:
    """The cell. It stands at its start after it is made, and again after ``reset``.

    Args:
        setup: what it is made of.

    Attributes:
        tick: number of the tick it stands at.
        target: (3, 6) the controller's target there.
        stop_reason: why the controller made a protective stop, with the time; None if it did not.
        stop_tick: when, a tick; None if it did not.
        failure: why the simulation cannot go on, with the time; None if it can.
        geoms: names of the model's geoms, for ``Trace.contact_geoms``.

    Raises:
        ScenarioError: the arm starts inside something.
    """

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self._loop = ClosedLoop(
            setup.controller,
            setup.plant,
            setup.gains,
            SUBSTEP,
            set_over=False,
            law=setup.law,
            drives=setup.drives,
            limits=setup.limits,
            obstacles=setup.obstacles,
            payload=bool(setup.payloads),
        )
        self._period = setup.period
        self._steps = round(self._period / SUBSTEP)
        model = self._loop.model
        self.geoms = tuple(model.geom(i).name for i in range(model.ngeom))
        self._push_bodies = np.array([self._loop.body(push.body) for push in setup.pushes], dtype=np.int64)
        self._push_points = np.array([push.point for push in setup.pushes], dtype=float).reshape(-1, 3)
        self._push_turning = np.array([push.turning for push in setup.pushes], dtype=np.int64)
        self._changes = sorted(
            {round(at / self._period) for at in (*(p.at for p in setup.payloads), *(at for at, _ in setup.told))}
        )
        self.reset()

    @property
    def model(self) -> mujoco.MjModel:
        return self._loop.model

    @property
    def data(self) -> mujoco.MjData:
        return self._loop.data

    def reset(self) -> None:
        """Put the arm at its start, at rest, with everything as it was at first."""
        self.tick = 0
        self.stop_reason: str | None = None
        self.stop_tick: int | None = None
        self.failure: str | None = None
        self._halt: Iterator[np.ndarray] | None = None
        self._controller = self.setup.controller
        self._payload = NOTHING
        self.target = np.stack([self.setup.q_start, np.zeros(6), np.zeros(6)])
        loop = self._loop
        if self.setup.payloads:
            loop.carry(0.0, np.zeros(3), np.zeros((3, 3)))
        loop.tell_payload(self._controller)
        loop.with_limits(Limits())
        loop.reset(self.setup.q_start, np.zeros(6))
        self._check_start()
        loop.hold(self.target, REST)
        loop.with_limits(self.setup.limits)

    def advance(self, targets: np.ndarray, *, to_stop: bool = False) -> list[Piece]:
        """Go on through target rows (n, 3, 6), one a tick, from the target the cell stands at.

        After a protective stop the arm brakes and holds whatever the targets say. A cell that has failed stays where it
        is.

        Args:
            targets: in rad, rad/s and rad/s^2.
            to_stop: come back where the controller makes a protective stop, before the targets are through.

        Returns:
            The ticks that were done, in one piece or, where the controller's model changed or it stopped, several.
        """
        pieces: list[Piece] = []
        done = 0
        running = self.stop_tick is None
        while done < len(targets) and self.failure is None:
            end = done + self._until_next_change(len(targets) - done)
            rows = targets[done:end] if self._halt is None else np.stack([next(self._halt) for _ in range(end - done)])
            piece = self._run(rows)
            if len(piece.targets):
                pieces.append(piece)
            done += len(piece.targets)
            if to_stop and running and self.stop_tick is not None:
                break
        return pieces

    def stop(self, why: str) -> None:
        """Make a protective stop at this tick, for a reason of somebody else's."""
        if self.stop_tick is None:
            self._stop(f"at {self.tick * self._period:.3f} s {why}")

    def release(self) -> None:
        """End a protective stop: from here on targets count again, and the limits.

        The target is where the arm is: what it presses on, it no longer presses on.

        Raises:
            SimulationError: the arm still brakes.
        """
        if self.stop_tick is None:
            return
        if self.target[1:].any():
            raise SimulationError(f"the arm still brakes ({self.stop_reason})")
        self.stop_reason, self.stop_tick, self._halt = None, None, None
        self.target = np.stack([self._loop.relax(), np.zeros(6), np.zeros(6)])
        self._loop.with_limits(self.setup.limits)

    def tell(self, controller: ArmModel) -> None:
        """Replace the model that the controller linearises with from this tick on, as set_payload does."""
        self._controller = controller
        self._loop.tell_payload(controller)

    def _run(self, rows: np.ndarray) -> Piece:
        n = len(rows)
        self._change()
        through = np.concatenate([self.target[None], rows])
        trace, ending = self._loop.run(
            through,
            np.full(n, self._period),
            start=self.tick * self._period,
            pushes=self._pushes(n),
            viscous_scale=self._warmth(n),
        )
        kept = ending.ticks
        # From whole numbers, so that the times do not depend on how a run is cut.
        time = (self.tick * self._steps + np.arange(len(trace.time))) * SUBSTEP
        trace = trace._replace(time=time)
        was_stopped = np.full(kept, self.stop_reason is not None)
        piece = Piece(
            self.tick, through[:kept], trace, self._steps, self._controller, self._payload, was_stopped, self._period
        )
        self.tick += kept
        self.target = through[kept]
        if not ending.complete:
            self._end(ending)
        return piece

    def _end(self, ending: Ending) -> None:
        """The controller stops the arm, or the simulation has come to its end."""
        said = f"at {self.tick * self._period:.3f} s {self._loop.explain(ending)}"
        if ending.why in _STOPS and self.stop_reason is None:
            self._stop(said)
        elif ending.why == kernel.DEVIATION:
            self.failure = (
                f"at {self.tick * self._period:.3f} s something overpowers the stopped arm: joint {ending.joint + 1} "
                f"is pushed {_OVERPOWERED:g} rad away ({self.stop_reason})"
            )
        else:
            self.failure = said

    def _stop(self, said: str) -> None:
        self.stop_reason = f"protective stop {said}"
        self.stop_tick = self.tick
        self._halt = _halting(self.target, self._period)
        self._loop.with_limits(Limits(deviation=_OVERPOWERED))

    def _until_next_change(self, n: int) -> int:
        ahead = [tick - self.tick for tick in self._changes if tick > self.tick]
        return min([n, *ahead])

    def _change(self) -> None:
        """Payloads and what the controller is told of them, where they are due."""
        if self.tick not in self._changes:
            return
        for payload in self.setup.payloads:
            if round(payload.at / self._period) == self.tick:
                self._payload = payload
                self._loop.carry(payload.mass, payload.center, payload.inertia)
        for at, controller in self.setup.told:
            if round(at / self._period) == self.tick:
                self._controller = controller
                self._loop.tell_payload(controller)

    def _pushes(self, n: int) -> kernel.Pushes:
        """The pushes that act within the next n ticks."""
        # What acted before and does not now must not stay.
        self.data.xfrc_applied[:] = 0.0
        start, end = self.tick * self._period, (self.tick + n) * self._period
        acting = [i for i, push in enumerate(self.setup.pushes) if push.acts_within(start, end)]
        if not acting:
            return NOBODY
        time = (self.tick * self._steps + np.arange(n * self._steps)) * SUBSTEP
        wrench = np.stack([self.setup.pushes[i].wrench(time) for i in acting], axis=1)
        return kernel.Pushes(
            self._push_bodies[acting],
            self._push_points[acting],
            self._push_turning[acting],
            np.ascontiguousarray(wrench),
        )

    def _warmth(self, n: int) -> np.ndarray:
        scale = self.setup.drives.friction.viscous_scale((self.tick + np.arange(n)) * self._period, self.setup.warm_for)
        return np.repeat(scale, 6).reshape(n, 6)

    def _check_start(self) -> None:
        model, data = self.model, self.data
        data.qvel[:] = 0.0
        mujoco.mj_forward(model, data)
        deepest = min(range(data.ncon), key=lambda i: data.contact[i].dist, default=None)
        if deepest is None or data.contact[deepest].dist > -_START_DEPTH:
            return
        contact = data.contact[deepest]
        bodies = [model.body(model.geom_bodyid[geom]).name for geom in contact.geom]
        names = [self.geoms[g] if body == "world" else body for g, body in zip(contact.geom, bodies, strict=True)]
        raise ScenarioError(
            f"the arm starts inside something: {names[0]} and {names[1]} overlap by {-contact.dist * 1e3:.1f} mm at "
            "0.000 s; move one of them"
        )


def _halting(target: np.ndarray, period: float) -> Iterator[np.ndarray]:
    """Target rows of a protective stop from a target (3, 6) on, for ever."""
    rows = stop(target[0], target[1], deceleration=_BRAKING, period=period)
    yield from rows[1:]
    while True:
        yield np.stack([rows[-1, 0], np.zeros(6), np.zeros(6)])


def loaded(beyond: tuple[float, np.ndarray, np.ndarray], payload: Payload) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre and tensor about it of something at the flange and a payload together, in the flange frame."""
    if payload.mass == 0.0:
        return beyond
    if beyond[0] == 0.0:
        return payload.mass, payload.center, payload.inertia
    return inertia.combine(
        np.array([beyond[0], payload.mass]),
        np.array([beyond[1], payload.center]),
        np.array([beyond[2], payload.inertia]),
    )


def concatenate(traces: Sequence[kernel.Trace]) -> kernel.Trace:
    """Traces of consecutive pieces as one; the contacts' rows are counted on."""
    shift = np.cumsum([0, *(len(trace.time) for trace in traces[:-1])])
    joined = {name: np.concatenate([getattr(trace, name) for trace in traces]) for name in kernel.Trace._fields}
    joined["contact_row"] = np.concatenate(
        [trace.contact_row + start for trace, start in zip(traces, shift, strict=True)]
    )
    return kernel.Trace(**joined)
