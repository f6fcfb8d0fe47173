"""Two devices' clocks from what both of them felt: the shift at which two signals agree best, finer than their rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

#: Between shifts that are tried, s: far below what a signal of some Hz can tell, and a parabola goes on from there.
_STEP = 0.004
#: Rows a second on which signals are filtered.
_GRID = 250.0


@dataclass(frozen=True)
class Correlation:
    """How two signals agree over the shift of their clocks.

    Attributes:
        shifts: (n,) s tried.
        values: (n,) correlation coefficient at each.
        shift: where it is highest, by a parabola through the three highest, s.
    """

    shifts: np.ndarray
    values: np.ndarray
    shift: float


def correlate(
    time: np.ndarray, signal: np.ndarray, other_time: np.ndarray, other: np.ndarray, reach: float
) -> Correlation:
    """The shift s for which signal(t) agrees best with other(t + s).

    Args:
        time, signal: (n,) s, and the signal.
        other_time, other: (m,) the same of the other device.
        reach: shifts from -reach to reach are tried, s.
    """
    number = round(reach / _STEP)
    shifts = np.arange(-number, number + 1) * _STEP
    values = np.full(len(shifts), -1.0)
    for k, shift in enumerate(shifts):
        at = time + shift
        inside = (at >= other_time[0]) & (at <= other_time[-1])
        if inside.sum() < 0.5 * len(time):
            continue
        a, b = signal[inside], np.interp(at[inside], other_time, other)
        spread = a.std() * b.std()
        values[k] = np.mean((a - a.mean()) * (b - b.mean())) / spread if spread > 0 else -1.0
    best = int(np.clip(np.argmax(values), 1, len(values) - 2))
    low, mid, high = values[best - 1 : best + 2]
    bend = low - 2.0 * mid + high
    return Correlation(shifts, values, float(shifts[best] + (0.5 * _STEP * (low - high) / bend if bend < 0 else 0.0)))


def group_delay(bandwidth: float | None) -> float:
    """s by which a Butterworth low-pass of second order delays what is slow: sqrt(2) / (2 pi f); 0 for None, no
    filter."""
    return 0.0 if bandwidth is None else float(np.sqrt(2.0) / (2.0 * np.pi * bandwidth))


def smoothed(time: np.ndarray, values: np.ndarray, band: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (m,) on an even grid, and values (m, width) below ``band`` Hz there, without delay."""
    grid = np.arange(time[0], time[-1], 1.0 / _GRID)
    even = np.stack([np.interp(grid, time, column) for column in values.T], axis=1)
    return grid, sosfiltfilt(butter(2, band, fs=_GRID, output="sos"), even, axis=0)
