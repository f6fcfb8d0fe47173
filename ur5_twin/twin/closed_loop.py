"""The simulated arm under the controller, from Python: ``_loop_kernel`` with everything it needs built once.

MuJoCo advances velocity before position, so that the velocity it holds belongs to the middle of the last step; read
as such (leapfrog), a step is accurate to second order in its length. ``qvel`` therefore begins half a step back, stays
there from step to step and tick to tick, and velocities that leave this module are carried half a step forward.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from ur5_twin.arm import friction, mjcf
from ur5_twin.arm.drive import NO_RIPPLE, JointDrives
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.friction import FRICTIONLESS
from ur5_twin.arm.mjcf.obstacles import Obstacle
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.arm.parameters import Limits as JointLimits
from ur5_twin.control import computed_torque
from ur5_twin.control.gains import Gains
from ur5_twin.control.target_current import TargetCurrentLaw
from ur5_twin.control.tcp_force import load_tcp_force_law
from ur5_twin.errors import SimulationError
from ur5_twin.twin import _loop_kernel as kernel
from ur5_twin.twin import engine
from ur5_twin.twin.sample import Prediction

#: Longest physics step, s. The wrist's inertia without rotors is 1e-4 kg m^2; MuJoCo's own default is the same.
SUBSTEP = 0.002
#: An arm with drives holds its start for as long before anything begins, s.
REST = 1.0
#: A step of a joint's target that no log of a sound robot has, rad.
_IMPOSSIBLE_STEP = 0.1
#: Rows for contacts per physics step on average; a run that needs more is cut into shorter ones by its caller.
_CONTACTS_PER_STEP = 8
#: Ticks while the arm is held, s.
_HOLDING = 0.008
#: No pushes.
NOBODY = kernel.Pushes(np.zeros(0, int), np.zeros((0, 3)), np.zeros(0, int), np.zeros((0, 0, 6)))


@dataclass(frozen=True)
class Limits:
    """When the controller makes a protective stop; infinity switches a limit off.

    Attributes:
        deviation: of a joint from its target, rad.
        speed: of a joint over the arm's limit, as a factor.
        force: of the controller's own estimate at the flange, N.
    """

    deviation: float = math.inf
    speed: float = math.inf
    force: float = math.inf


class ClosedLoop:
    """The simulated arm under the controller: feedback linearisation with a servo (thesis equation 2.80).

    tau = M(q) a + C(q, qd) qd + g(q),  a = qdd_d - K0 e - K1 e' - KI int(e) dt

    with M, C and g of the controller's model, which need not be the plant's. Between two samples the reference goes on
    from one target to the next (``control.computed_torque.reference``). Where a target steps instead of moving, as it
    does when a move ends, the arm is set over by the same step, so that its tracking error stays what it was: no motor
    could follow, and the thesis' soft gains would take seconds to forget it.

    With ``law`` and ``drives`` the controller asks for currents and the plant makes torque of them, less friction;
    without, a motor gives what the controller asks for and no joint rubs.

    Args:
        controller: the model the controller linearises with.
        plant: the model that is simulated.
        gains: K0, K1 and KI.
        substep: longest physics step, s; a tick is divided into as many equal steps as it takes.
        set_over: set the arm over where the target steps; False leaves it to the gains to catch up.
        law: the controller's torque constants and friction feed-forward.
        drives: the plant's motors and gears.
        limits: when the controller stops the arm.
        obstacles: what stands around the arm; None also switches off that the arm can hit itself.
        payload: whether the arm can pick something up (``set_payload``).

    Attributes:
        model, data: MuJoCo's; what the loop does to them shows in them.
        largest_step: (6,) the largest step of each joint's target_q so far, rad.
        largest_qd_step: (6,) the largest step of its target_qd, rad/s.
    """

    def __init__(
        self,
        controller: ArmModel,
        plant: ArmModel,
        gains: Gains,
        substep: float = SUBSTEP,
        *,
        set_over: bool = True,
        law: TargetCurrentLaw | None = None,
        drives: JointDrives | None = None,
        limits: Limits | None = None,
        obstacles: Sequence[Obstacle] | None = None,
        payload: bool = False,
    ) -> None:
        self._substep = substep
        self._limits = controller.limits.torque
        self.model = mjcf.compile(
            plant, collisions=obstacles is not None, obstacles=tuple(obstacles or ()), payload=payload
        )
        # MuJoCo would otherwise put a diverged arm back to zero and go on.
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = mujoco.MjData(self.model)
        self._engine = engine.connect(self.model, self.data)
        self._servo = _servo(controller, gains, law)
        self._drives = _drives(plant, drives)
        self._arm_limits = controller.limits
        self._guard = _guard(controller.limits, limits or Limits(), set_over=set_over)
        self._has_drives = drives is not None
        self._controller, self._plant = Dynamics(controller), Dynamics(plant)
        self._ripple = NO_RIPPLE if drives is None else drives.ripple
        self._state = kernel.State(
            qd=np.zeros(6),
            integral=np.zeros(6),
            deflection=np.zeros(6),
            link_torque=np.zeros(6),
            residual=np.zeros(6),
            largest_step=np.zeros((2, 6)),
        )
        names = {name: i for i, name in enumerate(mjcf.BODY_NAMES, start=1)} | {"tool": 7, "payload": 7}
        self.body_link = np.array([names.get(self.model.body(i).name, 0) for i in range(self.model.nbody)])
        self._flange = self.body(mjcf.BODY_NAMES[-1])
        self._moment = np.zeros(6)
        self._warm = np.ones((1, 6))
        self._one = (np.zeros((2, 3, 6)), np.zeros(1), np.zeros(1, dtype=np.int64), new_trace(8))
        self._just_reset = True

    @property
    def largest_step(self) -> np.ndarray:
        return self._state.largest_step[0]

    @property
    def largest_qd_step(self) -> np.ndarray:
        return self._state.largest_step[1]

    def body(self, name: str) -> int:
        """Number of a body in the engine."""
        return self.model.body(name).id

    def reset(self, q: np.ndarray, qd: np.ndarray) -> None:
        """Put the arm at joint positions ``q`` (6,) rad with velocities ``qd`` (6,) rad/s, its servo without memory."""
        for array in (self._state.integral, self._state.deflection, self._state.link_torque, self._state.residual):
            array[:] = 0.0
        self._state.qd[:] = qd
        self.data.qpos[:6] = q
        self._just_reset = True

    def relax(self) -> np.ndarray:
        """Forget what the servo has built up, and its estimate of the force; (6,) where the joints are, rad."""
        for array in (self._state.integral, self._state.residual):
            array[:] = 0.0
        return self.data.qpos[:6].copy()

    def rest_with(self, current: np.ndarray) -> None:
        """Let the arm stand where it was reset to with a measured current (6,) A: how a move ended stays in its joints.

        The servo's integral is what asks for that current, and friction takes what the links do not need of it, as far
        as it can.
        """
        servo, drives, q = self._servo, self._drives, self.data.qpos[:6].copy()
        asked = servo.torque_constant * current - self._controller.gravity(q)
        acceleration = np.linalg.solve(self._controller.mass_matrix(q), asked)
        self._state.integral[:] = np.where(servo.kappai > 0, -acceleration / np.maximum(servo.kappai, 1e-9), 0.0)
        needed = self._plant.gravity(q)
        given = drives.torque_constant * current + drives.offset - self._ripple.torque(q)
        taken = given - needed
        level = np.where(taken > 0, drives.friction.positive, drives.friction.negative) + drives.friction.stribeck
        level += drives.friction.load * np.abs(needed)
        with np.errstate(divide="ignore", invalid="ignore"):
            deflection = np.clip(taken, -level, level) / drives.friction.stiffness
        self._state.deflection[:] = np.nan_to_num(deflection, posinf=0.0, neginf=0.0)
        self._state.link_torque[:] = needed

    def hold(self, target: np.ndarray, seconds: float) -> None:
        """Let the arm stand at a target (3, 6) until servo and friction are where a rest leaves them.

        Raises:
            SimulationError: it does not hold it.
        """
        n = max(1, round(seconds / _HOLDING))
        _, ending = self.run(np.tile(target, (n + 1, 1, 1)), np.full(n, _HOLDING))
        if not ending.complete:
            raise SimulationError(f"the arm does not hold its start: {self.explain(ending)}")

    @property
    def feels(self) -> bool:
        """Whether it has motors and gears of its own: friction, torque constants that the controller does not know."""
        return self._has_drives

    def tell_payload(self, controller: ArmModel) -> None:
        """Replace the model that the controller linearises with, as set_payload does."""
        self._servo = self._servo._replace(packed=Dynamics(controller).packed)

    def carry(self, mass: float, center: np.ndarray, inertia: np.ndarray) -> None:
        """Hang a payload on the plant's flange; see ``mjcf.set_payload``."""
        mjcf.set_payload(self.model, self.data, mass, center, inertia)

    def run(
        self,
        targets: np.ndarray,
        dt: np.ndarray,
        *,
        start: float = 0.0,
        pushes: kernel.Pushes = NOBODY,
        viscous_scale: np.ndarray | None = None,
    ) -> tuple[kernel.Trace, Ending]:
        """Run through targets.

        Args:
            targets: (n + 1, 3, 6): tick k goes from target k to target k + 1.
            dt: (n,) s.
            start: s, time of the first target.
            pushes: wrenches on bodies, a row for each physics step (``steps_of``).
            viscous_scale: (n, 6) of the drives' temperature; warm if not given.

        Returns:
            The truth at each physics step, and how it ended: the trace is cut where it did.
        """
        steps = self.steps_of(dt)
        trace = new_trace(int(steps.sum()))
        warm = np.ones((len(dt), 6)) if viscous_scale is None else viscous_scale
        done, why, joint, contacts = self._call(targets, np.asarray(dt, float), steps, warm, start, pushes, trace)
        rows = int(steps[:done].sum())
        kept = {name: values[:rows] for name, values in zip(trace._fields[:10], trace, strict=False)}
        contacts = int(np.searchsorted(trace.contact_row[:contacts], rows))
        kept |= {name: getattr(trace, name)[:contacts] for name in trace._fields[10:]}
        return kernel.Trace(**kept), Ending(done, why, joint)

    def steps_of(self, dt: np.ndarray) -> np.ndarray:
        """(n,) physics steps of ticks of length dt (n,) s."""
        return np.maximum(1, np.ceil(np.asarray(dt) / self._substep - 1e-6)).astype(np.int64)

    def advance(self, before: np.ndarray, after: np.ndarray, dt: float, pushes: kernel.Pushes = NOBODY) -> None:
        """Move the arm ``dt`` seconds on while the reference goes from one sample's target (3, 6) to the next one's.

        Raises:
            SimulationError: the target steps further than any arm could, or the simulation diverges.
        """
        targets, length, steps, trace = self._one
        targets[0], targets[1] = before, after
        length[0] = dt
        steps[0] = max(1, math.ceil(dt / self._substep - 1e-6))
        if steps[0] > len(trace.time):
            trace = new_trace(int(steps[0]))
            self._one = (targets, length, steps, trace)
        _, why, joint, _ = self._call(targets, length, steps, self._warm, 0.0, pushes, trace)
        if why != kernel.DONE:
            raise SimulationError(self.explain(Ending(0, why, joint)))

    def push_on_flange(self, before: np.ndarray, after: np.ndarray, dt: float) -> kernel.Pushes:
        """A wrench at the flange in base axes that goes from ``before`` (6,) to ``after`` (6,) within a tick."""
        steps = int(self.steps_of(np.array([dt]))[0])
        share = (np.arange(steps) / steps)[:, None]
        wrench = before + share * (after - before)
        return kernel.Pushes(np.array([self._flange]), np.zeros((1, 3)), np.zeros(1, dtype=np.int64), wrench[:, None])

    def state(self, target: np.ndarray) -> Prediction:
        """The arm's state, and torque and current that the controller asks for in it, with the reference at ``target``.

        The current is in A with ``law`` and ``drives``, otherwise it is the torque in Nm.
        """
        servo, state = self._servo, self._state
        q, qd = self.data.qpos[:6].copy(), state.qd.copy()
        computed_torque.law(
            target,
            q,
            qd,
            servo.kappa0,
            servo.kappa1,
            servo.kappai,
            servo.lag,
            servo.share,
            state.integral,
            servo.packed,
            self._moment,
        )
        current = kernel.current_of(servo, self._drives, target, self._moment)
        np.clip(self._moment, -self._limits, self._limits, out=self._moment)
        return Prediction(q, qd, self._moment.copy(), current)

    def explain(self, ending: Ending) -> str:
        """What ended a run, in words."""
        joint = ending.joint + 1
        if ending.why == kernel.TARGET_STEPS:
            step = self._state.largest_step[0, ending.joint]
            return (
                f"the target of joint {joint} steps by {step:.3g} rad from one sample to the next; "
                "no arm can do that: is it in rad?"
            )
        if ending.why == kernel.DEVIATION:
            return f"joint {joint} is more than {self._guard.deviation:g} rad away from its target"
        if ending.why == kernel.SPEED:
            return f"joint {joint} turns faster than {self._guard.speed[ending.joint]:.3g} rad/s"
        if ending.why == kernel.FORCE:
            return f"the controller's estimate of the force at the flange exceeds {self._guard.force:g} N"
        if ending.why == kernel.CONTACTS_FULL:
            return "the arm touches its cell in more points than a contact can have: does it start inside something?"
        return "the simulation diverged: softer gains, softer contacts or a plant with rotor inertia may help"

    def with_limits(self, limits: Limits) -> None:
        """Replace the limits of the protective stop."""
        self._guard = _guard(self._arm_limits, limits, set_over=self._guard.set_over == 1)

    def _call(
        self,
        targets: np.ndarray,
        dt: np.ndarray,
        steps: np.ndarray,
        viscous_scale: np.ndarray,
        start: float,
        pushes: kernel.Pushes,
        trace: kernel.Trace,
    ) -> tuple[int, int, int, int]:
        if self._just_reset:
            self._settle(targets[0], targets[1], float(dt[0]), int(steps[0]))
        return kernel.run(
            self._engine, self._servo, self._drives, self._state, self._guard, pushes, self.body_link, targets, dt,
            steps, viscous_scale, start, trace,
        )  # fmt: skip

    def _settle(self, before: np.ndarray, after: np.ndarray, dt: float, steps: int) -> None:
        """After a reset: the plant's own acceleration at the first torque, which half a step back needs."""
        self._just_reset = False
        self.data.qacc[:] = 0.0
        self.data.qacc_warmstart[:] = 0.0
        self.data.xfrc_applied[:] = 0.0
        self.data.qvel[:6] = self._state.qd
        torque = np.zeros(6)
        kernel.first_torque(
            self._engine, self._servo, self._drives, self._state, np.ascontiguousarray(before),
            np.ascontiguousarray(after), dt, dt / steps, torque,
        )  # fmt: skip
        mujoco.mj_forward(self.model, self.data)


@dataclass(frozen=True)
class Ending:
    """How a run ended: ticks done, one of the kernel's reasons, the joint it is about."""

    ticks: int
    why: int
    joint: int

    @property
    def complete(self) -> bool:
        return self.why == kernel.DONE


def new_trace(rows: int) -> kernel.Trace:
    """An empty trace for that many physics steps."""
    contacts = _CONTACTS_PER_STEP * rows + 400
    return kernel.Trace(
        np.empty(rows),
        *(np.empty((rows, 6)) for _ in range(9)),
        contact_row=np.empty(contacts, dtype=np.int64),
        contact_geoms=np.empty((contacts, 2), dtype=np.int64),
        contact_link=np.empty(contacts, dtype=np.int64),
        contact_point=np.empty((contacts, 3)),
        contact_force=np.empty((contacts, 3)),
    )


def _servo(controller: ArmModel, gains: Gains, law: TargetCurrentLaw | None) -> kernel.Servo:
    none = np.zeros(6)
    friction_terms = (none, none, none) if law is None else (law.load, law.viscous_driving, law.viscous_backdriven)
    return kernel.Servo(
        Dynamics(controller).packed,
        gains.kappa0,
        gains.kappa1,
        gains.kappai,
        gains.lag,
        gains.share,
        np.ones(6) if law is None else law.torque_constant,
        *friction_terms,
    )


def _drives(plant: ArmModel, drives: JointDrives | None) -> kernel.Drives:
    ripple = NO_RIPPLE if drives is None else drives.ripple
    return kernel.Drives(
        np.ones(6) if drives is None else drives.torque_constant,
        np.zeros(6) if drives is None else drives.offset,
        plant.limits.torque,
        plant.rotor_inertia,
        friction.pack(FRICTIONLESS if drives is None else drives.friction, plant.rotor_inertia),
        ripple.order,
        ripple.amplitude,
        ripple.phase,
    )


def _guard(arm: JointLimits, limits: Limits, *, set_over: bool) -> kernel.Guard:
    return kernel.Guard(
        target_step=_IMPOSSIBLE_STEP,
        fastest=float(arm.qd.max()),
        deviation=limits.deviation,
        speed=arm.qd * limits.speed,
        force=limits.force,
        smoothing=load_tcp_force_law().weight,
        set_over=int(set_over),
    )
