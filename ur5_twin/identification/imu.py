"""How an IMU sits on the flange and what it does to what it feels, from logs in which the arm moves.

With the flange's motion from the robot's own q and qd the readings are

    gyro = diag(k_w) R_FA' omega(t) + b_w
    acc  = diag(k_a) R_FA' (a(t) + (S(alpha) + S(omega)^2) p_FA) + b_a,    t = t_device + offset + shift + drift
    t_device

with a the flange's acceleration less gravity, all in flange axes: rotation, place, gains and biases, and the clock.
Both sides go through the same low-pass, which leaves the equation as it is and takes off what rigid links do not
explain. Gains are told because gravity's size and the robot's speeds are known. Each log is fitted for itself; what
the logs have in common comes from all of them (``spread.together``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ur5_twin import spatial
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.errors import IdentificationError
from ur5_twin.identification import spread
from ur5_twin.identification.clocks import Correlation, correlate, group_delay, smoothed
from ur5_twin.identification.flange import BAND, BLOCK, EDGE, LEVER, LINEAR, RATE, TURN, flange_felt
from ur5_twin.recording.table import Recording
from ur5_twin.sensing.specs import SensorSuite

#: The device's clock is looked for as far from where the log puts it, s.
_REACH = 1.0
#: Turning faster than this for as long tells a mounting, rad/s and s.
_TURNS, _SHORTEST = 0.1, 1.0
#: Parameters: shift, drift, rotation, place, gains and biases of accelerometer and gyroscope.
NAMES = (
    "shift",
    "drift",
    *(
        f"{what}_{axis}"
        for what in ("rotation", "place", "acc_gain", "acc_bias", "gyro_gain", "gyro_bias")
        for axis in "xyz"
    ),
)
SHIFT, DRIFT = 0, 1
ROTATION, PLACE, ACC_GAIN, ACC_BIAS, GYRO_GAIN, GYRO_BIAS = (slice(k, k + 3) for k in range(2, 20, 3))
#: How far each may be off what is known, one standard deviation: so wide that it matters only where a log tells
#: nothing.
_OFF = np.array(
    [
        1.0,
        1e-2,
        *np.full(3, 2.0),
        *np.full(3, 0.2),
        *np.full(3, 0.1),
        *np.full(3, 2.0),
        *np.full(3, 0.1),
        *np.full(3, 0.5),
    ]
)
#: Errors that no device is below, m/s^2 and rad/s.
_LEAST = np.array([1e-3, 1e-3, 1e-3, 1e-4, 1e-4, 1e-4])


@dataclass(frozen=True)
class ImuFit:
    """What one log says.

    Attributes:
        source: the log.
        values, std: (20,) in the order of ``NAMES``; s, s/s, rad (rotation vector of R_FA), m, 1, m/s^2, 1, rad/s.
        before, after: (6,) root mean square errors of accelerometer and gyroscope below the band, m/s^2 and rad/s, as
            the preset has it mounted and with what was found; the clock found by correlation in both.
        clock: correlation of the rates of turn over the shift.
        offset: s, of the device's clock on the robot's by the host's stamps; None if they do not tell.
        time: (n,) s, robot's clock.
        reading, predicted, preset: (n, 6) what was compared.
    """

    source: str
    values: np.ndarray
    std: np.ndarray
    before: np.ndarray
    after: np.ndarray
    clock: Correlation
    offset: float | None
    time: np.ndarray
    reading: np.ndarray
    predicted: np.ndarray
    preset: np.ndarray


def fit_imu(recording: Recording, arm: ArmModel, p_FA: np.ndarray, suite: SensorSuite) -> ImuFit:
    """Clock, mounting, gains and biases of the IMU of one log.

    Args:
        recording: with actual_q, actual_qd, imu_acc and imu_gyro.
        arm: kinematics and gravity.
        p_FA: (3,) where the IMU is thought to measure, flange frame, m.
        suite: the devices as they are known: their bandwidths delay, and the mounting to compare with.

    Raises:
        IdentificationError: a signal is missing or the arm hardly turns.
    """
    table = recording.tables.get("imu")
    missing = [name for name in ("imu_acc", "imu_gyro") if table is None or name not in table]
    if table is None or missing:
        raise IdentificationError(f"{recording.source}: no {', '.join(missing)}; record an IMU at the flange")
    time, felt = flange_felt(recording, arm)
    speed = np.linalg.norm(felt[:, TURN], axis=1)
    turning = float(np.gradient(time) @ (speed > _TURNS))
    if turning < _SHORTEST:
        raise IdentificationError(
            f"{recording.source}: the flange turns for {turning:.1f} s, too little to tell how the IMU is mounted; "
            f"{_SHORTEST:g} s about several axes at least"
        )
    offset = recording.offset("imu")
    known = np.isfinite(table["imu_acc"]).all(axis=1) & np.append(np.diff(table.time) > 0, True)
    reading = np.concatenate([table["imu_acc"][known], table["imu_gyro"][known]], axis=1)
    stamp, reading = smoothed(table.time[known] + (offset or 0.0), reading, BAND)
    late = np.array([group_delay(suite.acceleration.bandwidth), group_delay(suite.rate.bandwidth)])
    clock = correlate(stamp - late[1], np.linalg.norm(reading[:, 3:], axis=1), time, speed, _REACH)
    at = stamp + clock.shift
    rows = np.flatnonzero((at > time[0] + EDGE) & (at < time[-1] - EDGE))[
        :: round(len(stamp) / (stamp[-1] - stamp[0]) / RATE)
    ]
    stamp, reading = stamp[rows], reading[rows]
    spline = CubicSpline(time, felt)

    def predict(x: np.ndarray) -> np.ndarray:
        at = stamp + x[SHIFT] + x[DRIFT] * stamp
        R_FA = spatial.rotation_from_vector(x[ROTATION])
        # What a filter lets through now it saw its delay ago.
        then = spline(at - late[0])
        acceleration = then[:, LINEAR] + then[:, LEVER].reshape(-1, 3, 3) @ x[PLACE]
        acc = acceleration @ R_FA * x[ACC_GAIN] + x[ACC_BIAS]
        gyro = spline(at - late[1])[:, TURN] @ R_FA * x[GYRO_GAIN] + x[GYRO_BIAS]
        return np.concatenate([acc, gyro], axis=1)

    mounted = np.zeros(len(NAMES))
    mounted[SHIFT] = clock.shift
    mounted[ROTATION], mounted[PLACE] = suite.imu_mount, p_FA + suite.imu_shift
    mounted[ACC_GAIN], mounted[GYRO_GAIN] = _or(suite.acceleration.gain, 1.0), _or(suite.rate.gain, 1.0)
    mounted[ACC_BIAS], mounted[GYRO_BIAS] = _or(suite.acceleration.bias, 0.0), _or(suite.rate.bias, 0.0)
    start = mounted.copy()
    R_AF = Rotation.align_vectors(reading[:, 3:], spline(stamp + clock.shift - late[1])[:, TURN])[0]
    start[ROTATION] = R_AF.inv().as_rotvec()
    weight = np.ones(6)
    block = ((stamp - stamp[0]) / BLOCK).astype(int)
    found = None
    for _ in range(3):
        found = least_squares(
            lambda x, w: np.concatenate([((predict(x) - reading) * w).ravel(), (x - mounted) / _OFF]),
            start,
            x_scale=_OFF,
            args=(weight,),
        )
        start = found.x
        weight = 1.0 / np.maximum((predict(start) - reading).std(axis=0), _LEAST)
    assert found is not None
    size = reading.size
    covariance = spread.at_least(
        spread.sandwich(found.jac[:size], found.fun[:size], np.repeat(block, 6), np.diag(1.0 / _OFF**2)),
        np.linalg.inv(found.jac.T @ found.jac),
    )
    predicted, preset = predict(found.x), predict(mounted)
    before, after = (np.sqrt(((part - reading) ** 2).mean(axis=0)) for part in (preset, predicted))
    std = np.sqrt(np.diag(covariance))
    return ImuFit(
        recording.source, found.x, std, before, after, clock, offset, stamp + clock.shift, reading, predicted, preset
    )


def _or(values: np.ndarray | None, otherwise: float) -> np.ndarray:
    return np.full(3, otherwise) if values is None else values
