"""Whatever is uploaded ends in a ScriptError or keeps to its share of a tick; memory and stack stay bounded."""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript import Interpreter, library, limits, parse
from ur5_twin.wire.urscript.lexer import KEYWORDS

_WORDS = st.sampled_from(
    [
        *sorted(KEYWORDS),
        *("f", "x", "p", "1", "2.5", "0x1F", '"s"', "sync()", "f()", "p[", "struct(", "x[0]", "x = 1"),
        *"()[],:=<+-*/%.$#\n",
    ]
)


def outcome(text: str, ticks: int = 4) -> str:
    """Upload a text and run it for some ticks; any exception but ScriptError comes through."""
    names = {"movej", "movel", "servoj", "f", "textmsg"}
    built_ins = {name: lambda *given, **named: 0 for name in names} | library()
    try:
        interpreter = Interpreter(parse(text), built_ins)
    except ScriptError:
        return "refused"
    for _ in range(ticks):
        interpreter.step()
    if interpreter.error is not None:
        assert str(interpreter.error).startswith("line ")
        assert not interpreter.running
        return str(interpreter.error)
    interpreter.kill_all()
    assert not interpreter.running
    return "ran"


@given(st.text(max_size=200))
@settings(max_examples=300, deadline=None)
def test_any_text(text: str) -> None:
    outcome(text)


@given(st.lists(_WORDS, max_size=60).map(" ".join))
@settings(max_examples=400, deadline=None)
def test_any_words(text: str) -> None:
    outcome(text)


@given(data=st.data())
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_client_s_program_with_lines_lost_doubled_and_cut(client_program: str, data: st.DataObject) -> None:
    lines = client_program.splitlines(keepends=True)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(lines) - 1))
        change = data.draw(st.sampled_from(["lose", "double", "cut", "swap", "end"]))
        if change == "lose":
            del lines[at]
        elif change == "double":
            lines.insert(at, lines[at])
        elif change == "cut":
            lines[at] = lines[at][: data.draw(st.integers(0, len(lines[at])))]
        elif change == "swap":
            lines[at], lines[-at - 1] = lines[-at - 1], lines[at]
        else:
            del lines[at + 1 :]
    outcome("".join(lines), ticks=3)


DEEP = 5000


@pytest.mark.parametrize(
    "text",
    [
        "x = " + "(" * DEEP,
        "x = " + "(" * DEEP + "1" + ")" * DEEP,
        "x = " + "[" * DEEP + "]" * DEEP,
        "x = " + "-" * DEEP + "1",
        "x = " + "not " * DEEP + "True",
        "x = 1" + " + 1" * DEEP,
        "x = 1" + "[0]" * DEEP,
        "x = 1" + ".a" * DEEP,
        "x = " + "sqrt(" * DEEP + "1" + ")" * DEEP,
        "x = " + "(1 + " * 70 + "1" + " + 1)" * 70,
        "if True:\n" * DEEP + "end\n" * DEEP,
        "while True:\n" * 30 + "end\n" * 30,
        "def f():\n" * DEEP + "end\n" * DEEP,
        "if True:\n" + "elif True:\n" * DEEP + "end",
        "x = 1\n" * 200_000,
        "x = " + "1" * 100_000,
        "x = 0x" + "1" * 100_000,
    ],
    ids=lambda text: text[:12].replace("\n", " "),
)
def test_what_nests_too_deeply_or_is_too_long_is_refused(text: str) -> None:
    assert outcome(text) == "refused"


@pytest.mark.parametrize(
    "text",
    [
        "x = " + "(" * 60 + "1" + ")" * 60,
        "x = True" + " and True" * 1000,
        "x = [" + "1, " * 2000 + "1]",
        "if True:\n" * 35 + "sync()\n" + "end\n" * 35,
        "while True:\n" * 15 + "sync()\n" + "end\n" * 15,
        "x = 0\nif x == 1:\n x = 1\n" + "elif x == 2:\n x = 1\n" * 190 + "end",
        "x = 1\n" * 20_000,
    ],
    ids=lambda text: text[:12].replace("\n", " "),
)
def test_what_is_long_but_within_the_limits_runs(text: str) -> None:
    assert outcome(text) == "ran"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def p():\n def f(n):\n  return f(n + 1)\n end\n f(0)\nend", "calls inside each other"),
        ("def p():\n p()\nend", "calls inside each other"),
        ("def p():\n thread t():\n  while True:\n   run t()\n  end\n end\n run t()\n join 2\nend", "threads at a time"),
        ('s = "ab"\nwhile True:\n s = s + s\nend', "at most 1023 are allowed"),
        ('s = "ab"\nwhile True:\n s = str_cat(s, s)\nend', "at most 1023 are allowed"),
        ("s = struct(a = [1, 2])\nwhile True:\n s = struct(a = s, b = s)\nend", "more than 2048 elements"),
        ("l = [[1, 2]]\nwhile True:\n l = [l, l]\nend", "rows of a matrix hold numbers"),
        ("l = make_list(0, struct(a = 1), 9999)", "more than 2048 elements"),
        ("l = make_list(0, struct(a = 1), 2048)\nl.append(make_list(2048, 0))", "cannot take a list"),
        ("x = 1\nwhile True:\n x = x * 3\nend", "integer overflow"),
    ],
)
def test_what_grows_without_end_is_ended(text: str, message: str) -> None:
    assert message in outcome(text, ticks=200)


def test_threads_that_never_wait_share_a_tick(start: Callable[..., Any]) -> None:
    text = "def p():\n thread t():\n  while True:\n   x = 1\n  end\n end\n i = 0\n"
    text += " while i < 40:\n  run t()\n  i = i + 1\n end\n while True:\n  sync()\n end\nend"
    ran = start(text)
    for _ in range(10):
        ran.steps(1)
        assert ran.interpreter.spent <= limits.TICK_BUDGET + limits.THREAD_BUDGET + 100
    assert ran.interpreter.error is None


def test_lists_are_charged_by_their_length(start: Callable[..., Any]) -> None:
    sums: list[int] = []
    ran = start("a = make_list(2048, 1.5)\nwhile True:\n b = a + a\n note(1)\nend", {"note": sums.append})
    ran.steps(100)
    # With the price of a sum, 2048 / 2 statements, there is less than one in a tick of 1000.
    assert 20 < len(sums) < 150


def test_what_all_variables_hold_together_is_bounded(start: Callable[..., Any]) -> None:
    """Lists in the variables of calls inside each other, in many threads."""
    locals_ = "\n".join(f"  a{number} = make_list(2048, 0.5)" for number in range(150))
    text = f"def p():\n def f(n):\n{locals_}\n  f(n + 1)\n end\n thread t():\n  f(0)\n end\n i = 0\n"
    text += " while i < 20:\n  run t()\n  i = i + 1\n end\n while True:\n  sync()\n end\nend"
    ran = start(text)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(500):
        ran.steps(1)
        if not ran.interpreter.running:
            break
    assert "hold more than" in str(ran.interpreter.error)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown * (1 if sys.platform == "linux" else 1 / 1024) < 200_000, "kB"


def test_a_program_reaches_nothing_of_python() -> None:
    for text in (
        "x = __builtins__",
        "x = open",
        'x = __import__("os")',
        "x = METER",
        "METER = 1\nx = b_sqrt",
        "d = 1\nx = t",
    ):
        assert outcome(text) == "refused"
    assert outcome("METER = 1\nd = 2\nt = 3\nLIST = 4\nx = [METER, d, t, LIST]\nassert(x == [1, 2, 3, 4])") == "ran"


def test_words_of_python_are_names_like_others() -> None:
    text = "def f(lambda, class = 2):\n import = lambda + class\n return import\nend\nassert(f(1) == 3)\n"
    assert outcome(text + "pass = f(class = 4, lambda = 1)\nassert(pass == 5)") == "ran"
