"""From a recording to samples, and through an estimator: only what a real robot publishes gets through."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ur5_twin.errors import EstimationError
from ur5_twin.estimation.intake import TORQUE_SIGNALS
from ur5_twin.estimation.protocol import Estimate, Estimator, Sample
from ur5_twin.recording.table import COLUMN_WIDTHS, Recording

#: The controller's own stamp, where a table has it beside the time of arrival.
_STAMP = "timestamp"


@dataclass(frozen=True)
class Estimates:
    """Estimates of a log, one row a sample, as ``Estimate`` has them.

    Attributes:
        time: (n,) s.
        tau_ext, wrench: (n, 6).
        covariance: (n, 6, 6).
        contact, sigma_min: (n,).
    """

    time: np.ndarray
    tau_ext: np.ndarray
    wrench: np.ndarray
    covariance: np.ndarray
    contact: np.ndarray
    sigma_min: np.ndarray


def samples_of(recording: Recording) -> Iterator[Sample]:
    """The samples of a recording, in order, on the robot's clock; what it does not hold is NaN.

    Raises:
        EstimationError: a signal is missing without which no estimator can do anything.
    """
    missing = [name for name in TORQUE_SIGNALS if name not in recording.robot]
    if missing:
        raise EstimationError(
            f"{recording.source}: no {', '.join(missing)}; an estimator needs {', '.join(TORQUE_SIGNALS)}"
        )
    table = recording.aligned()
    yield from samples_from(table[_STAMP][:, 0] if _STAMP in table else table.time, table.columns)


def samples_from(time: np.ndarray, columns: Mapping[str, np.ndarray]) -> Iterator[Sample]:
    """The samples of rows (n, width) at (n,) s; what the columns do not hold is NaN."""
    n = len(time)
    fields = [
        np.ascontiguousarray(columns[name]) if name in columns else np.full((n, COLUMN_WIDTHS[name]), np.nan)
        for name in Sample._fields[1:]
    ]
    for row in zip(time.tolist(), *fields, strict=True):
        yield Sample(*row)


def estimate(estimator: Estimator, samples: Iterable[Sample]) -> Estimates:
    """An estimator's answer to each of the samples."""
    time, rows = [], []
    for sample in samples:
        time.append(sample.time)
        rows.append(estimator.update(sample))
    return stacked(time, rows)


def stacked(time: Iterable[float], rows: list[Estimate]) -> Estimates:
    """Estimates one by one as arrays."""
    shapes = ((6,), (6,), (6, 6), (), ())
    columns = [np.array([row[i] for row in rows], dtype=float).reshape(-1, *shape) for i, shape in enumerate(shapes)]
    return Estimates(np.array(list(time), dtype=float), *columns)
