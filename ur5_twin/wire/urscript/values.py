"""URScript's values: bool, int, float, str, list, Pose, Struct, None, and what may be done with them.

A matrix is a list of lists. Numbers are 32 bit integers or floats; where an integer does not fit it becomes a float.
Values are copied where they are assigned, so that no two names share a list.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript import limits

_INT = 2**31


class Pose(list[float]):
    """``p[x, y, z, rx, ry, rz]``: m, and a rotation vector in rad.

    Raises:
        ScriptError: not six numbers.
    """

    def __init__(self, numbers: Sequence[Any]) -> None:
        if len(numbers) != 6 or not all(is_number(number) for number in numbers):
            raise ScriptError(f"a pose is six numbers, not {shown(list(numbers))}")
        super().__init__(float(number) for number in numbers)


class Struct(dict[str, "Value"]):
    """``struct(a = 1)``: named values."""


Value = bool | int | float | str | list | Struct | None


def is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def copied(value: Value) -> Value:
    """The same value, of which no part is shared."""
    if isinstance(value, Pose):
        return Pose(value)
    if isinstance(value, list):
        return [copied(item) for item in value]
    if isinstance(value, Struct):
        return Struct({name: copied(item) for name, item in value.items()})
    return value


def listed(items: list[Value]) -> list[Value]:
    """A list, of a size that is allowed.

    Raises:
        ScriptError: it is too long, or a list of lists of lists.
    """
    size = len(items)
    for item in items:
        if isinstance(item, list):
            size += len(item)
            if any(isinstance(inner, list | Struct) for inner in item):
                raise ScriptError("a list holds numbers, poses or rows of a matrix, nothing deeper")
    if size > limits.LIST:
        raise ScriptError(f"a list of {size} numbers; {limits.LIST} are the most")
    return items


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
        return str(int(value)) if value == int(value) and abs(value) < 1e15 else f"{value:.6g}"
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
    if isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            raise ScriptError(f"lists of {len(a)} and {len(b)} in {shown(a)[:40]} {sign} {shown(b)[:40]}")
        found = [arithmetic(sign, x, y) for x, y in zip(a, b, strict=True)]
    elif isinstance(a, list) and is_number(b):
        found = [arithmetic(sign, x, b) for x in a]
    elif is_number(a) and isinstance(b, list):
        found = [arithmetic(sign, a, y) for y in b]
    else:
        raise ScriptError(f"there is no {shown(a)[:40]} {sign} {shown(b)[:40]}")
    return Pose(found) if isinstance(a, Pose) or isinstance(b, Pose) else found  # type: ignore[arg-type]


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
    """``of[i] = value`` or ``of[i, j] = value``, in place."""
    holder, i = _place(of, indices)
    if isinstance(holder, Pose) and not is_number(value):
        raise ScriptError(f"a pose holds numbers, not {shown(value)[:40]}")
    if isinstance(value, list) and isinstance(holder[i], list) != isinstance(value, list):
        raise ScriptError("a list's item stays a number or a list")
    before = holder[i]
    holder[i] = float(value) if isinstance(holder, Pose) else copied(value)  # type: ignore[arg-type]
    try:
        listed(of if isinstance(of, list) else holder)
    except ScriptError:
        holder[i] = before
        raise


def _place(of: Value, indices: Sequence[Value]) -> tuple[list, int]:
    """The list and the place in it that indices mean."""
    for depth, index in enumerate(indices):
        if not isinstance(of, list):
            raise ScriptError(f"{shown(of)[:40]} is no list{' of lists' if depth else ''}")
        if not is_number(index) or index != int(index):  # type: ignore[arg-type]
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
    if not _is_matrix(b):
        return [sum_of(arithmetic("*", row, b)) for row in a]
    columns = [list(column) for column in zip(*b, strict=True)] if len({len(row) for row in b}) == 1 else None
    if columns is None or any(len(row) != len(b) for row in a):
        raise ScriptError("a matrix times another: the first one's columns must be as many as the second one's rows")
    return listed([[sum_of(arithmetic("*", row, column)) for column in columns] for row in a])


def sum_of(numbers: Value) -> float:
    """The sum of a list of numbers."""
    assert isinstance(numbers, list)
    if not all(is_number(number) for number in numbers):
        raise ScriptError(f"{shown(numbers)[:40]} is no list of numbers")
    return kept(sum(numbers))
