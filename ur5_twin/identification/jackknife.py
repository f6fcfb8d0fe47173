"""Intervals of least squares whose residuals follow each other: a jackknife over blocks of seconds."""

from __future__ import annotations

import numpy as np
from scipy.stats import t as student

_CONFIDENCE = 0.95


def half_widths(
    columns: np.ndarray,
    residual: np.ndarray,
    block: np.ndarray,
    pull: np.ndarray | None = None,
    curvature: np.ndarray | None = None,
) -> np.ndarray:
    """Half-widths (p,) of the 95 % intervals of an M-estimate; inf with fewer than three blocks.

    Without block b the solution moves by -(H - H_b)^-1 X_b' s, exactly so for least squares.

    Args:
        columns: X, (n, p).
        residual: (n,) at the solution.
        block: (n,) number of the block a row belongs to.
        pull: s, (n,) the loss' slope in the residual; the residual itself, of least squares, if not given.
        curvature: (n,) the loss' second derivative, which makes H = X' diag(curvature) X; one if not given.
    """
    kinds = np.unique(block)
    n = len(kinds)
    if n < 3:
        return np.full(columns.shape[1], np.inf)
    pull = residual if pull is None else pull
    curvature = np.ones(len(residual)) if curvature is None else curvature
    members = [block == kind for kind in kinds]
    hessian = np.stack([(columns[m].T * curvature[m]) @ columns[m] for m in members])
    score = np.stack([columns[m].T @ pull[m] for m in members])
    moved = np.stack(
        [np.linalg.lstsq(hessian.sum(0) - h, s, rcond=None)[0] for h, s in zip(hessian, score, strict=True)]
    )
    error = np.sqrt((n - 1) / n * ((moved - moved.mean(axis=0)) ** 2).sum(axis=0))
    return error * student_factor(n - 1)


def student_factor(freedom: np.ndarray | int) -> np.ndarray | float:
    """What multiplies a standard error to the half-width of a 95 % interval."""
    return student.ppf(0.5 + 0.5 * _CONFIDENCE, np.maximum(freedom, 1))
