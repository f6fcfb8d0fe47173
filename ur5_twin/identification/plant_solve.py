"""Least squares of one joint's window means, and intervals that hold; see ``plant`` for the law.

The unknowns are 1/k and the law's other numbers over k, linear but for the speed at which friction fades. That one is
sought by what the fading explains beyond all other columns (variable projection), and counts in the intervals by its
derivative.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import lsq_linear, minimize_scalar
from scipy.stats import t as student

from ur5_twin.identification import spread
from ur5_twin.identification.plant_windows import Windows

#: Numbers of a joint with their units.
FIELDS: Mapping[str, str] = {
    "torque_constant": "Nm/A",
    "rotor_inertia": "kg m^2",
    "coulomb_positive": "Nm",
    "coulomb_negative": "Nm",
    "load": "Nm/Nm",
    "viscous": "Nm s/rad",
    "stribeck": "Nm",
    "stribeck_speed": "rad/s",
}
#: A torque constant beyond which no UR5 has one, Nm/A.
_LARGEST_CONSTANT = 40.0
#: Speeds between which that of the fading is sought, rad/s.
FADING = (0.01, 0.15)
_CONFIDENCE = 0.95
#: What recordings without noise bias the numbers by, shares of them, root mean square over joints and plants of
#: ``benchmarks/identify_recovery.py``: no number of recordings takes it away, so that intervals contain it.
_BIAS: Mapping[str, float] = {
    "torque_constant": 0.0005,
    "rotor_inertia": 0.005,
    "coulomb_positive": 0.003,
    "coulomb_negative": 0.003,
    "load": 0.016,
    "viscous": 0.002,
}
#: Singular value over the largest, of columns of length 1, below which a direction says nothing.
_SINGULAR = 1e-6


@dataclass(frozen=True)
class Solution:
    """One joint's numbers.

    Attributes:
        values: field (``FIELDS``) -> number.
        low, high: ends of its 95 % interval; NaN for what was known.
        amplitude, phase, amplitude_error: (n_orders,) of the ripple, Nm, rad and standard error in Nm.
        condition: of the columns, each scaled to length 1.
        entangled: correlation of the errors of torque constant and rotor inertia; NaN where one is known.
        left: standard deviation of what is left of the window means, A.
        tangent: (n, m) derivatives of the windows' current in all that was free, A by unit.
        error: (n,) what a fit without bounds leaves of it, A.
    """

    values: Mapping[str, float]
    low: Mapping[str, float]
    high: Mapping[str, float]
    amplitude: np.ndarray
    phase: np.ndarray
    amplitude_error: np.ndarray
    condition: float
    entangled: float
    left: float
    tangent: np.ndarray = field(repr=False)
    error: np.ndarray = field(repr=False)

    def half(self, name: str) -> float:
        """Half the width of a number's interval, 0 for what is known."""
        return 0.0 if np.isnan(self.low[name]) else 0.5 * (self.high[name] - self.low[name])


@dataclass(frozen=True)
class Shared:
    """Numbers that all joints have in common, fitted beside a joint's own: a payload's.

    Attributes:
        slope: (n, k) derivative of the windows' current in them, A by unit.
        influence: (blocks and more, k) what each second of the logs, and what was known of them, adds to their error.
    """

    slope: np.ndarray
    influence: np.ndarray

    def at(self, which: np.ndarray) -> Shared:
        """Of some of the windows."""
        return replace(self, slope=self.slope[which])


@dataclass(frozen=True)
class _Design:
    """Columns (n, m) for the unknowns ``free``, then for the ripple; the answer (n,), A, and 1/k if it is known."""

    free: tuple[str, ...]
    columns: np.ndarray
    answer: np.ndarray
    inverse_constant: float | None


def solve(w: Windows, known: Mapping[str, float], shared: Shared | None = None) -> Solution:
    """Fit all numbers that are not ``known`` (field -> number); ``stribeck_speed`` is free only beside ``stribeck``.

    Intervals contain the error of what is ``shared``, and the bias of windows.
    """
    speed = known.get("stribeck_speed")
    seek = speed is None
    if speed is None:
        speed = _fading_speed(w, known)
    fade, slope = w.fading(speed)
    return _solution(w, _design(w, known, fade), known, speed, slope if seek else None, shared)


def unexplained(w: Windows, speed: float) -> float:
    """Sum of squares (A^2) that all columns leave, friction fading at a given speed, rad/s."""
    design = _design(w, {}, w.fading(speed)[0])
    error = design.answer - design.columns @ np.linalg.lstsq(design.columns, design.answer, rcond=None)[0]
    return float(error @ error)


def _fading_speed(w: Windows, known: Mapping[str, float]) -> float:
    design = _design(w, known, None)
    basis = np.linalg.qr(design.columns)[0]
    rest = design.answer - basis @ (basis.T @ design.answer)

    def explained(log_speed: float) -> float:
        fade = w.fading(float(np.exp(log_speed)))[0]
        beyond = fade - basis @ (basis.T @ fade)
        return -float((beyond @ rest) ** 2 / (beyond @ beyond + 1e-300))

    found = minimize_scalar(explained, bounds=np.log(FADING), method="bounded", options={"xatol": 1e-3})
    return float(np.exp(found.x))


def _design(w: Windows, known: Mapping[str, float], fade: np.ndarray | None) -> _Design:
    """The columns; without ``fade`` those of everything but friction that fades."""
    columns = {
        "rotor_inertia": w.rotor,
        "coulomb_positive": w.forward,
        "coulomb_negative": w.backward,
        "load": w.load,
        "viscous": w.viscous,
    }
    if fade is not None:
        columns["stribeck"] = fade
    # What is known of the torques goes with the links', whose factor is 1/k.
    torque = w.link + sum((known[name] * column for name, column in columns.items() if name in known), 0.0)
    free = {name: column for name, column in columns.items() if name not in known}
    answer, inverse = w.current, None
    if "torque_constant" in known:
        inverse = 1.0 / known["torque_constant"]
        answer = answer - inverse * torque
    else:
        free = {"torque_constant": torque, **free}
    return _Design(tuple(free), np.column_stack([*free.values(), w.ripple]), answer, inverse)


def _solution(
    w: Windows,
    design: _Design,
    known: Mapping[str, float],
    speed: float,
    fade_slope: np.ndarray | None,
    shared: Shared | None,
) -> Solution:
    free, columns, answer, n = design.free, design.columns, design.answer, len(design.free)
    plain = np.linalg.lstsq(columns, answer, rcond=None)[0]
    least = [1.0 / _LARGEST_CONSTANT if f == "torque_constant" else -np.inf if f == "stribeck" else 0.0 for f in free]
    low = np.array(least + [-np.inf] * (len(plain) - n))
    x = plain if (plain >= low).all() else lsq_linear(columns, answer, bounds=(low, np.inf), method="bvls").x
    values = {**known, **_numbers(free, x, design.inverse_constant), "stribeck_speed": speed}
    # Friction may not push: no more may fade than there is.
    values["stribeck"] = max(values["stribeck"], -min(values["coulomb_positive"], values["coulomb_negative"]))
    # The interval is that of the fit without bounds, cut at them: a bound that holds must not feign certainty.
    center = {**known, **_numbers(free, plain, design.inverse_constant), "stribeck_speed": speed}
    inverse = 1.0 / center["torque_constant"]
    tangent = columns
    if fade_slope is not None:
        tangent = np.column_stack([columns, inverse * center["stribeck"] * fade_slope])
    error = answer - columns @ plain
    covariance, freedom = _sandwich(tangent, error, w, shared)
    slopes = _slopes(free, center, inverse, tangent.shape[1], seek=fade_slope is not None)
    free_of = _untold(tangent)
    std = {
        name: np.inf
        if np.abs(free_of @ row).any()
        else float(np.hypot(np.sqrt(row @ covariance @ row), _BIAS.get(name, 0.0) * center[name]))
        for name, row in slopes.items()
    }
    width = float(student.ppf(0.5 + 0.5 * _CONFIDENCE, max(freedom, 1)))
    ends = {
        side: {
            name: np.nan
            if name not in std
            else max(center[name] + sign * width * std[name], -np.inf if name == "stribeck" else 0.0)
            for name in FIELDS
        }
        for side, sign in (("low", -1.0), ("high", 1.0))
    }
    both = [slopes[name] for name in ("torque_constant", "rotor_inertia") if name in slopes]
    entangled = np.nan
    if len(both) == 2 and np.isfinite(std["torque_constant"] * std["rotor_inertia"]):
        entangled = both[0] @ covariance @ both[1] / (std["torque_constant"] * std["rotor_inertia"])
    constant = values["torque_constant"]
    c, s = constant * x[n::2], constant * x[n + 1 :: 2]
    wave_error = constant * np.sqrt(np.maximum(np.diagonal(covariance)[n : len(plain)], 0.0))
    return Solution(
        values=values,
        low=ends["low"],
        high=ends["high"],
        amplitude=np.hypot(c, s),
        phase=np.arctan2(-s, c),
        amplitude_error=np.hypot(wave_error[::2], wave_error[1::2]) / np.sqrt(2.0),
        condition=float(np.linalg.cond(tangent / np.maximum(np.linalg.norm(tangent, axis=0), 1e-12))),
        entangled=float(entangled),
        left=float((answer - columns @ x).std()),
        tangent=tangent,
        error=error,
    )


def _numbers(free: tuple[str, ...], x: np.ndarray, inverse: float | None) -> dict[str, float]:
    """The law's numbers from the unknowns."""
    inverse = float(x[0]) if inverse is None else inverse
    numbers = {name: float(x[i]) / inverse for i, name in enumerate(free)}
    return numbers | {"torque_constant": 1.0 / inverse}


def _slopes(
    free: tuple[str, ...], center: Mapping[str, float], inverse: float, width: int, *, seek: bool
) -> dict[str, np.ndarray]:
    """Field -> (width,) derivative in the unknowns: d(x / a) = (dx - (x / a) da) / a and dk = -k^2 da, with a = 1/k."""
    slopes = {}
    for i, name in enumerate(free):
        row = np.zeros(width)
        if name == "torque_constant":
            row[i] = -1.0 / inverse**2
        else:
            row[i] = 1.0 / inverse
            if free[0] == "torque_constant":
                row[0] = -center[name] / inverse
        slopes[name] = row
    if seek:
        slopes["stribeck_speed"] = np.eye(width)[-1]
    return slopes


def _untold(columns: np.ndarray) -> np.ndarray:
    """(k, m) directions of the unknowns that change nothing: along them a sandwich would feign certainty."""
    length = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    _, size, directions = np.linalg.svd(columns / length, full_matrices=False)
    none = directions[size < _SINGULAR * size[0]] / length
    return np.where(np.abs(none) > _SINGULAR * np.abs(none).max(axis=1, keepdims=True, initial=0.0), none, 0.0)


def _sandwich(columns: np.ndarray, error: np.ndarray, w: Windows, shared: Shared | None) -> tuple[np.ndarray, int]:
    """Covariance of least squares whose errors are correlated within blocks, and its degrees of freedom.

    sum over blocks of u_b u_b' times G / (G - p), for G blocks with windows and p columns, u_b = (A'A)^-1 A_b' e_b. An
    error d of shared numbers with derivative S moves the fit by -(A'A)^-1 A'S d.
    """
    inverse = np.linalg.pinv(columns.T @ columns, hermitian=True)
    influence = spread.by_block(columns * error[:, None], w.block, w.blocks) @ inverse
    if shared is not None:
        influence = np.pad(influence, ((0, len(shared.influence) - w.blocks), (0, 0)))
        influence -= shared.influence @ (inverse @ (columns.T @ shared.slope)).T
    number = len(np.unique(w.block))
    freedom = number - columns.shape[1]
    return number / max(freedom, 1) * influence.T @ influence, freedom
