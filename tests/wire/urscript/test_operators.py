"""Arithmetic, against Python's own; lists, matrices, poses and how values print."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript import Interpreter, Pose, library, parse, shown
from ur5_twin.wire.urscript.values import Struct

_INTEGERS = st.integers(-1000, 1000)
_FLOATS = st.floats(-1e3, 1e3).map(lambda number: round(number, 6))


def _written(expression: Any) -> str:
    """An expression as URScript writes it."""
    if not isinstance(expression, tuple):
        text = repr(expression)
        return f"({text})" if text.startswith("-") else text
    sign, *parts = expression
    texts = [_written(part) for part in parts]
    if sign in ("neg", "not"):
        return f"({'-' if sign == 'neg' else 'not '}{texts[0]})"
    return f"({texts[0]} {sign} {texts[1]})"


def _worth(expression: Any) -> Any:
    """What Python says that it is worth."""
    if not isinstance(expression, tuple):
        return expression
    sign, *parts = expression
    first = _worth(parts[0])
    if (sign == "and" and not first) or (sign == "or" and first):
        return first
    worth = _OPERATIONS[sign](first, *map(_worth, parts[1:]))
    # Integers have 32 bits.
    return float(worth) if type(worth) is int and not -(2**31) <= worth < 2**31 else worth


def _modulo(a: float, b: float) -> float:
    """C's: with the sign of the dividend."""
    result = math.copysign(abs(a) % abs(b), a)
    return int(result) if isinstance(a, int) and isinstance(b, int) else result


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "%": _modulo,
    "neg": lambda a: -a,
    "not": lambda a: not a,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "xor": lambda a, b: a != b,
    "==": lambda a, b: a == b,
    "!=": lambda a, b: a != b,
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    ">": lambda a, b: a > b,
    ">=": lambda a, b: a >= b,
}
_NUMBERS = st.recursive(
    _INTEGERS | _FLOATS,
    lambda inner: st.tuples(st.sampled_from("+-*/%"), inner, inner) | st.tuples(st.just("neg"), inner),
    max_leaves=8,
)
_BOOLEANS = st.recursive(
    st.booleans() | st.tuples(st.sampled_from(["==", "!=", "<", "<=", ">", ">="]), _NUMBERS, _NUMBERS),
    lambda inner: st.tuples(st.sampled_from(["and", "or", "xor"]), inner, inner) | st.tuples(st.just("not"), inner),
    max_leaves=6,
)


def _evaluate(text: str) -> Any:
    found: list[Any] = []
    interpreter = Interpreter(parse(f"keep({text})"), {**library(), "keep": found.append})
    interpreter.step()
    if interpreter.error is not None:
        raise interpreter.error
    return found[0]


@given(_NUMBERS | _BOOLEANS)
@settings(max_examples=150, deadline=None)
def test_expressions_are_worth_what_python_says(expression: Any) -> None:
    try:
        expected = _worth(expression)
    except ZeroDivisionError:
        with pytest.raises(ScriptError, match=r"(by|modulo) zero"):
            _evaluate(_written(expression))
        return
    found = _evaluate(_written(expression))
    assert type(found) is type(expected)
    assert found == expected


@given(st.lists(_FLOATS, min_size=1, max_size=8), _FLOATS, st.sampled_from("+-*"))
@settings(max_examples=60, deadline=None)
def test_lists_are_taken_element_by_element(values: list[float], number: float, sign: str) -> None:
    operation = _OPERATIONS[sign]
    other = [value + 1.0 for value in values]
    brackets = f"({number!r})"
    assert _evaluate(f"{values!r} {sign} {other!r}") == [operation(a, b) for a, b in zip(values, other, strict=True)]
    assert _evaluate(f"{values!r} {sign} {brackets}") == [operation(a, number) for a in values]
    assert _evaluate(f"{brackets} {sign} {values!r}") == [operation(number, a) for a in values]


@given(st.integers(1, 4), st.integers(1, 4), st.integers(1, 4), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_matrices_multiply_as_in_linear_algebra(rows: int, inner: int, columns: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, x = (rng.integers(-9, 10, shape) for shape in ((rows, inner), (inner, columns), (inner,)))
    assert _evaluate(f"{a.tolist()} * {b.tolist()}") == (a @ b).tolist()
    assert _evaluate(f"{a.tolist()} * {x.tolist()}") == (a @ x).tolist()


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("[10, 20, 30] / [1, 2, 3]", [10.0, 10.0, 10.0]),
        ("[10, 20, 30] % [3, 3, 7]", [1, 2, 2]),
        ("10 / [1, 2, 4]", [10.0, 5.0, 2.5]),
        ("5 * [[1, 2], [3, 4]]", [[5, 10], [15, 20]]),
        ("[[1, 2], [3, 4]] - 1", [[0, 1], [2, 3]]),
        ("[[1, 2], [3, 4]] + [[1, 1], [1, 1]]", [[2, 3], [4, 5]]),
        ("-[1, -2]", [-1, 2]),
        ("[1, 2] == [1, 2]", True),
        ("p[1, 2, 3, 0, 0, 0] != p[1, 2, 3, 0, 0, 1]", True),
        ('"a" == "b"', False),
    ],
)
def test_operators_on_lists(expression: str, expected: Any) -> None:
    found = _evaluate(expression)
    assert found == expected
    assert repr(found) == repr(expected), "an integer stays one"


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        ("1.5 % 0", "1.5 modulo zero"),
        ("True + 1", "there is no True + 1"),
        ("+'a'", "there is no +a"),
        ("-True", "there is no -True"),
        ("[1, 2] + [1]", "lists of 2 and 1"),
        ("[[1, 2]] * [[1, 2]]", "columns must be as many"),
        ("[[1, 2], [3]] * [1, 2]", "rows of the same length"),
        ("[[True, False]] * [1, 2]", "numbers alone"),
        ('"a" < "b"', "there is no a < b"),
        ('not "a"', "a is neither True nor False"),
        ("[1, 2][-1]", "index -1 of a list of 2"),
        ("[1, 2][0.5]", "an index is a whole number, not 0.5"),
        ("[1, 2][sqrt(2) * 1e308 * 10]", "an index is a whole number, not inf"),
        ("5[0]", "5 is no list"),
        ("[1, 2][0, 0]", "1 is no list of lists"),
        ('p["a", 2, 3, 0, 0, 0]', "a pose is six numbers"),
        ("struct(a = 1).b", "has no 'b'"),
        ("[1].b", "has no 'b'"),
        ("nothing() + 1", "there is no None + 1"),
        ("[nothing()]", "'an item' would be nothing"),
        ("struct(a = nothing())", "'a' would be nothing"),
        ("norm(nothing())", "'norm' would be nothing"),
        ("twice(nothing())", "'n' would be nothing"),
    ],
)
def test_what_operators_refuse(expression: str, message: str) -> None:
    functions = "def twice(n):\n return n * 2\nend\ndef nothing():\nend\n"
    interpreter = Interpreter(parse(f"{functions}x = {expression}"), library())
    interpreter.step()
    assert message in str(interpreter.error)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (10, "10"),
        (2.123456123456, "2.123456"),
        (1.0, "1"),
        (100.0, "100"),
        (-0.0000001, "0"),
        (-2.50, "-2.5"),
        (1e20, "1e+20"),
        (math.inf, "inf"),
        (True, "True"),
        ("a b", "a b"),
        ([True, False], "[True, False]"),
        ([1, 0.5], "[1, 0.5]"),
        ([[1, 2], [3, 4]], "[[1, 2], [3, 4]]"),
        (Pose([1, 2, 3, 4, 5, 6.5]), "p[1, 2, 3, 4, 5, 6.5]"),
        (["a"], "[a]"),
        (Struct(a=1.0, b="x"), "struct(a=1, b=x)"),
    ],
)
def test_values_print_as_on_the_robot(value: Any, text: str) -> None:
    assert shown(value) == text


@pytest.mark.parametrize(
    "text",
    [
        "x = [1, 2]\nx[0] = [1]",
        "x = [[1, 2], [3, 4]]\nx[0] = 1",
        "x = [1, 2]\nx[0] = nothing()",
        "x = p[1, 2, 3, 0, 0, 0]\nx[0] = True",
        "x = struct(a = 1)\nx.a = nothing()",
        "x = struct(a = 1)\nx.b = 1",
    ],
)
def test_what_a_part_cannot_become(text: str) -> None:
    interpreter = Interpreter(parse(f"def nothing():\nend\n{text}"), library())
    interpreter.step()
    assert str(interpreter.error).startswith("line 4: ")
