"""The arm's plant from measured motion and currents: rotor inertia, torque constant, friction and ripple of each joint.

    k i = tau_link(q, qd, qdd) + J_r qdd + level sgn(qd) + viscous w qd + ripple(q) - b
    level = coulomb(+/-) + load |tau_link| + stribeck exp(-(qd / v_s)^2),    ripple = sum of A cos(n q + phi)

linear in 1/k and the other numbers over k but for v_s, which is sought beside it (variable projection). tau_link is
that of the given links, whose masses set the scale; ``plant_windows`` has the columns, ``plant_solve`` the least
squares. None of J_r, coulomb, load, viscous and friction at standstill is negative. Where the current is reported late,
all joints have one delay, the least that fits.

Intervals are those of least squares with errors that are correlated within a second (a sandwich over blocks, Student's
t with a block a degree of freedom), carried to the numbers of the law by their derivatives. They contain what windows
bias (``plant_solve``) beside the noise, not a law that is wrong.

Torque constant and rotor inertia of a joint come apart only where the links' torque is not in step with the joint's own
acceleration: by gravity, or by an inertia that changes. Where they do not (joint 6 with nothing off its axis) the rotor
inertia is taken as known, since a controller says its own in target_moment (``identify controller``), and the result
says so.

Something unknown on the flange may be sought beside all this (``plant_payload``): joints and payload are then fitted in
turn until neither changes, and the intervals of both contain what the other leaves open. Those of the payload contain
that the links' masses are known to 5 % only; the joints' numbers are those beside the masses as given, as ever.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ur5_twin.arm.drive import JointDrives, Ripple
from ur5_twin.arm.parameters import N_JOINTS
from ur5_twin.errors import IdentificationError, unknown
from ur5_twin.identification.body import Body
from ur5_twin.identification.load import Load
from ur5_twin.identification.plant_payload import Step, step
from ur5_twin.identification.plant_solve import FADING, FIELDS, Shared, Solution, solve, unexplained
from ur5_twin.identification.plant_windows import LONG, SLOWEST, Motion, Shape, Windows, windows

#: Least time that a joint must slide in all, s.
LEAST_SLIDING = 8.0
#: Half width of an interval, over the value, beyond which torque constant and inertia are not told.
_TOLD, _TOLD_INERTIA = 0.15, 0.3
#: Correlation of the two beyond which an interval is that of a law that is exact, which none is.
_ENTANGLED = 0.98
#: The same for load-dependent friction, Nm/Nm, and for what fades, in shares of Coulomb friction.
_TOLD_LOAD, _TOLD_FADING = 0.08, 1.0
#: s in windows of slow motion (rad/s) from which on friction's fading is sought.
_SLOW, _LEAST_SLOW = 0.1, 1.6
#: Speeds over that of the fading beyond which 0.2 % of it is left.
_WITHOUT_FADING = 2.5
_TICK = 0.008
#: Turns of payload and joints: each takes what is left to a tenth or less.
_ROUNDS = 12
#: Mean square below which a current is explained to rounding, A^2.
_NOTHING = 1e-12
#: Delays of the current that are tried, s.
_DELAYS = tuple(0.001 * k for k in range(9))


@dataclass(frozen=True)
class PlantFit:
    """What the logs tell of the plant.

    Attributes:
        values: field (``FIELDS``) -> (6,).
        low, high: field -> (6,) ends of the 95 % intervals; NaN where a number was taken as known.
        known: field -> (6,) whether it was taken as known.
        condition: (6,) condition number of each joint's columns, scaled to length 1, with all numbers free.
        entangled: (6,) correlation of torque constant and rotor inertia with all numbers free.
        order: (n_orders,) of the ripple.
        amplitude, phase, amplitude_error: (n_orders, 6) Nm, rad and standard error in Nm.
        delay: of the currents, s.
        sliding: (6,) s that each joint slides in all.
        left: (6,) A, standard deviation of what the law leaves of the window means.
        notes: what could not be told, in words.
        payload: what hangs on the flange beyond what was known of; None if it was not sought.
    """

    values: Mapping[str, np.ndarray]
    low: Mapping[str, np.ndarray]
    high: Mapping[str, np.ndarray]
    known: Mapping[str, np.ndarray]
    condition: np.ndarray
    entangled: np.ndarray
    order: np.ndarray
    amplitude: np.ndarray
    phase: np.ndarray
    amplitude_error: np.ndarray
    delay: float
    sliding: np.ndarray
    left: np.ndarray
    notes: tuple[str, ...]
    payload: Load | None = None

    @property
    def carried(self) -> Body | None:
        """The payload as the other numbers take it: None where it was not sought or is not told from none."""
        return self.payload.body if self.payload is not None and self.payload.found else None

    def loaded(self, of: Motion) -> Motion:
        """A motion with what hung on the flange in it, as far as it was found."""
        return of if self.carried is None else of.carrying(self.carried.phi)

    def drives(self, base: JointDrives, source: str) -> JointDrives:
        """Motors and gears with the fitted numbers; offset, presliding and warming are those of ``base``."""
        numbers = {name: self.values[name] for name in tuple(FIELDS)[2:]}
        return JointDrives(
            torque_constant=self.values["torque_constant"],
            offset=base.offset,
            friction=replace(base.friction, **numbers, source=source),
            ripple=Ripple(self.order, self.amplitude, self.phase),
            source=source,
        )


def fit_plant(
    motions: Sequence[Motion],
    base: JointDrives,
    rotor_inertia: np.ndarray,
    known: Mapping[str, np.ndarray] | None = None,
    progress: Callable[[int], object] | None = None,
) -> PlantFit:
    """The plant's numbers from logs of free motion.

    Args:
        motions: ``plant_windows.motion`` of the logs; if made with ``payload`` that is sought too.
        base: numbers that are taken where the logs do not tell them; its ripple's orders are those that are fitted.
        rotor_inertia: (6,) kg m^2, likewise.
        known: field -> (6,) numbers to be taken as known; NaN: fitted.
        progress: called with the number of joints done.

    Raises:
        IdentificationError: a joint slides for less than ``LEAST_SLIDING`` or in one direction only, or ``known`` has a
            name that is none.
    """
    for name in known or {}:
        if name not in FIELDS:
            raise IdentificationError(unknown("known field", name, FIELDS))
    given = {name: np.full(N_JOINTS, np.nan) for name in FIELDS} | dict(known or {})
    usual = {name: getattr(base.friction, name) for name in tuple(FIELDS)[2:]}
    usual |= {"torque_constant": base.torque_constant, "rotor_inertia": rotor_inertia}
    _check(motions)
    carried, notes = None, _silent(motions)
    if all(one.sought.shape[-1] for one in motions):
        carried = _Carried.sought(motions, base, given, usual)
        delay = _delay([one.carrying(carried.step.numbers) for one in motions], base)
        late = [one.late(delay) for one in motions]
        carried = _Carried.sought(late, base, given, usual, carried.step.numbers)
        if carried.body is not None:
            late = [one.carrying(carried.body.phi) for one in late]
            notes.extend(_doubt(carried.load))
        else:
            notes.append("the mass at the flange cannot be told from none at 95 %, and counts as none")
    else:
        delay = _delay(motions, base)
        late = [one.late(delay) for one in motions]
    joints: list[_Joint] = []
    for j in range(N_JOINTS):
        w = _windows(late, j, base)
        shared = None if carried is None or carried.body is None else carried.shared(w, j)
        joints.append(_joint(w, j, given, usual, shared))
        if progress is not None:
            progress(j + 1)
    solved = [joint.solved for joint in joints]

    def each(what: str) -> dict[str, np.ndarray]:
        return {name: np.array([getattr(one, what)[name] for one in solved]) for name in FIELDS}

    return PlantFit(
        values=each("values"),
        low=each("low"),
        high=each("high"),
        known=dict(zip(FIELDS, np.array([joint.known for joint in joints]).T, strict=True)),
        condition=np.array([joint.condition for joint in joints]),
        entangled=np.array([joint.entangled for joint in joints]),
        order=base.ripple.order,
        amplitude=np.stack([one.amplitude for one in solved], axis=1),
        phase=np.stack([one.phase for one in solved], axis=1),
        amplitude_error=np.stack([one.amplitude_error for one in solved], axis=1),
        delay=delay,
        sliding=sliding(late),
        left=np.array([one.left for one in solved]),
        notes=(*notes, *(note for joint in joints for note in joint.notes)),
        payload=None if carried is None else carried.load,
    )


def _doubt(load: Load) -> list[str]:
    """A sentence if a payload is where none can hang."""
    center, std = load.center
    if center[2] + 2.0 * std[2] > 0.0:
        return []
    return [
        "the payload's centre is behind the flange, where nothing can hang: its weight is what the law leaves of the "
        "arm's own; give logs without the payload (--bare)"
    ]


def _windows(motions: Sequence[Motion], j: int, base: JointDrives, shape: Shape | None = None) -> Windows:
    w = windows(motions, j, base.ripple.order.tolist(), shape)
    return replace(w, link=w.link - base.offset[j])


def _silent(motions: Sequence[Motion]) -> list[str]:
    """A sentence for each log that has not a single window."""
    return [
        f"{one.source} counts for nothing: it misses rows, and has no 0.15 s without a gap"
        for one in motions
        if not (one.joined[:, None] & (np.abs(one.qd) > SLOWEST)).any()
    ]


def sliding(motions: Sequence[Motion]) -> np.ndarray:
    """(6,) s of motion, within windows, of each joint in all logs."""
    return np.array([_seconds(windows(motions, j, ())) for j in range(N_JOINTS)])


def _seconds(w: Windows) -> float:
    return len(w.speed) * w.shape.hop * _TICK


def _check(motions: Sequence[Motion]) -> None:
    names = ", ".join(one.source for one in motions) or "no logs"
    short, one_way = [], []
    for j in range(N_JOINTS):
        w = windows(motions, j, (), LONG)
        if _seconds(w) < LEAST_SLIDING:
            short.append(f"joint {j + 1} ({_seconds(w):.1f} s)")
        elif min((w.speed > 0).sum(), (w.speed < 0).sum()) < LONG.length:
            one_way.append(str(j + 1))
    if short:
        raise IdentificationError(
            f"too little motion in {names}: each joint must turn for {LEAST_SLIDING:.0f} s in all (actual_qd beyond "
            f"0.03 rad/s for longer than 0.15 s at a time); too short: {', '.join(short)}; 60 s of movej in all joints "
            "will do"
        )
    if one_way:
        raise IdentificationError(
            f"{names}: actual_qd of joint {', '.join(one_way)} has one direction only; move it there and back, since "
            "friction depends on the direction"
        )


@dataclass(frozen=True)
class _Joint:
    """One joint's part of ``PlantFit``: the last solution, and of the first one what all numbers free would leave."""

    windows: Windows
    solved: Solution
    condition: float
    entangled: float
    known: np.ndarray
    notes: tuple[str, ...]


def _joint(
    w: Windows, j: int, given: Mapping[str, np.ndarray], usual: Mapping[str, np.ndarray], shared: Shared | None = None
) -> _Joint:
    """Fit with all numbers free, take as known what that does not tell, fit again."""
    known = {name: float(values[j]) for name, values in given.items() if not np.isnan(values[j])}
    notes = []

    def take(names: Sequence[str], because: str) -> Solution:
        nonlocal w, shared
        if "stribeck" in names:
            fast = _fast(w, float(usual["stribeck_speed"][j]))
            w, shared = w.at(fast), None if shared is None else shared.at(fast)
        for name in names:
            if name not in known:
                known[name] = float(usual[name][j])
                said = f"{known[name]:.4g} {FIELDS[name]}"
                notes.append(f"joint {j + 1}: {name} is not told and taken as known, {said}: {because}")
        return solve(w, known, shared)

    slow = _seconds(w.at(np.abs(w.speed) < _SLOW))
    if "stribeck" in known or slow < _LEAST_SLOW:
        first = now = take(("stribeck", "stribeck_speed"), f"{slow:.1f} s of slow motion")
    else:
        first = now = solve(w, known, shared)
    if now.half("load") > _TOLD_LOAD:
        now = take(("load",), f"its 95 % interval is +-{now.half('load'):.2g}, the links' torque changes too little")
    if now.half("stribeck") > _TOLD_FADING * 0.5 * (now.values["coulomb_positive"] + now.values["coulomb_negative"]):
        now = take(("stribeck", "stribeck_speed"), f"its 95 % interval is +-{now.half('stribeck'):.2g} Nm")
    elif now.half("stribeck_speed") > now.values["stribeck_speed"] or abs(now.values["stribeck"]) < now.half(
        "stribeck"
    ):
        now = take(("stribeck_speed",), f"{now.values['stribeck']:.2g} Nm are too little that fades")
    elif not 1.02 * FADING[0] < now.values["stribeck_speed"] < 0.98 * FADING[1]:
        # At an end of where it is sought, it makes up for something else.
        now = take(("stribeck_speed",), f"it fits best at {now.values['stribeck_speed']:.2g} rad/s, if not beyond")
    for name in ("rotor_inertia", "torque_constant"):
        share = now.half("torque_constant") / now.values["torque_constant"]
        if share > _TOLD or abs(now.entangled) > _ENTANGLED:
            said = f"otherwise the interval of torque_constant is +-{100 * share:.0f} %"
            now = take((name,), f"{said}, and its correlation with rotor_inertia {now.entangled:.4f}")
    share = now.half("rotor_inertia") / max(now.values["rotor_inertia"], 1e-9)
    if share > _TOLD_INERTIA:
        now = take(("rotor_inertia",), f"its interval is +-{100 * share:.0f} %, the joint accelerates too little")
    known_of = np.array([name in known for name in FIELDS])
    return _Joint(w, now, first.condition, first.entangled, known_of, tuple(notes))


def _fast(w: Windows, speed: float) -> np.ndarray:
    """(n,) the windows in which nothing fades any more, so that fading taken as known does no harm; all if few are."""
    fast = np.abs(w.rows).min(axis=1) > _WITHOUT_FADING * speed
    return fast if fast.mean() > 0.5 else np.ones(len(fast), dtype=bool)


@dataclass(frozen=True)
class _Carried:
    """A payload, and the joints' own numbers beside it."""

    step: Step
    joints: Sequence[_Joint]

    @cached_property
    def load(self) -> Load:
        return self.step.load

    @property
    def body(self) -> Body | None:
        """What the joints' numbers take for carried: None if the mass is not told from none."""
        return self.load.body if self.load.found else None

    def shared(self, w: Windows, j: int) -> Shared:
        """What the payload's error means for a joint."""
        return self.step.shared(w, self.joints[j].solved)

    @classmethod
    def sought(
        cls,
        motions: Sequence[Motion],
        base: JointDrives,
        given: Mapping[str, np.ndarray],
        usual: Mapping[str, np.ndarray],
        numbers: np.ndarray | None = None,
    ) -> _Carried:
        """Payload and joints in turn, from an estimate or from the base's numbers for the joints.

        Weight changes slowly, so that short windows tell no more of it, and folded ripple can pass for it.
        """
        if numbers is None:
            joints = []
            for j in range(N_JOINTS):
                w = _windows(motions, j, base, LONG)
                joints.append((w, solve(w, {name: float(values[j]) for name, values in usual.items()})))
            numbers = step(np.zeros(motions[0].sought.shape[-1]), joints).numbers
        for _ in range(_ROUNDS):
            carrying = [one.carrying(numbers) for one in motions]
            joints = [_joint(_windows(carrying, j, base, LONG), j, given, usual) for j in range(N_JOINTS)]
            now = step(numbers, [(joint.windows, joint.solved) for joint in joints])
            numbers = now.numbers
            if now.done:
                break
        return cls(now, joints)


def _delay(motions: Sequence[Motion], base: JointDrives) -> float:
    """s by which the currents are late: the least that the currents do not speak against, all joints together.

    n log(sum of squares) is twice the negative logarithm of the likelihood; windows overlap, so it takes as many times
    chi-squared's 3.84. Long windows of all joints: in short ones ripple that is folded down decides.
    """
    orders = base.ripple.order.tolist()
    # The number of windows changes a little with the delay, and must not decide.
    count = [len(windows(motions, j, (), LONG).speed) for j in range(N_JOINTS)]

    def left(delay: float) -> float:
        late = [one.late(delay) for one in motions]
        cost = 0.0
        for j in range(N_JOINTS):
            w = windows(late, j, orders, LONG)
            mean = unexplained(w, float(base.friction.stribeck_speed[j])) / len(w.speed)
            cost += count[j] * np.log(max(mean, _NOTHING))
        return cost

    costs = [left(delay) for delay in _DELAYS]
    enough = min(costs) + 3.84 * LONG.length / LONG.hop
    return next(delay for delay, cost in zip(_DELAYS, costs, strict=True) if cost <= enough)
