"""Errors between what was measured and what was predicted, per joint."""

from __future__ import annotations

import numpy as np


def mean_absolute(measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """MAE = 1/N sum |measured - predicted| over the rows where both are numbers (thesis equation 5.1), (width,)."""
    return np.nanmean(np.abs(measured - predicted), axis=0)


def root_mean_square(measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """RMSE = sqrt(1/N sum (measured - predicted)^2) over the rows where both are numbers, (width,)."""
    return np.sqrt(np.nanmean((measured - predicted) ** 2, axis=0))


def largest(measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """max |measured - predicted| over the rows where both are numbers (thesis equation 6.13), (width,)."""
    return np.nanmax(np.abs(measured - predicted), axis=0)


def bias(measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Mean of predicted - measured over the rows where both are numbers, (width,)."""
    return np.nanmean(predicted - measured, axis=0)


def likeness(measured: np.ndarray, predicted: np.ndarray) -> tuple[float, float]:
    """Correlation of two signals (n,) and the slope of the predicted against the measured one, by least squares."""
    x, y = measured - measured.mean(), predicted - predicted.mean()
    spread = float(x @ x)
    return float(x @ y / np.sqrt(spread * (y @ y))), float(x @ y / spread)
