"""Intervals of least squares whose residuals follow each other: a jackknife over blocks of seconds."""

from __future__ import annotations

import numpy as np
from scipy.stats import t as student

_CONFIDENCE = 0.95


def half_widths(columns: np.ndarray, answer: np.ndarray, block: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Half-widths (p,) of the 95 % intervals of weighted least squares; inf with fewer than three blocks.

    Args:
        columns: (n, p).
        answer: (n,).
        block: (n,) number of the block a row belongs to.
        weight: (n,) of the squared residuals.
    """
    kinds = np.unique(block)
    n = len(kinds)
    if n < 3:
        return np.full(columns.shape[1], np.inf)
    # What is left without a block is a difference of sums.
    members = [block == kind for kind in kinds]
    normal = np.stack([(columns[m].T * weight[m]) @ columns[m] for m in members])
    right = np.stack([(columns[m].T * weight[m]) @ answer[m] for m in members])
    without = np.stack(
        [
            np.linalg.lstsq(normal.sum(0) - a, right.sum(0) - b, rcond=None)[0]
            for a, b in zip(normal, right, strict=True)
        ]
    )
    error = np.sqrt((n - 1) / n * ((without - without.mean(axis=0)) ** 2).sum(axis=0))
    return error * student_factor(n - 1)


def student_factor(freedom: np.ndarray | int) -> np.ndarray | float:
    """What multiplies a standard error to the half-width of a 95 % interval."""
    return student.ppf(0.5 + 0.5 * _CONFIDENCE, np.maximum(freedom, 1))
