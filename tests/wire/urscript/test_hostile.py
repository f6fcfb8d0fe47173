"""Whatever is uploaded ends in a ScriptError or keeps to its share of a tick; memory and stack stay bounded.

Nothing here measures time: built-ins count how far a program comes in a tick.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable, Generator
from typing import Any

import pytest
from hypothesis import given, settings
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
#: Expressions that are worth a value of some kind, and wrong with some others.
_VALUES = st.recursive(
    st.sampled_from(
        [
            *(
                "1",
                "0",
                "-2147483647",
                "2.5e300",
                "True",
                '"a"',
                "[]",
                "[1, 2]",
                "[[1, 2], [3, 4]]",
                "make_list(2000, 1)",
            ),
            *("p[1, 2, 3, 0, 0, 1]", "struct(a = 1)", "nothing()", "x", "0xFFFFFFFF", '"9e99999"'),
        ]
    ),
    lambda inner: (
        st.builds(
            "({} {} {})".format,
            inner,
            st.sampled_from(["+", "-", "*", "/", "%", "==", "<", "and", "xor"]),
            inner,
        )
        | st.builds("[{}, {}]".format, inner, inner)
        | st.builds("{}[{}]".format, inner, inner)
        | st.builds("struct(a = {}, b = {})".format, inner, inner)
        | st.builds("{}({})".format, st.sampled_from(sorted(set(library()) - {"random"})), inner)
        | st.builds(
            "{}({}, {})".format, st.sampled_from(["atan2", "pow", "log", "make_list", "str_at", "dot"]), inner, inner
        )
    ),
    max_leaves=6,
)


def _sync() -> Generator[None, None, None]:
    yield


def outcome(text: str, ticks: int = 4) -> str:
    """Upload a text and run it for some ticks; any exception but ScriptError comes through."""
    names = {"movej", "movel", "servoj", "f", "textmsg"}
    built_ins = {name: lambda *given, **named: 0 for name in names} | library() | {"sync": _sync}
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


@given(st.lists(_WORDS, max_size=60).map(" ".join))
@settings(max_examples=300, deadline=None)
def test_any_words(text: str) -> None:
    outcome(text)


@given(_VALUES, _VALUES)
@settings(max_examples=300, deadline=None)
def test_any_values(first: str, second: str) -> None:
    """Whatever goes wrong is said in words of URScript's, not of Python's."""
    said = outcome(f"def nothing():\nend\nx = {first}\ny = x\ny = {second}\nx[0] = y\nx = [x == y]")
    for word in ("Error", "object", "NoneType", "unsupported", "ndarray", "argument", "encountered", "convert"):
        assert word not in said


@given(data=st.data())
@settings(max_examples=30, deadline=None)
def test_a_client_s_program_with_lines_lost_doubled_and_cut(client_program: str, data: st.DataObject) -> None:
    lines = client_program.splitlines(keepends=True)
    for _ in range(data.draw(st.integers(1, 4))):
        if not lines:
            break
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
        "while True:\n" * DEEP + "end\n" * DEEP,
        "def f():\n" * DEEP + "end\n" * DEEP,
        "def f(" + ", ".join(f"a{number}" for number in range(DEEP)) + "):\nend",
        "x = 1\n" * 90_000,
        "#" * 2_000_000,
        "x = [" + "1, " * 2000 + "1]",
        # What a reader that goes back would read again and again.
        "x = " + "1" * 900_000 + "a",
        "x = " + "p[" * 45 + "1" + "]" * 44,
    ],
    ids=lambda text: text[:12].replace("\n", " "),
)
def test_what_nests_too_deeply_or_is_too_long_is_refused(text: str) -> None:
    assert outcome(text) == "refused"


@pytest.mark.parametrize(
    "text",
    [
        "x = " + "(" * 40 + "1" + ")" * 40,
        "x = True" + " and True" * 49,
        "x = [" + "1, " * 1999 + "1]",
        "if True:\n" * 45 + "sync()\n" + "end\n" * 45,
        "while True:\n" * 45 + "sync()\n" + "end\n" * 45,
        "x = 0\nif x == 1:\n x = 1\n" + "elif x == 2:\n x = 1\n" * 5000 + "end",
        "x = 1\n" * 20_000,
        "x = " + "1" * 100_000,
        "s = '1'\nwhile str_len(s) < 16384:\n s = s + s\nend\nx = str_len(s + '')\ny = to_num(s)",
        "x = 0x" + "1" * 100_000,
        "# " + "x" * 900_000,
        "x = 0\nif x == 1:\n x = " + "p[" * 45 + "1" + "]" * 45 + "\nend",
        "def f(n):\n if n == 0:\n  return 0\n end\n return n + f(n - 1)\nend\nx = f(48)",
    ],
    ids=lambda text: text[:12].replace("\n", " "),
)
def test_what_is_long_but_within_the_limits_runs(text: str) -> None:
    assert outcome(text) == "ran"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def p():\n def f(n):\n  return f(n + 1)\n end\n f(0)\nend", "calls within one another"),
        ("def p():\n p()\nend", "calls within one another"),
        (
            "def p():\n def f(n):\n  return " + "1 + (" * 40 + "f(n)" + ")" * 40 + "\n end\n f(0)\nend",
            "calls within|calls too deep",
        ),
        ("def p():\n thread t():\n  while True:\n   h = run t()\n  end\n end\n join run t()\nend", "threads at once"),
        ('s = "ab"\nwhile True:\n s = str_cat(s, s)\nend', "16384 are the most"),
        ('s = "ab"\nl = [s]\nwhile True:\n s = s + s\n l = [s, s, s, s]\nend', "2000 are the most"),
        ("s = struct(a = [1, 2])\nwhile True:\n s = struct(a = s, b = s)\nend", "2000 are the most"),
        ("s = struct(a = 1)\nwhile True:\n s.a = s\nend", "structs more than 10 deep"),
        ("s = struct(a = 1)\nwhile True:\n s = struct(a = s)\nend", "structs more than 10 deep"),
        ("l = make_list(2000, 1)\nl[0] = struct(a = l)", "2000 are the most|stays a number"),
        ("s = struct(a = 1)\nl = make_list(1000, s)\nl = make_list(9, struct(l = l))", "2000 are the most"),
        ("a = make_list(1, [1])\nb = make_list(1, 1)\nm = make_list(1999, [1])", "2000 are the most"),
        ("c = " + str([[1]] * 1000) + "\nr = [" + str([1] * 1000) + "]\nm = c * r", "2000 are the most"),
        ("a = make_list(2000, 0.5)\nb = " + "a + " * 49 + "a", "far more than a tick"),
        ("x = norm([" + "pose_dist(p[1, 2, 3, 0, 0, 0], p[0, 0, 0, 0, 0, 0]), " * 200 + "1])", "far more than a tick"),
        (
            "def f(a, b):\n while True:\n  sync()\n end\nend\nf(" + "make_list(2000, 1) + 1, " * 2 + "a = 3)",
            "given twice",
        ),
    ],
)
def test_what_grows_without_end_is_ended(text: str, message: str) -> None:
    said = outcome(text, ticks=200)
    if said == "refused":
        with pytest.raises(ScriptError, match=message):
            Interpreter(parse(text), {**library(), "sync": _sync})
    else:
        assert any(each in said for each in message.split("|"))


@pytest.mark.parametrize("times", ["x * x", "x * 65536", "x + x", "pow(x, 1.5)", "-x - x * x"])
def test_numbers_grow_to_floats_and_no_further(times: str) -> None:
    kept: list[Any] = []
    interpreter = Interpreter(
        parse(f"x = 3\nwhile True:\n x = {times}\n keep(x)\nend"), {**library(), "keep": kept.append}
    )
    for _ in range(5):
        interpreter.step()
    assert all(isinstance(x, float) or abs(x) <= 2**31 for x in kept)


def _counted(text: str, ticks: int = 20) -> float:
    """How often a program calls ``note`` in a tick, on the mean."""
    notes: list[Any] = []
    interpreter = Interpreter(parse(text), {**library(), "note": notes.append, "sync": _sync})
    for _ in range(ticks):
        interpreter.step()
    assert interpreter.error is None
    return len(notes) / ticks


@pytest.mark.parametrize(
    ("prepare", "line", "most"),
    [
        ("", "x = 1", 1500),
        ("a = make_list(2000, 1.5)", "b = a", 6),
        ("a = make_list(2000, 1.5)", "b = a + a", 2),
        ("a = make_list(2000, 1.5)", "b = -a", 4),
        ("a = make_list(2000, 1.5)", "b = a == a", 4),
        ("a = make_list(2000, 1.5)", "b = [a[0], norm(a)]", 8),
        ("a = make_list(2000, 1.5)", "b = length(a)", 8),
        ("a = make_list(900, 1.5)", "b = to_str(a)", 15),
        ("a = make_list(900, 1.5)", "switch a:\n case 1:\n end\n case a:\n end\n end", 15),
        ("m = " + str([[1.5] * 44] * 44), "b = m * m", 4),
        ("m = " + str([[1.5] * 44] * 44), "b = transpose(m)", 4),
        ("s = struct(a = make_list(1000, 1))", "t = s", 15),
        ("s = 'a'\nwhile str_len(s) < 16384:\n s = s + s\nend", "b = str_find(s, 'ab')", 30),
        ("p = p[1, 2, 3, 0, 0, 0]", "q = pose_trans(p, p)", 40),
        ("def f(a):\n return 1\nend\na = make_list(2000, 1.5)", "b = f(a)", 6),
        ("x = 1", "b = [" + "x + 1, " * 1500 + "1]", 4),
        ("x = 1", "if " + " + ".join(["x"] * 50) + " == 0:\n end\n" * 1, 200),
    ],
)
def test_what_costs_more_runs_less_often(prepare: str, line: str, most: int) -> None:
    assert 0 < _counted(f"{prepare}\nwhile True:\n {line}\n note(1)\nend") <= most


def test_threads_that_never_wait_share_a_tick() -> None:
    text = "def p():\n thread t():\n  while True:\n   note(1)\n  end\n end\n i = 0\n"
    text += " while i < {}:\n  h = run t()\n  i = i + 1\n end\n while True:\n  sync()\n end\nend"
    one, many = _counted(text.format(1)), _counted(text.format(45))
    assert one <= limits.STATEMENTS
    assert many <= limits.TICK
    assert many <= 2.5 * one


def test_secondary_programs_have_a_part_of_the_tick() -> None:
    body = "():\n while True:\n  note(1)\n end\nend"
    assert _counted(f"sec s{body}") <= _counted(f"def s{body}") / limits.SECONDARY + 1


def test_an_expression_that_takes_long_is_waited_for() -> None:
    """What it spends beyond a tick, its program does not get in the next ones."""
    text = "a = make_list(2000, 0.5)\nwhile True:\n b = " + "a + " * 8 + "a\n note(1)\nend"
    assert 0.2 < _counted(text, ticks=100) < 0.9


def test_what_all_variables_hold_together_is_bounded() -> None:
    """Lists in the variables of calls within one another, in many threads."""
    locals_ = "\n".join(f"  a{number} = make_list(2000, 0.5)" for number in range(100))
    text = f"def p():\n def f(n):\n{locals_}\n  f(n + 1)\n end\n thread t():\n  f(0)\n end\n i = 0\n"
    text += " while i < 20:\n  h = run t()\n  i = i + 1\n end\n while True:\n  sync()\n end\nend"
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert "more than a program may keep" in outcome(text, ticks=500)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown * (1 if sys.platform == "linux" else 1 / 1024) < 100_000, "kB"


@pytest.mark.parametrize(
    "text",
    [
        # Scalars alone; values that are at hand while a call within the same line goes on; strings.
        "def p():\n def f(n):\n"
        + "\n".join(f"  a{number} = n" for number in range(8000))
        + "\n  f(n + 1)\n end\n f(0)\nend",
        "def p():\n def f(n):\n  x = [" + "norm(make_list(2000, n) + 1), " * 5 + "f(n + 1)]\n end\n"
        " def g(n):\n  x = h(" + "make_list(2000, n) + 1, " * 3 + "g(n + 1))\n end\n"
        " def h(a, b, c, d):\n end\n thread t():\n  g(0)\n end\n i = 0\n while i < 45:\n  x = run t()\n"
        "  i = i + 1\n end\n while True:\n  sync()\n end\nend",
        "def p():\n s = 'a'\n while str_len(s) < 8000:\n  s = s + s\n end\n"
        + "\n".join(f" a{number} = s + '{number}'" for number in range(3000))
        + "\n while True:\n  sync()\n end\nend",
    ],
    ids=["scalars", "at hand", "strings"],
)
def test_whatever_is_held_counts(text: str) -> None:
    said = outcome(text, ticks=3000)
    assert "more than a program may keep" in said or "calls within" in said


def test_structs_that_grow_within_are_counted_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "COUNTED", 0)
    text = "v = struct(a = 1)\n" + "v = struct(a = v)\n" * 8
    text += "q = v\n" + "".join(f"q{'.a' * (8 * k)} = v\nsync()\n" for k in range(1, 6))
    assert outcome(text, ticks=20) == "ran"
    assert "structs more than 10 deep" in outcome(text + "t = q", ticks=20)


def test_what_is_made_and_left_is_no_harm() -> None:
    text = "i = 0\nwhile i < 2000:\n a = make_list(2000, i)\n i = i + 1\nend"
    assert outcome(text, ticks=3000) == "ran"


def test_a_program_reaches_nothing_of_python() -> None:
    for text in ("x = __builtins__", "x = open", "x = library", "s = struct(a = 1)\nx = s.__class__", "x = p.__init__"):
        assert "no " in outcome(text)
    assert outcome('x = __import__("os")') == "refused"


def test_words_of_python_are_names_like_others(run: Callable[..., list[str]]) -> None:
    text = "def f(lambda, class = 2):\n import = lambda + class\n return import\nend\ntextmsg(f(1))\n"
    assert run(text + "pass = f(class = 4, lambda = 1)\ntextmsg(pass)") == ["3", "5"]


@pytest.mark.parametrize("error", [RuntimeError("closed"), OSError("gone"), AssertionError("odd")])
def test_whatever_a_built_in_raises_when_it_is_closed_is_said(error: Exception) -> None:
    def wait() -> Generator[None, None, None]:
        try:
            while True:
                yield
        finally:
            raise error

    interpreter = Interpreter(
        parse("thread t():\n wait()\nend\nh = run t()\nsync()\nsync()\nkill h\nsync()"), {"wait": wait, "sync": _sync}
    )
    for _ in range(6):
        interpreter.step()
    assert str(interpreter.error) == f"line 2: {error}"
    assert not interpreter.running
