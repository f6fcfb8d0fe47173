"""The twin in lockstep: each sample of the robot moves the simulated arm to that sample's time stamp."""

from __future__ import annotations

from collections import deque
from typing import Protocol

import numpy as np

from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.control.held import given_up
from ur5_twin.errors import ReplayError
from ur5_twin.twin.closed_loop import REST, ClosedLoop
from ur5_twin.twin.sample import Prediction, Sample

#: A longer silence of the robot than this is not bridged: the twin starts again from the next measured state, s.
LONGEST_GAP = 0.5
#: Samples of actual_qd that an acceleration is taken from where the robot publishes none: 72 ms at 125 Hz.
_SLOPE_SAMPLES = 9


class Twin(Protocol):
    """Anything that turns the robot's samples into predictions, one for one."""

    def tick(self, sample: Sample) -> Prediction:
        """The twin's state at ``sample.time``, knowing this sample and the ones before it."""
        ...


class ServoTwin:
    """Servo replay: the closed loop follows the robot's targets and never sees its measured state again.

    It starts at the first measured state, and again after a silence of more than ``LONGEST_GAP`` seconds and where the
    controller gives up its path (``held.given_up``).

    Attributes:
        restarts: times at which it started again after a silence, s.
        stops: times at which it started again where a path was given up, s.
    """

    def __init__(self, loop: ClosedLoop) -> None:
        self._loop = loop
        self._last: Sample | None = None
        self.restarts: list[float] = []
        self.stops: list[float] = []

    def tick(self, sample: Sample) -> Prediction:
        """The closed loop's state at ``sample.time``."""
        last, self._last = self._last, sample
        if last is None:
            self._begin(sample)
        elif (dt := _interval(last, sample)) > LONGEST_GAP:
            self.restarts.append(sample.time)
            self._begin(sample)
        elif _given_up(last, sample):
            self.stops.append(sample.time)
            self._begin(sample)
        elif last.wrench is None or sample.wrench is None:
            self._loop.advance(_target(last), _target(sample), dt)
        else:
            push = self._loop.push_on_flange(last.wrench, sample.wrench, dt)
            self._loop.advance(_target(last), _target(sample), dt, push)
        return self._loop.state(_target(sample))

    def _begin(self, sample: Sample) -> None:
        target = _target(sample)
        if self._loop.feels and not target[1:].any():
            # Servo and friction remember: an arm that stands has stood for a while.
            self._loop.reset(target[0], target[1])
            if sample.current is not None:
                self._loop.rest_with(sample.current)
            self._loop.hold(target, REST)
        else:
            self._loop.reset(sample.actual_q, sample.actual_qd)


class ShadowTwin:
    """Shadow replay: the twin is put into the measured state each tick.

    Its position and velocity at a tick are what one tick of the closed loop makes of the state measured one tick
    earlier; its torque is what the measured motion needs, tau = M qdd + C qd + g with the measured q and qd and
    target_qdd: the arm follows its target to a milliradian, while a derivative of actual_qd is noisy and late (on the
    lab logs it explains the motor currents of joints 1 to 3 worse). A robot that publishes no targets gets that
    derivative all the same, and then a prediction of constant acceleration.

    Attributes:
        restarts: times at which a silence of more than ``LONGEST_GAP`` seconds ended, s.
        stops: times at which the controller gave up its path, s.
    """

    def __init__(self, loop: ClosedLoop, model: ArmModel) -> None:
        self._loop = loop
        self._dynamics = Dynamics(model)
        self._recent: deque[Sample] = deque(maxlen=_SLOPE_SAMPLES)
        self.restarts: list[float] = []
        self.stops: list[float] = []

    def tick(self, sample: Sample) -> Prediction:
        """One tick's prediction of the state, and the torque that the motion measured at ``sample.time`` needs."""
        last = self._recent[-1] if self._recent else None
        if last is not None and _interval(last, sample) > LONGEST_GAP:
            self.restarts.append(sample.time)
            self._recent.clear()
            last = None
        elif last is not None and _given_up(last, sample):
            self.stops.append(sample.time)
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


def _given_up(last: Sample, sample: Sample) -> bool:
    if last.target is None or sample.target is None:
        return False
    return bool(given_up(last.target[0], sample.target[0], last.actual_q))


def _target(sample: Sample) -> np.ndarray:
    if sample.target is None:
        raise ReplayError("servo replay follows target_q, target_qd and target_qdd; without them use shadow replay")
    return sample.target


def _interval(last: Sample, sample: Sample) -> float:
    dt = sample.time - last.time
    if not dt > 0:
        raise ReplayError(f"the robot's clock went from {last.time:.6f} s to {sample.time:.6f} s: it must increase")
    return dt
