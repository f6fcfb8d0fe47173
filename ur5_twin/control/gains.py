"""PD gains of the joint-space controller, by name or from a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ur5_twin.arm import files


@dataclass(frozen=True)
class PDGains:
    """Gains of a = qdd_d - K0 (q - q_d) - K1 (qd - qd_d) (thesis equation 2.71).

    Attributes:
        kappa0: (6,) 1/s^2.
        kappa1: (6,) 1/s.
    """

    name: str
    source: str
    kappa0: np.ndarray
    kappa1: np.ndarray


def gain_names() -> tuple[str, ...]:
    """Names of the gain sets that ship."""
    return tuple(files.read_named("gains.toml", files.GainsSpec))


def load_gains(name: str | Path = "thesis_c") -> PDGains:
    """Gains by name (``models/gains.toml``) or from a file with one table of the same keys.

    Raises:
        ModelError: the name is unknown or the file is wrong.
    """
    key, spec = files.choose(name, "gains.toml", files.GainsSpec, "gain set")
    return PDGains(key, spec.source, np.array(spec.kappa0), np.array(spec.kappa1))
