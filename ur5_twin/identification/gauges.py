"""The gauges of a force sensor from its own readings: what a count of each adds to each axis.

A force sensor computes forces and moments from whole numbers of its six gauges, F = C n. Differences of its readings so
are sums of whole numbers of the columns of C, and at rest, where a gauge moves by a count or two, the columns stand
among the differences themselves. They are found as the shortest that occur again and again and point in six directions,
and refined by least squares over ever larger differences.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ur5_twin.errors import IdentificationError
from ur5_twin.recording.table import Recording

#: Counts up to which differences are used, from the first round to the last.
_REACH = (3, 6, 12, 25, 60, 150, 400, 1000)
#: Digits that logs carry, and by how much a difference of rounded readings may be off, N or Nm.
_DIGITS, _ROUNDING = 6, 2.5e-6
#: Of shortening the columns.
_SWEEPS = 20
#: Most frequent differences that are looked at.
_CANDIDATES = 400
#: Differences that occur less often may be of several gauges.
_OFTEN = 3
#: A column is no sum of the others if this much of it stands across them.
_ACROSS = 0.05
#: From its whole number, in counts, a gauge may be off: rounding of the readings leaves about a thousandth.
_WHOLE = 0.02


@dataclass(frozen=True)
class GaugeFit:
    """A force sensor's gauges.

    Attributes:
        matrix: (6, 6) N and Nm a count, a row an axis, a column a gauge; order and signs of the gauges are unknown.
        off: (6,) root mean square of the distance of each gauge from whole counts, over all readings.
        readings: their number.
    """

    matrix: np.ndarray
    off: np.ndarray
    readings: int


def fit_gauges(recordings: Sequence[Recording]) -> GaugeFit:
    """Find the gauges of the sensor that wrote the recordings' ``ft_wrench``.

    Raises:
        IdentificationError: there are no readings, or they are no sums of whole counts of six gauges.
    """
    logs = [recording.tables["ft"]["ft_wrench"] for recording in recordings if "ft" in recording.tables]
    logs = [log[np.isfinite(log).all(axis=1)] for log in logs]
    differences = np.concatenate([np.diff(log, axis=0) for log in logs]) if logs else np.empty((0, 6))
    matrix, measure = _columns(differences)
    for reach in _REACH:
        counts = differences @ np.linalg.inv(matrix).T
        whole = np.round(counts)
        usable = (np.abs(whole).max(axis=1) <= reach) & (np.abs(counts - whole).max(axis=1) < 0.25)
        solution, _, rank, _ = np.linalg.lstsq(whole[usable], differences[usable], rcond=None)
        if rank < 6:
            raise _no_gauges()
        matrix = solution.T
    matrix = _shortened(matrix, measure)
    readings = np.concatenate(logs)
    counts = readings @ np.linalg.inv(matrix).T
    off = np.sqrt(((counts - np.round(counts)) ** 2).mean(axis=0))
    if off.max() > _WHOLE:
        raise _no_gauges()
    return GaugeFit(matrix, off, len(readings))


def _columns(differences: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(6, 6) six frequent short differences that point in six directions, as columns, and (6, 6) the measure of short.

    The measure W makes the frequent differences, W d, as long in all directions on average.
    """
    found, count = np.unique(np.round(_upright(differences), _DIGITS), axis=0, return_counts=True)
    order = np.argsort(-count, kind="stable")[:_CANDIDATES]
    # Rounding splits a difference among neighbours in the last digit: near ones are one.
    heads: dict[int, int] = {}
    for i in order:
        near = next((k for k in heads if np.abs(found[k] - found[i]).max() < _ROUNDING), i)
        heads[near] = heads.get(near, 0) + int(count[i])
    often = [k for k, n in heads.items() if n >= _OFTEN and found[k].any()]
    frequent = found[often]
    if np.linalg.matrix_rank(frequent) < 6:
        raise _no_gauges()
    weight = np.array([heads[k] for k in often], dtype=float)
    measure = np.linalg.inv(np.linalg.cholesky(frequent.T @ (frequent * weight[:, None]) / weight.sum()))
    lengths = np.linalg.norm(frequent @ measure.T, axis=1)
    chosen: list[np.ndarray] = []
    for vector in frequent[np.argsort(lengths)]:
        basis = np.array([*chosen, vector]) @ measure.T
        basis /= np.linalg.norm(basis, axis=1)[:, None]
        if np.linalg.svd(basis, compute_uv=False)[-1] > _ACROSS:
            chosen.append(vector)
        if len(chosen) == 6:
            return np.array(chosen).T, measure
    raise _no_gauges()


def _shortened(matrix: np.ndarray, measure: np.ndarray) -> np.ndarray:
    """Columns with the same sums, each less whole multiples of the others as long as that makes it shorter."""
    matrix = matrix.copy()
    for _ in range(_SWEEPS):
        before = matrix.copy()
        for i in range(6):
            for j in set(range(6)) - {i}:
                a, b = measure @ matrix[:, i], measure @ matrix[:, j]
                matrix[:, i] -= np.round(a @ b / (b @ b)) * matrix[:, j]
        if np.array_equal(before, matrix):
            break
    return matrix


def _upright(vectors: np.ndarray) -> np.ndarray:
    """Vectors or their negatives, whichever begins with a positive number."""
    first = np.take_along_axis(vectors, (vectors != 0).argmax(axis=1)[:, None], axis=1)
    return vectors * np.where(first < 0, -1.0, 1.0)


def _no_gauges() -> IdentificationError:
    return IdentificationError("the force sensor's readings are no whole counts of six gauges: calibrated or filtered")
