"""Functions of lists, vectors and matrices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript.costs import costs
from ur5_twin.wire.urscript.values import is_number, listed, shown


def array(name: str, value: Any, dimensions: tuple[int, ...] = (1,)) -> np.ndarray:
    """A list of numbers, or a matrix, as an array.

    Raises:
        ScriptError: it is neither, or does not have one of the ``dimensions``.
    """
    try:
        found = np.array(value, dtype=float)
    except (TypeError, ValueError):
        found = np.empty(())
    if not isinstance(value, list) or found.ndim not in dimensions or not found.size:
        what = " or ".join("a list of numbers" if n == 1 else "a matrix" for n in dimensions)
        raise ScriptError(f"{name} of {shown(value)[:40]}: not {what}")
    return found


@costs(8)
def norm(a: Any) -> float:
    """Length of a vector, or the size of a number."""
    return abs(a) if is_number(a) else float(np.linalg.norm(array("norm", a)))


@costs(8)
def normalize(v: Any) -> list[float]:
    """The unit vector along v."""
    found = array("normalize", v)
    length = float(np.linalg.norm(found))
    if length == 0.0:
        raise ScriptError("normalize of a vector without length")
    return (found / length).tolist()


def get_list_length(v: Any) -> int:
    """How many items a list has."""
    if not isinstance(v, list):
        raise ScriptError(f"get_list_length of {shown(v)[:40]}: not a list")
    return len(v)


def length(v: Any) -> int:
    """Items of a list, or characters of a string."""
    if not isinstance(v, list | str):
        raise ScriptError(f"length of {shown(v)[:40]}: neither a list nor a string")
    return len(v)


def size(v: Any) -> int | list[int]:
    """Items of a list; rows and columns of a matrix."""
    if isinstance(v, list) and v and isinstance(v[0], list):
        return list(array("size", v, (2,)).shape)
    return length(v)


def inverse(m: Any) -> list[list[float]]:
    """Inverse of a square matrix."""
    found = array("inv", m, (2,))
    try:
        return np.linalg.inv(found).tolist()
    except np.linalg.LinAlgError:
        raise ScriptError("inv of a matrix that has no inverse") from None


def transpose(m: Any) -> list[list[float]]:
    """Rows as columns."""
    return array("transpose", m, (2,)).T.tolist()


@costs(8)
def dot(a: Any, b: Any) -> float:
    """Inner product of two vectors."""
    left, right = array("dot", a), array("dot", b)
    if len(left) != len(right):
        raise ScriptError(f"dot of vectors of {len(left)} and {len(right)}")
    return float(left @ right)


@costs(20)
def cross(a: Any, b: Any) -> list[float]:
    """Cross product of two vectors of three."""
    left, right = array("cross", a), array("cross", b)
    if len(left) != 3 or len(right) != 3:
        raise ScriptError("cross takes two vectors of three")
    return np.cross(left, right).tolist()


def make_list(length: Any, initial_value: Any, capacity: Any = 0) -> list[Any]:
    """A list of one value; lists need no capacity here."""
    if not isinstance(length, int) or not 0 <= length <= 10_000 or not is_number(capacity):
        raise ScriptError(f"make_list of {shown(length)[:40]} items")
    return listed([initial_value] * length)


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "norm": norm,
    "normalize": normalize,
    "get_list_length": get_list_length,
    "length": length,
    "size": size,
    "transpose": transpose,
    "dot": dot,
    "cross": cross,
    "make_list": make_list,
}
