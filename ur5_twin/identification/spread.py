"""How far a fit may be off when its errors hang together: blocks of rows, and what several logs say."""

from __future__ import annotations

import numpy as np

#: Half the width of a 95 % interval in standard deviations.
NINETY_FIVE = 1.96


def sandwich(columns: np.ndarray, error: np.ndarray, blocks: np.ndarray, prior: np.ndarray | None = None) -> np.ndarray:
    """Covariance (k, k) of least squares whose errors are correlated within blocks, and not between them.

    H^-1 (sum over blocks of g g' + prior) H^-1 with g = X_b' e_b and H = X'X + prior (White 1980; Liang and Zeger
    1986), times b / (b - 1) for b blocks.

    Args:
        columns: X (n, k), weighted.
        error: (n,) what the fit leaves, weighted.
        blocks: (n,) the number of each row's block, from 0.
        prior: (k, k) information that was there before.
    """
    width = columns.shape[1]
    gradients = by_block(columns * error[:, None], blocks, int(blocks.max()) + 1)
    number = np.count_nonzero(np.bincount(blocks))
    known = np.zeros((width, width)) if prior is None else prior
    inverse = np.linalg.pinv(columns.T @ columns + known, hermitian=True)
    return inverse @ (gradients.T @ gradients * (number / max(1, number - 1)) + known) @ inverse


def at_least(covariance: np.ndarray, least: np.ndarray) -> np.ndarray:
    """A covariance (k, k) stretched where its deviations are below those of another: a few blocks may agree by
    chance."""
    stretch = np.sqrt(np.maximum(1.0, np.diag(least) / np.maximum(np.diag(covariance), 1e-300)))
    return covariance * np.outer(stretch, stretch)


def by_block(values: np.ndarray, blocks: np.ndarray, number: int) -> np.ndarray:
    """(number, k) sums of values (n, k) over the rows of each block; blocks (n,) rise."""
    sums = np.zeros((number, values.shape[1]))
    first = np.flatnonzero(np.diff(blocks, prepend=-1))
    if len(first):
        sums[blocks[first]] = np.add.reduceat(values, first, axis=0)
    return sums


def together(values: np.ndarray, std: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of several logs' findings and its standard deviation, (k,) each.

    Weighted by 1/std^2; where they scatter more than their deviations say, the mean's grows by as much (Birge 1932).

    Args:
        values, std: (n_logs, k).
    """
    weight = 1.0 / std**2
    mean = (weight * values).sum(axis=0) / weight.sum(axis=0)
    spread = np.sqrt(1.0 / weight.sum(axis=0))
    if len(values) > 1:
        chi2 = (weight * (values - mean) ** 2).sum(axis=0) / (len(values) - 1)
        spread = spread * np.sqrt(np.maximum(chi2, 1.0))
    return mean, spread
