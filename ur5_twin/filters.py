"""Recursive filters that go on from piece to piece: to the bit what scipy's make of it, without its cost of a call.

Whoever filters a row a tick, as a served cell does, spends with ``lfilter`` and ``sosfilt`` most of the time on the way
into them. Rows are (n, width); each column is filtered by itself.
"""

from __future__ import annotations

import numba
import numpy as np


def first_order(gain: float, pole: float, rows: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """y_k = pole y_k-1 + gain x_k.

    Args:
        gain, pole: of the filter.
        rows: (n, width) x.
        memory: (1, width) pole times the last y.

    Returns:
        (n, width) y, and the memory after it.
    """
    out, memory = np.empty(rows.shape), memory.copy()
    _first_order(gain, pole, np.ascontiguousarray(rows, dtype=float), memory, out)
    return out, memory


def second_order(sections: np.ndarray, rows: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sections of second order, one after the other.

    Args:
        sections: (m, 6) b0 b1 b2 1 a1 a2.
        rows: (n, width).
        memory: (m, 2, width) of scipy's transposed direct form.

    Returns:
        (n, width), and the memory after it.
    """
    out, memory = np.empty(rows.shape), memory.copy()
    _second_order(sections, np.ascontiguousarray(rows, dtype=float), memory, out)
    return out, memory


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _first_order(gain, pole, rows, memory, out):  # pragma: no cover - compiled
    for k in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            out[k, j] = memory[0, j] + gain * rows[k, j]
            memory[0, j] = pole * out[k, j]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _second_order(sections, rows, memory, out):  # pragma: no cover - compiled
    for k in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            value = rows[k, j]
            for s in range(sections.shape[0]):
                filtered = sections[s, 0] * value + memory[s, 0, j]
                memory[s, 0, j] = sections[s, 1] * value - sections[s, 4] * filtered + memory[s, 1, j]
                memory[s, 1, j] = sections[s, 2] * value - sections[s, 5] * filtered
                value = filtered
            out[k, j] = value
