"""URScript's values: bool, int, float, str, list, Pose, Struct, None, and what may be done with them.

A matrix is a list of lists. Numbers are 32 bit integers or floats; where an integer does not fit it becomes a float.
Values are copied where they are assigned, so that no two names share a list.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Sequence
from itertools import repeat
from typing import Any, TypeVar

import numpy as np

from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript import limits

_INT = 2**31
#: From here on floats are shown with an exponent.
_LONG = 1e15


class Pose(list[float]):
    """``p[x, y, z, rx, ry, rz]``: m, and a rotation vector in rad.

    Raises:
        ScriptError: not six numbers.
    """

    def __init__(self, numbers: Sequence[Any]) -> None:
        if len(numbers) != 6 or not all(is_number(number) for number in numbers):
            raise ScriptError(f"a pose is six numbers, not {shown(list(numbers))}")
        super().__init__(float(number) for number in numbers)

    @classmethod
    def of(cls, pose: Pose) -> Pose:
        """A copy of one, which needs no check."""
        new = cls.__new__(cls)
        new.extend(pose)
        return new


class Struct(dict[str, "Value"]):
    """``struct(a = 1)``: named values."""


Value = bool | int | float | str | list | Struct | None
#: Exact types of values that nothing can change, and of those that weigh one.
SCALARS = frozenset((float, int, bool, str, type(None)))
NUMBERS = frozenset((float, int, bool))
_Holder = TypeVar("_Holder", bound="list | Struct")


def is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def copied(value: Value) -> Value:
    """The same value, of which no part is shared."""
    kind = type(value)
    if kind is list:
        return [item if type(item) in SCALARS else copied(item) for item in value]  # type: ignore[union-attr]
    if kind is Pose:
        return Pose.of(value)  # type: ignore[arg-type]
    if kind is Struct:
        return Struct({name: copied(item) for name, item in value.items()})  # type: ignore[union-attr]
    return value


def weight(value: Value, depth: int = 0) -> int:
    """Numbers in a value; a string counts as one for every so many characters, a struct's names as one each.

    Raises:
        ScriptError: structs are too deep within one another.
    """
    if isinstance(value, str):
        return 1 + len(value) // limits.CHARACTERS
    if not isinstance(value, list | Struct):
        return 1
    if depth > limits.STRUCTS:
        raise ScriptError(f"structs more than {limits.STRUCTS} deep within one another")
    items = value.values() if isinstance(value, Struct) else value
    total = 1 + 2 * len(value) if isinstance(value, Struct) else len(value)
    for item in items:
        if type(item) not in NUMBERS:
            total += weight(item, depth + 1)
    return total


def bounded(value: _Holder) -> _Holder:
    """A list or struct, of a size that is allowed.

    Raises:
        ScriptError: it is too large, or structs are too deep within one another.
    """
    size = weight(value)
    if size > limits.LIST:
        raise ScriptError(f"a list or struct of {size} numbers; {limits.LIST} are the most")
    return value


def listed(items: list[Value]) -> list[Value]:
    """A list, of a size that is allowed.

    Raises:
        ScriptError: it is too long, or a list of lists of lists.
    """
    for item in items:
        if isinstance(item, list) and any(isinstance(inner, list | Struct) for inner in item):
            raise ScriptError("a list holds numbers, poses or rows of a matrix, nothing deeper")
    return bounded(items)


def truth(value: Value) -> bool:
    """What a condition says.

    Raises:
        ScriptError: it is neither a bool nor a number.
    """
    if isinstance(value, bool):
        return value
    if is_number(value):
        return value != 0
    raise ScriptError(f"{shown(value)} is neither True nor False")


def kept(number: float) -> int | float:
    """A number as a variable keeps it."""
    if isinstance(number, int) and not -_INT <= number < _INT:
        return float(number)
    return number


def shown(value: Value) -> str:
    """A value as the robot prints it."""
    if isinstance(value, bool) or value is None:
        return str(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            return str(value)
        if abs(value) >= _LONG:
            return f"{value:.6g}"
        decimal = f"{value:.6f}".rstrip("0").rstrip(".")
        return "0" if decimal == "-0" else decimal
    if isinstance(value, list):
        inner = ", ".join(shown(item) for item in value)
        return f"{'p' if isinstance(value, Pose) else ''}[{inner}]"
    if isinstance(value, Struct):
        return "struct(" + ", ".join(f"{name}={shown(item)}" for name, item in value.items()) + ")"
    return str(value)


def negative(value: Value) -> Value:
    """-value, item by item of a list."""
    if isinstance(value, list):
        found = [negative(item) for item in value]
        return Pose(found) if isinstance(value, Pose) else found
    if not is_number(value):
        raise ScriptError(f"there is no -{shown(value)}")
    return kept(-value)  # type: ignore[operator]


def _divided(a: float, b: float) -> float:
    if b == 0:
        raise ScriptError(f"{shown(a)} divided by zero")
    return a / b


def _left_over(a: float, b: float) -> float:
    if b == 0:
        raise ScriptError(f"{shown(a)} modulo zero")
    return math.fmod(a, b) if isinstance(a, float) or isinstance(b, float) else int(math.fmod(a, b))


_NUMBERS: dict[str, Callable[[float, float], float]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": _divided,
    "%": _left_over,
}


def arithmetic(sign: str, a: Value, b: Value) -> Value:
    """``a sign b``: of numbers, of lists item by item, of a list with a number, of matrices, and strings joined.

    Two integers divided make a float.

    Raises:
        ScriptError: the two do not go together.
    """
    if is_number(a) and is_number(b):
        return kept(_NUMBERS[sign](a, b))  # type: ignore[arg-type]
    if sign == "+" and (isinstance(a, str) or isinstance(b, str)):
        return text(shown(a) + shown(b))
    if sign == "*" and _is_matrix(a) and isinstance(b, list):
        return _product(a, b)  # type: ignore[arg-type]
    pairs: Iterable[tuple[Any, Any]]
    if isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            raise ScriptError(f"lists of {len(a)} and {len(b)} in {shown(a)[:40]} {sign} {shown(b)[:40]}")
        pairs = zip(a, b, strict=True)
    elif isinstance(a, list) and is_number(b):
        pairs = zip(a, repeat(b))
    elif is_number(a) and isinstance(b, list):
        pairs = zip(repeat(a), b)
    else:
        raise ScriptError(f"there is no {shown(a)[:40]} {sign} {shown(b)[:40]}")
    work: Callable[[Any, Any], Any] = _NUMBERS[sign]
    # Floats are most of what lists hold, and need no check.
    found = [work(x, y) if type(x) is float is type(y) else arithmetic(sign, x, y) for x, y in pairs]
    return Pose(found) if isinstance(a, Pose) or isinstance(b, Pose) else found


def compared(sign: str, a: Value, b: Value) -> bool:
    """``a sign b``; lists and strings are equal or not, only numbers are larger or smaller.

    Raises:
        ScriptError: the two cannot be compared.
    """
    if sign in ("==", "!="):
        return (a == b) == (sign == "==")
    if not (is_number(a) and is_number(b)):
        raise ScriptError(f"there is no {shown(a)[:40]} {sign} {shown(b)[:40]}")
    return _ORDER[sign](a, b)


_ORDER: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
}


def text(of: str) -> str:
    """A string, of a length that is allowed."""
    if len(of) > limits.STRING:
        raise ScriptError(f"a string of {len(of)} characters; {limits.STRING} are the most")
    return of


def item(of: Value, indices: Sequence[Value]) -> Value:
    """``of[i]`` or ``of[i, j]``."""
    holder, i = _place(of, indices)
    return holder[i]


def set_item(of: Value, indices: Sequence[Value], value: Value) -> None:
    """``of[i] = value`` or ``of[i, j] = value``, in place; the value must be nobody else's."""
    holder, i = _place(of, indices)
    before = holder[i]
    if isinstance(holder, Pose):
        if not is_number(value):
            raise ScriptError(f"a pose holds numbers, not {shown(value)[:40]}")
        value = float(value)  # type: ignore[arg-type]
    if value is None:
        raise ScriptError("a list's item would be nothing: the function gives no value")
    if isinstance(before, list) != isinstance(value, list):
        raise ScriptError("a list's item stays a number or a list")
    holder[i] = value  # type: ignore[assignment]
    if type(value) not in NUMBERS:
        listed(of if isinstance(of, list) else holder)


def _place(of: Value, indices: Sequence[Value]) -> tuple[list, int]:
    """The list and the place in it that indices mean."""
    for depth, index in enumerate(indices):
        if not isinstance(of, list):
            raise ScriptError(f"{shown(of)[:40]} is no list{' of lists' if depth else ''}")
        if not is_number(index) or not float(index).is_integer():  # type: ignore[arg-type]
            raise ScriptError(f"an index is a whole number, not {shown(index)[:40]}")
        i = int(index)  # type: ignore[arg-type]
        if not 0 <= i < len(of):
            raise ScriptError(f"index {i} of a list of {len(of)}")
        if depth == len(indices) - 1:
            return of, i
        of = of[i]
    raise ScriptError("an index is missing")


def _is_matrix(value: Value) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(row, list) for row in value)


def _product(a: list[list[float]], b: list) -> Value:
    """Matrix times matrix or column."""
    left: Any
    right: Any
    try:
        left, right = np.array(a), np.array(b)
    except ValueError:
        left = right = np.empty(0)
    if {left.dtype.kind, right.dtype.kind} - set("if") or left.ndim != 2 or right.ndim not in (1, 2):
        raise ScriptError(f"{shown(a)[:40]} * {shown(b)[:40]}: a matrix has rows of the same length, and numbers alone")
    if left.shape[1] != len(right):
        raise ScriptError("a matrix times another: the first one's columns must be as many as the second one's rows")
    if len(left) * right[0].size > limits.LIST:
        raise ScriptError(f"a product of {len(left) * right[0].size} numbers; {limits.LIST} are the most")
    whole = left.dtype.kind == right.dtype.kind == "i"
    # As floats: the products of large integers would overflow.
    found = left.astype(float) @ right.astype(float)
    return _rounded(found.tolist()) if whole else found.tolist()


def _rounded(numbers: Any) -> Any:
    """Whole numbers, in lists, as integers where they fit."""
    if isinstance(numbers, list):
        return [_rounded(number) for number in numbers]
    return int(numbers) if -_INT <= numbers < _INT else numbers
