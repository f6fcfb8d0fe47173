"""One measured quantity on its way from the truth to a number in a log.

In this order: the sensor's bandwidth (a low-pass of second order, Butterworth), its delay, a sample at the device's
time, gain, bias and drift, slow noise, white noise, saturation, and the steps of its converter. A signal goes through
in pieces of any length, and comes out the same, bit for bit, however it was cut: filters, the last rows, and each
random stream go on where they were.

A force sensor has no steps along its axes: its gauges have. With ``gauges`` white noise and rounding happen in their
counts, and what comes out is a whole number of counts of each gauge, mapped to the axes. So a quiet sensor repeats
itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfilt_zi

from ur5_twin.filters import first_order, second_order


@dataclass(frozen=True)
class Channel:
    """What happens to a quantity; None leaves a stage out. Arrays are as wide as the quantity.

    Attributes:
        delay: from the truth to the sample, s.
        bandwidth: Hz at which the low-pass lets 1/sqrt(2) through.
        gain: what comes out per what goes in.
        bias: added.
        drift: standard deviation of the bias' random walk after one second.
        slow_noise: standard deviation of noise with a memory.
        slow_pole: of that from sample to sample, x_k = pole x_k-1 + w_k.
        noise: standard deviation of white noise from sample to sample; in counts where there are gauges.
        full_scale: what is beyond it, in either sign, is cut.
        step: of the converter.
        gauges: (width, width) a column a gauge: what a count of it adds to each axis. They have no ``step``.
    """

    delay: float = 0.0
    bandwidth: float | None = None
    gain: np.ndarray | None = None
    bias: np.ndarray | None = None
    drift: np.ndarray | None = None
    slow_noise: np.ndarray | None = None
    slow_pole: float = 0.0
    noise: np.ndarray | None = None
    full_scale: np.ndarray | None = None
    step: np.ndarray | None = None
    gauges: np.ndarray | None = None


class Line:
    """A channel at work, with its memory and its random streams.

    Args:
        channel: what it does.
        width: of the quantity.
        rng: of its noise; its streams are spawned from it.
    """

    def __init__(self, channel: Channel, width: int, rng: np.random.Generator) -> None:
        self._channel = channel
        self._noise, self._walk, self._slow = rng.spawn(3)
        self._filter: np.ndarray | None = None
        self._memory: np.ndarray | None = None
        self._time = self._held_time = np.empty(0)
        self._values = self._held_values = np.empty((0, width))
        self._drift = np.zeros(width)
        self._last_sample: float | None = None
        # As it is after a long time: the noise does not have to swell first.
        self._slow_memory = channel.slow_pole * self._slow.standard_normal((1, width))
        self._counts = None if channel.gauges is None else np.linalg.inv(channel.gauges)

    def see(self, time: np.ndarray, values: np.ndarray) -> None:
        """Take in the next piece of the truth: times (n,) s, evenly spaced, and values (n, width)."""
        if self._channel.bandwidth is not None:
            time, values = self._smoothed(time, values)
        self._time = np.concatenate([self._time, time])
        self._values = np.concatenate([self._values, values])

    @property
    def known_until(self) -> float:
        """Time up to which samples can be taken, but for rounding, s."""
        return self._time[-1] + self._channel.delay if len(self._time) else -np.inf

    def covers(self, time: np.ndarray) -> np.ndarray:
        """(n,) whether samples can be taken at times (n,) s: whether they lie at or before the last row it has seen."""
        last = self._time[-1] if len(self._time) else -np.inf
        return time - self._channel.delay <= last

    def sample(self, time: np.ndarray) -> np.ndarray:
        """(n, width) what it reads at times (n,) s, rising and covered; before the first, the first."""
        channel = self._channel
        if not len(time):
            return np.empty((0, self._values.shape[1]))
        at = time - channel.delay
        values = np.stack([np.interp(at, self._time, column) for column in self._values.T], axis=1)
        kept = max(0, int(np.searchsorted(self._time, at[-1], side="right")) - 1)
        self._time, self._values = self._time[kept:], self._values[kept:]
        return self.corrupted(time, values)

    def corrupted(self, time: np.ndarray, values: np.ndarray) -> np.ndarray:
        """(n, width) values at sample times (n,) s with bias, drift, noise, limits and steps."""
        channel = self._channel
        if channel.gain is not None:
            values = values * channel.gain
        if channel.bias is not None:
            values = values + channel.bias
        if channel.drift is not None and len(time):
            first = time[0] if self._last_sample is None else self._last_sample
            steps = np.diff(np.concatenate([[first], time]))
            walk = np.sqrt(np.maximum(steps, 0.0))[:, None] * self._walk.standard_normal(values.shape) * channel.drift
            # Summed one by one, so that a cut elsewhere rounds the same.
            walk[0] += self._drift
            walk = np.cumsum(walk, axis=0)
            self._drift, self._last_sample = walk[-1].copy(), float(time[-1])
            values = values + walk
        if channel.slow_noise is not None:
            values = values + channel.slow_noise * self._slow_noise(values.shape)
        white = 0.0 if channel.noise is None else channel.noise * self._noise.standard_normal(values.shape)
        if self._counts is not None and channel.gauges is not None:
            if channel.full_scale is not None:
                values = np.clip(values, -channel.full_scale, channel.full_scale)
            return _mapped(channel.gauges, np.round(_mapped(self._counts, values) + white))
        values = values + white
        if channel.full_scale is not None:
            values = np.clip(values, -channel.full_scale, channel.full_scale)
        if channel.step is not None:
            step = np.where(channel.step > 0, channel.step, 1.0)
            values = np.where(channel.step > 0, np.round(values / step) * step, values)
        return values

    def _slow_noise(self, shape: tuple[int, ...]) -> np.ndarray:
        pole = self._channel.slow_pole
        white = np.sqrt(1.0 - pole**2) * self._slow.standard_normal(shape)
        slow, self._slow_memory = first_order(1.0, pole, white, self._slow_memory)
        return slow

    def _smoothed(self, time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self._filter is None:
            # The rate is not known before the second row: the first is held back until then.
            time, values = np.concatenate([self._held_time, time]), np.concatenate([self._held_values, values])
            if len(time) < 2:
                self._held_time, self._held_values = time, values
                return time[:0], values[:0]
            rate = 1.0 / (time[1] - time[0])
            assert self._channel.bandwidth is not None
            self._filter = np.asarray(butter(2, min(self._channel.bandwidth, 0.49 * rate), fs=rate, output="sos"))
            # It has seen the first value for ever.
            self._memory = sosfilt_zi(self._filter)[:, :, None] * values[0]
        assert self._memory is not None
        smooth, self._memory = second_order(self._filter, values, self._memory)
        return time, smooth


def _mapped(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(n, width) matrix times each row, summed in one order: a product of matrices rounds by the number of rows."""
    mapped = values[:, :1] * matrix[:, 0]
    for i in range(1, matrix.shape[1]):
        mapped = mapped + values[:, i : i + 1] * matrix[:, i]
    return mapped
