"""Gains of the joint-space controller, by name or from a file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ur5_twin.arm import files


@dataclass(frozen=True)
class Gains:
    """Gains of a = A qdd_d - K0 e - K1 e' - KI int(e) dt (thesis equation 2.71 and an integral).

    e = q - (q_d - T qd_d): the servo follows its target by T late, as the real one does; the thesis' does not.

    Attributes:
        kappa0: (6,) 1/s^2.
        kappa1: (6,) 1/s.
        kappai: (6,) 1/s^3, zero for the thesis' gains.
        lag: T, (6,) s, zero for the thesis' gains.
        share: A, (6,) of the target's acceleration that is fed forward, one for the thesis' gains; an effective number,
            negative where the reference is smoothed (docs/servo.md).
    """

    name: str
    source: str
    kappa0: np.ndarray
    kappa1: np.ndarray
    kappai: np.ndarray = field(default_factory=lambda: np.zeros(6))
    lag: np.ndarray = field(default_factory=lambda: np.zeros(6))
    share: np.ndarray = field(default_factory=lambda: np.ones(6))


def gain_names() -> tuple[str, ...]:
    """Names of the gain sets that ship."""
    return tuple(files.read_named("gains.toml", files.GainsSpec))


def load_gains(name: str | Path = "thesis_c") -> Gains:
    """Gains by name (``models/gains.toml``) or from a file with one table of the same keys.

    Raises:
        ModelError: the name is unknown or the file is wrong.
    """
    key, spec = files.choose(name, "gains.toml", files.GainsSpec, "gain set")
    return Gains(
        key,
        spec.source,
        np.array(spec.kappa0),
        np.array(spec.kappa1),
        np.array(spec.kappai),
        np.array(spec.lag_ms) * 1e-3,
        np.array(spec.acceleration_share),
    )
