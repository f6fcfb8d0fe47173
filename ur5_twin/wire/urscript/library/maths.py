"""Functions of numbers. Angles are in rad."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript.values import is_number, kept, shown


def _of(name: str, function: Callable[[float], float]) -> Callable[[Any], float]:
    """A function of one number, with URScript's error for anything else."""

    def call(f: Any) -> float:
        if not is_number(f):
            raise ScriptError(f"{name} of {shown(f)[:40]}: not a number")
        try:
            return kept(function(f))
        except (ValueError, OverflowError):
            raise ScriptError(f"{name} of {shown(f)}: not defined there") from None

    return call


def _numbers(name: str, *values: Any) -> None:
    for value in values:
        if not is_number(value):
            raise ScriptError(f"{name} of {shown(value)[:40]}: not a number")


def atan2(y: Any, x: Any) -> float:
    _numbers("atan2", y, x)
    return math.atan2(y, x)


def power(base: Any, exponent: Any) -> float:
    """base to the exponent, a float."""
    _numbers("pow", base, exponent)
    try:
        found = float(base) ** float(exponent)
    except (ZeroDivisionError, OverflowError):
        found = math.nan
    if isinstance(found, complex) or math.isnan(found):
        raise ScriptError(f"pow of {shown(base)} and {shown(exponent)}: not defined there")
    return found


def log(b: Any, f: Any) -> float:
    """Logarithm of f to the base b."""
    _numbers("log", b, f)
    if b <= 0 or b == 1 or f <= 0:
        raise ScriptError(f"log of {shown(f)} to the base {shown(b)}: not defined there")
    return math.log(f) / math.log(b)


def binary_list_to_integer(l: Any) -> int:  # noqa: E741 - URScript's name
    """The whole number whose bits a list of bools is, the lowest first; 32 at most, the last one the sign."""
    if not isinstance(l, list) or len(l) > 32 or not all(isinstance(bit, bool) for bit in l):
        raise ScriptError("binary_list_to_integer takes a list of at most 32 bools")
    number = sum(1 << place for place, bit in enumerate(l) if bit)
    return number - (1 << 32) if number >= 1 << 31 else number


def integer_to_binary_list(x: Any) -> list[bool]:
    """The 32 bits of a whole number, the lowest first."""
    if not isinstance(x, int) or isinstance(x, bool):
        raise ScriptError(f"integer_to_binary_list of {shown(x)[:40]}: not an integer")
    return [bool(x >> place & 1) for place in range(32)]


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": _of("sin", math.sin),
    "cos": _of("cos", math.cos),
    "tan": _of("tan", math.tan),
    "asin": _of("asin", math.asin),
    "acos": _of("acos", math.acos),
    "atan": _of("atan", math.atan),
    "sqrt": _of("sqrt", math.sqrt),
    "ceil": _of("ceil", math.ceil),
    "floor": _of("floor", math.floor),
    "d2r": _of("d2r", math.radians),
    "r2d": _of("r2d", math.degrees),
    "atan2": atan2,
    "pow": power,
    "log": log,
    "binary_list_to_integer": binary_list_to_integer,
    "integer_to_binary_list": integer_to_binary_list,
}
