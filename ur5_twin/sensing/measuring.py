"""The devices of a test stand at work: pieces of the truth in, what each device reports out."""

from __future__ import annotations

import numpy as np

from ur5_twin import spatial
from ur5_twin.arm.parameters import FT_SENSOR, IMU_SENSOR, ArmModel
from ur5_twin.sensing.channel import Line
from ur5_twin.sensing.kinetics import FlangeMotion, sensed_wrench
from ur5_twin.sensing.motor_noise import TICK, MotorNoise
from ur5_twin.sensing.signals import Load, Signals
from ur5_twin.sensing.specs import Clock, SensorSuite
from ur5_twin.sensing.transport import Arrivals

#: Times that a device's clock draws at once.
_AHEAD = 256
#: A joint that turns faster than this moves, rad/s.
_MOVING = 1e-3


class Measuring:
    """Devices with their memory. The same generator state gives the same readings, however the truth is cut.

    Args:
        suite: what the devices are like.
        model: the arm, with the tool that carries force sensor and IMU; those it does not carry report nothing.
        rng: of all noise; each device gets streams of its own.
        period: the robot's tick, s; the truth's times divide it.
    """

    def __init__(self, suite: SensorSuite, model: ArmModel, rng: np.random.Generator, *, period: float) -> None:
        self._suite, self._model, self._period = suite, model, period
        robot, ft, imu = rng.spawn(3)
        position, velocity, current, motors = robot.spawn(4)
        # The same noise in time, whatever the tick.
        pole = suite.current_pole ** (period / TICK)
        self._motors = MotorNoise(suite.current_moving, pole, motors)
        self._arrivals = Arrivals(period)
        self._robot = {
            "actual_q": Line(suite.position, 6, position),
            "actual_qd": Line(suite.velocity, 6, velocity),
            "actual_current": Line(suite.current, 6, current),
        }
        sensors = {} if model.tool is None else model.tool.sensors
        self._ft = None
        if FT_SENSOR in sensors:
            clock, line = ft.spawn(2)
            self._ft = Device(suite.ft_clock, {"ft_wrench": Line(suite.ft, 6, line)}, clock)
            self._p_FS, self._R_SF = sensors[FT_SENSOR], spatial.rotation_from_vector(suite.ft_mount).T
        self._imu = None
        if IMU_SENSOR in sensors:
            clock, acceleration, rate, field = imu.spawn(4)
            lines = {
                "imu_acc": Line(suite.acceleration, 3, acceleration),
                "imu_gyro": Line(suite.rate, 3, rate),
                "imu_mag": Line(suite.field, 3, field),
            }
            self._imu = Device(suite.imu_clock, lines, clock)
            self._p_FA = sensors[IMU_SENSOR] + suite.imu_shift
            self._R_AF = spatial.rotation_from_vector(suite.imu_mount).T

    @property
    def host_start(self) -> dict[str, float]:
        """Host's time at each device's own time 0, s; the first device's is the host's zero."""
        offsets = {"robot": 0.0}
        if self._ft is not None:
            offsets["ft"] = self._suite.ft_clock.offset
        if self._imu is not None:
            offsets["imu"] = self._suite.imu_clock.offset
        first = min(offsets.values())
        return {device: offset - first for device, offset in offsets.items()}

    def robot(self, signals: Signals, first_tick: int, every: int) -> dict[str, np.ndarray]:
        """The robot's measured columns at the ticks of a piece that begins with tick ``first_tick``.

        ``every`` is how many rows of the truth a tick has.

        Returns:
            ``time`` (n,), actual_q, actual_qd, actual_current (n, 6) and actual_tool_accelerometer (n, 3), whose counts
            the lab's logs do not explain: zeros. With late packages ``time`` is their arrival, and ``timestamp`` (n, 1)
            the controller's own.
        """
        tick = first_tick + np.arange(len(signals.time) // every)
        time = tick * self._period
        q, qd = signals.q[::every], signals.qd[::every]
        truth = {"actual_q": q, "actual_qd": qd, "actual_current": self._motors.added(signals.current[::every], qd)}
        columns = {name: line.corrupted(time, truth[name]) for name, line in self._robot.items()}
        columns["actual_tool_accelerometer"] = np.zeros((len(time), 3))
        columns["time"] = time
        if self._suite.late_packages:
            moving = np.any(np.abs(qd) > _MOVING, axis=1)
            columns["timestamp"] = time[:, None]
            columns["time"] = self._arrivals.of(tick, time, moving)
        return columns

    def sensors(self, signals: Signals, load: Load) -> dict[str, dict[str, np.ndarray]]:
        """What force sensor and IMU report during a piece: device -> column -> rows, with ``time`` on its own clock."""
        if self._ft is None and self._imu is None:
            return {}
        reported = {}
        motion = FlangeMotion.of(self._model, signals)
        if self._ft is not None:
            wrench = sensed_wrench(motion, signals.wrench, load, self._p_FS)
            reported["ft"] = self._ft.report(signals.time, {"ft_wrench": _turned(self._R_SF, wrench)})
        if self._imu is not None:
            truth = {
                "imu_acc": motion.at(self._p_FA),
                "imu_gyro": motion.omega_in_flange,
                "imu_mag": motion.R_FB @ self._suite.earth_field,
            }
            truth = {name: _turned(self._R_AF, values) for name, values in truth.items()}
            reported["imu"] = self._imu.report(signals.time, truth)
        return reported


def _turned(R: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(n, 3) vectors or (n, 6) wrenches turned, in an order of sums that does not depend on the number of rows."""
    halves = [values[:, i : i + 3] for i in range(0, values.shape[1], 3)]
    return np.concatenate(
        [half[:, :1] * R[:, 0] + half[:, 1:2] * R[:, 1] + half[:, 2:] * R[:, 2] for half in halves], axis=1
    )


class Device:
    """Lines that are sampled together on a clock of their own.

    Args:
        clock: when it samples.
        lines: column -> its line.
        rng: of the clock's jitter.
    """

    def __init__(self, clock: Clock, lines: dict[str, Line], rng: np.random.Generator) -> None:
        self._clock, self._lines, self._jitter = clock, lines, rng
        self._count = 0
        self._ahead = np.zeros(1)

    def report(self, time: np.ndarray, truth: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Take in a piece of the truth; the samples that it completes, with ``time`` (n,) s on the device's clock."""
        clock = self._clock
        for name, line in self._lines.items():
            line.see(time, truth[name])
        while (due := self._due())[-1]:
            self._draw()
        n = int(np.count_nonzero(due))
        own, self._ahead = self._ahead[:n], self._ahead[n:]
        columns = {name: line.sample(self._on_robot(own)) for name, line in self._lines.items()}
        stamps = np.round(own / clock.stamp_step) * clock.stamp_step if clock.stamp_step else own
        return {"time": stamps, **columns}

    def _on_robot(self, own: np.ndarray) -> np.ndarray:
        """The robot's time at times of the device's own clock, s."""
        return own * (1.0 + self._clock.drift) + self._clock.offset

    def _due(self) -> np.ndarray:
        """Which of the times drawn ahead are covered; rounding must not decide, or a cut elsewhere would otherwise."""
        at = self._on_robot(self._ahead)
        due, *others = (line.covers(at) for line in self._lines.values())
        for other in others:
            due &= other
        return due

    def _draw(self) -> None:
        """Draw times further ahead, always as many at once: they must not depend on how the truth is cut."""
        clock, interval = self._clock, 1.0 / self._clock.rate
        if clock.jitter:
            off = np.clip(clock.jitter * self._jitter.standard_normal(_AHEAD), -0.4 * interval, 0.4 * interval)
            more = self._ahead[-1] + np.cumsum(interval + off)
        else:
            # Multiples of the interval, no sums.
            more = np.arange(self._count + 1, self._count + _AHEAD + 1) / clock.rate
        self._count += _AHEAD
        self._ahead = np.concatenate([self._ahead, more])
