"""Functions of strings."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript.values import kept, shown, text

_NUMBER = re.compile(
    r"\s*+(?:(?P<whole>[+-]?\d++)|[+-]?(?:\d++\.?\d*+|\.\d++)(?:[eE][+-]?\d++)?+|[+-]?(?i:inf)|0[xX](?P<hex>[\da-fA-F]{1,16}))\s*+",
    re.ASCII,
)
_DIGITS = 20


def _strings(name: str, *values: Any) -> None:
    for value in values:
        if not isinstance(value, str):
            raise ScriptError(f"{name} of {shown(value)[:40]}: not a string")


def to_str(val: Any) -> str:
    """A value as the robot prints it."""
    return text(shown(val))


def to_num(str: Any) -> int | float:
    """The number that a string is."""
    _strings("to_num", str)
    found = _NUMBER.fullmatch(str)
    if found is None:
        raise ScriptError(f"to_num of '{str[:40]}': not a number")
    if found["hex"]:
        return kept(int(found["hex"], 16))
    # Within so many digits: more would take long, and be no integer.
    return kept(int(str)) if found["whole"] and len(str) <= _DIGITS else float(str)


def str_cat(op1: Any, op2: Any) -> str:
    """One after the other."""
    return text(shown(op1) + shown(op2))


def str_at(src: Any, index: Any) -> str:
    """The character at a place."""
    _strings("str_at", src)
    if not isinstance(index, int) or not 0 <= index < len(src):
        raise ScriptError(f"str_at: place {shown(index)} of a string of {len(src)}")
    return src[index]


def str_empty(str: Any) -> bool:
    """Whether a string has no characters."""
    _strings("str_empty", str)
    return not str


def str_len(str: Any) -> int:
    """Its characters."""
    _strings("str_len", str)
    return len(str)


def str_find(src: Any, target: Any, start_from: Any = 0) -> int:
    """Where a string is in another, from a place on; -1 if it is not."""
    _strings("str_find", src, target)
    if not isinstance(start_from, int) or start_from < 0:
        raise ScriptError(f"str_find from {shown(start_from)[:40]}: not a place")
    return src.find(target, int(start_from))


def str_sub(src: Any, index: Any, len: Any = -1) -> str:
    """A part of a string, ``len`` characters long or to its end."""
    _strings("str_sub", src)
    if not (isinstance(index, int) and isinstance(len, int) and index >= 0):
        raise ScriptError(f"str_sub from {shown(index)[:40]}, {shown(len)[:40]} long: not whole numbers")
    return src[index:] if len < 0 else src[index : index + len]


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "to_str": to_str,
    "to_num": to_num,
    "str_cat": str_cat,
    "str_at": str_at,
    "str_empty": str_empty,
    "str_len": str_len,
    "str_find": str_find,
    "str_sub": str_sub,
}
