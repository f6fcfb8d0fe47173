"""The twin in lockstep: each sample of the robot moves the simulated arm to that sample's time stamp.

MuJoCo advances velocity before position, so that the velocity it holds belongs to the middle of the last step; read
as such (leapfrog), a step is accurate to second order in its length. ``qvel`` therefore begins half a step back, stays
there from step to step and tick to tick, and velocities that leave this module are carried half a step forward.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Protocol

import mujoco
import numpy as np

from ur5_twin.arm import mjcf
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.control import computed_torque
from ur5_twin.control.gains import PDGains
from ur5_twin.errors import ReplayError
from ur5_twin.twin.sample import Prediction, Sample

#: Longest physics step, s. The wrist's inertia without rotors is 1e-4 kg m^2; MuJoCo's own default is the same.
SUBSTEP = 0.002
#: A longer silence of the robot than this is not bridged: the twin starts again from the next measured state, s.
LONGEST_GAP = 0.5
#: A step of a joint's target that no log of a sound robot has, rad.
_IMPOSSIBLE_STEP = 0.1
#: Velocities (rad/s) and accelerations (rad/s^2) beyond this are no motion of an arm but a simulation that diverges.
_DIVERGED = 1e5
#: Samples of actual_qd that an acceleration is taken from where the robot publishes none: 72 ms at 125 Hz.
_SLOPE_SAMPLES = 9


class Twin(Protocol):
    """Anything that turns the robot's samples into predictions, one for one."""

    def tick(self, sample: Sample) -> Prediction:
        """The twin's state at ``sample.time``, knowing this sample and the ones before it."""
        ...


class ClosedLoop:
    """The simulated arm under the controller: feedback linearisation with a PD law (thesis equation 2.80).

    tau = M(q) a + C(q, qd) qd + g(q),  a = qdd_d - K0 (q - q_d) - K1 (qd - qd_d)

    with M, C and g of the controller's model, which need not be the plant's. Between two samples the reference goes on
    from one target to the next (``control.computed_torque.reference``). Where a target steps instead of moving, as it
    does when a move ends, the arm is set over by the same step, so that its tracking error stays what it was: no motor
    could follow, and the thesis' soft gains would take seconds to forget it.

    Args:
        controller: the model the controller linearises with.
        plant: the model that is simulated.
        gains: K0 and K1.
        substep: longest physics step, s; a tick is divided into as many equal steps as it takes.
        set_over: set the arm over where the target steps; False leaves it to the gains to catch up.

    Attributes:
        largest_step: (6,) the largest step of each joint's target_q so far, rad.
        largest_qd_step: (6,) the largest step of its target_qd, rad/s.
    """

    def __init__(
        self, controller: ArmModel, plant: ArmModel, gains: PDGains, substep: float = SUBSTEP, *, set_over: bool = True
    ) -> None:
        self._packed = Dynamics(controller).packed
        self._limits = controller.limits.torque
        self._fastest = float(controller.limits.qd.max())
        self._kappa0, self._kappa1 = gains.kappa0, gains.kappa1
        self._substep = substep
        self._set_over = set_over
        self._model = mjcf.compile(plant, collisions=False)
        # MuJoCo would otherwise put a diverged arm back to zero and go on.
        self._model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self._data = mujoco.MjData(self._model)
        # Views into MuJoCo's memory: valid as long as the data they belong to.
        self._q, self._qvel, self._qacc = self._data.qpos, self._data.qvel, self._data.qacc
        self._torque = self._data.ctrl
        self._qd = np.zeros(6)
        self._moment = np.zeros(6)
        self._reference = np.zeros((6, 6))
        self._step = np.zeros((2, 6))
        self._just_reset = True
        self.largest_step = np.zeros(6)
        self.largest_qd_step = np.zeros(6)

    def reset(self, q: np.ndarray, qd: np.ndarray) -> None:
        """Put the arm at joint positions ``q`` (6,) rad with velocities ``qd`` (6,) rad/s."""
        self._q[:] = q
        self._qd[:] = qd
        self._just_reset = True

    def advance(self, before: np.ndarray, after: np.ndarray, dt: float) -> None:
        """Move the arm ``dt`` seconds on while the reference goes from one sample's target (3, 6) to the next one's.

        Raises:
            ReplayError: the target steps further than any arm could, or the simulation diverges.
        """
        steps = max(1, math.ceil(dt / self._substep - 1e-6))
        h = dt / steps
        self._model.opt.timestep = h
        computed_torque.reference(before, after, dt, self._reference, self._step)
        self._check_steps(dt)
        if self._set_over:
            self._q += self._step[0]
            self._qd += self._step[1]
        if self._just_reset:
            self._settle_acceleration(h)
            self._just_reset = False
        self._qvel[:] = self._qd - 0.5 * h * self._qacc
        for i in range(steps):
            self._ask_for_torque(i * h, h)
            mujoco.mj_step(self._model, self._data)
        self._qd[:] = self._qvel + 0.5 * h * self._qacc
        # Written so that NaN fails too.
        if not (np.abs(self._qacc).max() < _DIVERGED and np.abs(self._qd).max() < _DIVERGED):
            raise ReplayError("the simulation diverged: softer gains or a plant with rotor inertia may help")

    def _ask_for_torque(self, t: float, h: float) -> None:
        computed_torque.control(
            self._reference, t, self._q, self._qvel, self._qacc, h, self._kappa0, self._kappa1, self._packed,
            self._torque,
        )  # fmt: skip

    def _settle_acceleration(self, h: float) -> None:
        """After a reset: the plant's own acceleration at the first torque, which half a step back needs."""
        self._qacc[:] = 0.0
        self._qvel[:] = self._qd
        self._ask_for_torque(0.0, h)
        mujoco.mj_forward(self._model, self._data)

    def _check_steps(self, dt: float) -> None:
        q_step, qd_step = np.abs(self._step)
        # Over a gap a joint may have moved and stopped unseen.
        if not q_step.max() < _IMPOSSIBLE_STEP + self._fastest * dt:
            joint = int(np.argmax(q_step)) + 1
            raise ReplayError(
                f"the target of joint {joint} steps by {q_step.max():.3g} rad from one sample to the next; "
                "no arm can do that: is it in rad?"
            )
        np.maximum(self.largest_step, q_step, out=self.largest_step)
        np.maximum(self.largest_qd_step, qd_step, out=self.largest_qd_step)

    def state(self, target: np.ndarray) -> Prediction:
        """The arm's state and the torque the control law asks for in it, with the reference at ``target`` (3, 6)."""
        computed_torque.law(target, self._q, self._qd, self._kappa0, self._kappa1, self._packed, self._moment)
        np.clip(self._moment, -self._limits, self._limits, out=self._moment)
        return Prediction(self._q.copy(), self._qd.copy(), self._moment.copy())


class ServoTwin:
    """Servo replay: the closed loop follows the robot's targets and never sees its measured state again.

    It starts at the first measured state, and again after a silence of more than ``LONGEST_GAP`` seconds.

    Attributes:
        restarts: times at which it started again, s.
    """

    def __init__(self, loop: ClosedLoop) -> None:
        self._loop = loop
        self._last: Sample | None = None
        self.restarts: list[float] = []

    def tick(self, sample: Sample) -> Prediction:
        """The closed loop's state at ``sample.time``."""
        last, self._last = self._last, sample
        if last is None:
            self._loop.reset(sample.actual_q, sample.actual_qd)
        elif (dt := _interval(last, sample)) > LONGEST_GAP:
            self.restarts.append(sample.time)
            self._loop.reset(sample.actual_q, sample.actual_qd)
        else:
            self._loop.advance(_target(last), _target(sample), dt)
        return self._loop.state(_target(sample))


class ShadowTwin:
    """Shadow replay: the twin is put into the measured state each tick.

    Its position and velocity at a tick are what one tick of the closed loop makes of the state measured one tick
    earlier; its torque is what the measured motion needs, tau = M qdd + C qd + g with the measured q and qd and
    target_qdd: the arm follows its target to a milliradian, while a derivative of actual_qd is noisy and late (on the
    lab logs it explains the motor currents of joints 1 to 3 worse). A robot that publishes no targets gets that
    derivative all the same, and then a prediction of constant acceleration.

    Attributes:
        restarts: times at which a silence of more than ``LONGEST_GAP`` seconds ended, s.
    """

    def __init__(self, loop: ClosedLoop, model: ArmModel) -> None:
        self._loop = loop
        self._dynamics = Dynamics(model)
        self._recent: deque[Sample] = deque(maxlen=_SLOPE_SAMPLES)
        self.restarts: list[float] = []

    def tick(self, sample: Sample) -> Prediction:
        """One tick's prediction of the state, and the torque that the motion measured at ``sample.time`` needs."""
        last = self._recent[-1] if self._recent else None
        if last is not None and _interval(last, sample) > LONGEST_GAP:
            self.restarts.append(sample.time)
            self._recent.clear()
            last = None
        predicted = (sample.actual_q.copy(), sample.actual_qd.copy()) if last is None else self._predict(last, sample)
        self._recent.append(sample)
        qdd = self._slope() if sample.target is None else sample.target[2]
        return Prediction(*predicted, self._dynamics.inverse(sample.actual_q, sample.actual_qd, qdd))

    def _predict(self, last: Sample, sample: Sample) -> tuple[np.ndarray, np.ndarray]:
        dt = sample.time - last.time
        if last.target is None or sample.target is None:
            qdd = self._slope()
            return last.actual_q + dt * last.actual_qd + 0.5 * dt**2 * qdd, last.actual_qd + dt * qdd
        self._loop.reset(last.actual_q, last.actual_qd)
        self._loop.advance(last.target, sample.target, dt)
        return self._loop.state(sample.target)[:2]

    def _slope(self) -> np.ndarray:
        """Acceleration (6,) in rad/s^2: the slope of a line through the last samples' actual_qd."""
        if len(self._recent) < 2:
            return np.zeros(6)
        t = np.array([sample.time for sample in self._recent])
        t -= t.mean()
        return t @ np.array([sample.actual_qd for sample in self._recent]) / (t @ t)


def _target(sample: Sample) -> np.ndarray:
    if sample.target is None:
        raise ReplayError("servo replay follows target_q, target_qd and target_qdd; without them use shadow replay")
    return sample.target


def _interval(last: Sample, sample: Sample) -> float:
    dt = sample.time - last.time
    if not dt > 0:
        raise ReplayError(f"the robot's clock went from {last.time:.6f} s to {sample.time:.6f} s: it must increase")
    return dt
