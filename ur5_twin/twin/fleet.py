"""Many cells at once: the compiled loop runs without the interpreter's lock, so that threads share the work."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ur5_twin.errors import SimulationError
from ur5_twin.twin.cell import Cell, Piece


def advance_all(cells: Sequence[Cell], targets: np.ndarray, *, threads: int | None = None) -> list[list[Piece]]:
    """Go on with every cell through its target rows.

    Which thread runs which cell makes no difference to the numbers.

    Args:
        cells: no cell twice.
        targets: (n, 3, 6) for all of them, or (n_cells, n, 3, 6).
        threads: how many; one for each core if not given.

    Returns:
        What ``Cell.advance`` returns, in the cells' order.

    Raises:
        SimulationError: the targets do not fit the cells, or a cell is there twice.
    """
    if len({id(cell) for cell in cells}) != len(cells):
        raise SimulationError("a cell is given twice: it cannot be at two places")
    each = np.broadcast_to(targets, (len(cells), *targets.shape)) if targets.ndim == 3 else targets
    if each.shape[0] != len(cells) or each.shape[2:] != (3, 6):
        raise SimulationError(f"targets are {targets.shape}; expected (n, 3, 6) or ({len(cells)}, n, 3, 6)")
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        return list(pool.map(lambda cell, rows: cell.advance(rows), cells, each))
