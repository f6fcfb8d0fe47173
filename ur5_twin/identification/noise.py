"""The noise of the devices: measured from logs, beside what the simulated devices make of the same motion.

A signal's noise is what is left of it beside a smooth curve (a parabola through a tenth of a second, Savitzky and Golay
1964), at standstill and in motion apart. At standstill the level is the median over pieces of half a second: a servo
that hunts or a joint that slips is no noise of a sensor. A step is what the differences of consecutive rows are whole
multiples of. A device's clock is its stamps'.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter, welch
from scipy.stats import kurtosis

from ur5_twin.errors import IdentificationError
from ur5_twin.recording.table import Recording, Table

#: Rows of the smooth curve: 0.1 s of the robot, and of a sensor at twice its rate.
_WINDOW = {"robot": 13, "ft": 21, "imu": 27}
#: A joint moves at more than this, rad/s; the arm rests while all its targets do.
_MOVING = 0.03
#: Rows after and before a motion that are no standstill.
_AROUND = 40
#: Force that no noise makes, N.
_TOUCHED = 0.1
#: Fewer rows tell nothing.
_ENOUGH = 100
#: Rows of a piece of standstill.
_PIECE = 64
#: Differences are multiples of a step if their phases agree as much; as many are tried.
_IN_STEP, _DIFFERENCES = 0.7, 400
#: No step is looked for below two digits of a log.
_DIGIT = 2e-6
_SIGNALS = {
    "robot": ("actual_q", "actual_qd", "actual_current"),
    "ft": ("ft_wrench",),
    "imu": ("imu_acc", "imu_gyro", "imu_mag"),
}


@dataclass(frozen=True)
class Figures:
    """What is known of one signal's noise, each (width,); NaN where the log does not tell.

    Attributes:
        step: what differences of consecutive rows are multiples of; NaN for a signal without steps.
        still, moving: standard deviation beside a smooth curve.
        kurtosis: of that at standstill; 0 for a normal distribution.
        frequency: (n,) Hz.
        spectrum_still, spectrum_moving: (n, width) power spectral density of it; NaN where the log does not tell.
    """

    step: np.ndarray
    still: np.ndarray
    moving: np.ndarray
    kurtosis: np.ndarray
    frequency: np.ndarray
    spectrum_still: np.ndarray
    spectrum_moving: np.ndarray


@dataclass(frozen=True)
class ClockFigures:
    """What is known of a device's clock: rows a second, spread of the interval in s, share of rows at rest that repeat
    the one before; None if there is too little rest."""

    rate: float
    jitter: float
    repeated: float | None


@dataclass(frozen=True)
class Noise:
    """A log's noise: by signal and by device."""

    source: str
    signals: dict[str, Figures]
    clocks: dict[str, ClockFigures]


def measure(recording: Recording) -> Noise:
    """Measure the noise of every device in a log.

    Raises:
        IdentificationError: the log has no standstill of a second to measure it at.
    """
    still, moving = _phases(recording.robot)
    if still.sum() < _ENOUGH:
        raise IdentificationError(
            f"{recording.source}: the arm rests for {still.sum()} rows, {_ENOUGH} are needed to tell noise from motion"
        )
    signals, clocks = {}, {}
    for device, names in _SIGNALS.items():
        table = recording.tables.get(device)
        if table is None or len(table) < _ENOUGH:
            continue
        offset = recording.offset(device) or 0.0
        at = np.searchsorted(recording.robot.time, table.time + offset).clip(0, len(still) - 1)
        rests = still[at] if device != "robot" else still
        if device == "ft":
            rests = rests & _untouched(table)
        moves = moving[at].any(axis=1, keepdims=True) if device != "robot" else moving
        for name in names:
            if name in table:
                signals[name] = _figures(table, name, rests, np.broadcast_to(moves, table[name].shape))
        clocks[device] = _clock(table, names[0], rests)
    return Noise(recording.source, signals, clocks)


def _phases(robot: Table) -> tuple[np.ndarray, np.ndarray]:
    """Rows at which the arm rests (n,), and at which each joint moves (n, 6)."""
    qd = np.abs(robot["target_qd"])
    busy = (qd > 0).any(axis=1)
    near = np.convolve(busy, np.ones(2 * _AROUND + 1), mode="same") > 0
    return ~near, qd > _MOVING


def _untouched(ft: Table) -> np.ndarray:
    """Rows at which the force sensor reads what it read at first: nobody pushes."""
    force = ft["ft_wrench"][:, :3]
    away = np.abs(force - np.median(force[:_ENOUGH], axis=0)).max(axis=1) > _TOUCHED
    return np.convolve(away, np.ones(2 * _AROUND + 1), mode="same") == 0


def _figures(table: Table, name: str, still: np.ndarray, moving: np.ndarray) -> Figures:
    values = table[name]
    known = np.all(np.isfinite(values), axis=1)
    rough = values - savgol_filter(np.where(known[:, None], values, 0.0), _WINDOW[table.device], 2, axis=0)
    width = values.shape[1]
    rests = still & known
    found = {key: np.full(width, np.nan) for key in ("step", "still", "moving", "kurtosis")}
    rate = (len(table) - 1) / (table.time[-1] - table.time[0])
    frequency = np.fft.rfftfreq(128, 1.0 / rate)
    spectra = {key: np.full((len(frequency), width), np.nan) for key in ("still", "moving")}
    for axis in range(width):
        found["step"][axis] = _step(values[known, axis])
        for key, rows in (("still", rests), ("moving", moving[:, axis] & known)):
            if rows.sum() >= _ENOUGH:
                found[key][axis] = _usual(rough[:, axis], rows) if key == "still" else rough[rows, axis].std()
                spectra[key][:, axis] = welch(rough[rows, axis], rate, nperseg=128)[1] if rows.sum() >= 128 else np.nan
        if rests.sum() >= _ENOUGH and found["still"][axis] > 0:
            found["kurtosis"][axis] = kurtosis(rough[rests, axis])
    return Figures(**found, frequency=frequency, spectrum_still=spectra["still"], spectrum_moving=spectra["moving"])


def _usual(rough: np.ndarray, rows: np.ndarray) -> float:
    """Median over pieces of the standard deviation within a piece."""
    at = np.flatnonzero(rows)
    pieces = np.array_split(at, max(1, len(at) // _PIECE))
    return float(np.median([rough[piece].std() for piece in pieces]))


def _step(values: np.ndarray) -> float:
    """The step of a converter; NaN for a signal that has none, or whose step cannot be told from a log's digits."""
    differences = np.abs(np.diff(values))
    differences = np.sort(differences[differences > _DIGIT])
    if len(differences) < _ENOUGH // 10:
        return np.nan
    least = np.percentile(differences[:_DIFFERENCES], 5)
    # Far multiples would need a finer search; single ones fit anything.
    near = differences[differences < 20.0 * least]
    near = near[:: len(near) // _DIFFERENCES + 1]
    steps = 1.0 / np.linspace(1.0 / (1.3 * least), 1.0 / (0.4 * least), 4000)
    fit = np.abs(np.exp(2j * np.pi * near / steps[:, None]).mean(axis=1))
    good = np.flatnonzero(fit > _IN_STEP)
    if not len(good) or len(good) == len(fit):
        return np.nan
    # The largest that fits counts: half of it fits as well.
    end = np.flatnonzero(np.diff(good, append=good[-1] + 2) > 1)[0]
    peak = good[: end + 1]
    return float(steps[peak[np.argmax(fit[peak])]])


def _clock(table: Table, name: str, rests: np.ndarray) -> ClockFigures:
    interval = np.diff(table.time)
    repeated = np.all(np.diff(table[name], axis=0) == 0, axis=1)[rests[1:]]
    share = float(repeated.mean()) if len(repeated) >= _ENOUGH else None
    return ClockFigures(1.0 / float(interval.mean()), float(interval.std()), share)


def rows(measured: Sequence[Noise], simulated: Sequence[Noise]) -> list[tuple[str, str, str, list[float], list[float]]]:
    """Signal, what, unit, and the medians over the logs of the measured and of the simulated figure, in small units."""
    table = []
    for name, unit, scale in (
        ("actual_q", "urad", 1e6),
        ("actual_qd", "urad/s", 1e6),
        ("actual_current", "mA", 1e3),
        ("ft_wrench", "mN, mNm", 1e3),
        ("imu_acc", "mm/s^2", 1e3),
        ("imu_gyro", "mrad/s", 1e3),
    ):
        # A force sensor's steps are its gauges' (``identification.gauges``); the IMU's calibration hides its own.
        for what in ("step", "still", "moving") if name.startswith("actual") else ("still", "moving"):
            real, twin = (_median(noises, name, what) for noises in (measured, simulated))
            if real is not None and twin is not None:
                table.append((name, what, unit, [v * scale for v in real], [v * scale for v in twin]))
    # How the noise at rest is distributed; where nothing changes there is no distribution.
    for name in ("actual_current", "ft_wrench", "imu_acc", "imu_gyro"):
        real, twin = (_median(noises, name, "kurtosis") for noises in (measured, simulated))
        if real is not None and twin is not None:
            table.append((name, "kurtosis, still", "", real, twin))
    return table


def _median(noises: Sequence[Noise], name: str, what: str) -> list[float] | None:
    found = [getattr(noise.signals[name], what) for noise in noises if name in noise.signals]
    if not found:
        return None
    stacked = np.array(found)
    known = np.isfinite(stacked)
    medians = [
        float(np.median(column[mask])) if mask.any() else np.nan
        for column, mask in zip(stacked.T, known.T, strict=True)
    ]
    return medians
