"""URScript's functions that need no robot. Names and parameters are URScript's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ur5_twin.wire.urscript.library import lists, maths, poses, strings


def library(seed: int = 0) -> dict[str, Callable[..., Any]]:
    """All of them; ``random`` draws from a generator of the seed."""
    rng = np.random.default_rng(seed)
    return {
        **maths.FUNCTIONS,
        **lists.FUNCTIONS,
        **strings.FUNCTIONS,
        **poses.FUNCTIONS,
        "random": lambda: float(rng.random()),
    }
