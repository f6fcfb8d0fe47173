"""The language: what programs mean, what is said of wrong ones, and that none runs away."""

from __future__ import annotations

import math
from collections.abc import Generator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript import Interpreter, Pose, library, limits, parse, shown


class Robot:
    """Built-ins that note what they are called with."""

    def __init__(self) -> None:
        self.said: list = []
        self.closed = 0

    def textmsg(self, s1: object = "", s2: object = "") -> None:
        self.said.append(f"{shown(s1)}{shown(s2)}")

    def sync(self) -> Generator[None, None, None]:
        yield

    def wait(self, ticks: int) -> Generator[None, None, int]:
        try:
            for _ in range(ticks):
                yield
        finally:
            self.closed += 1
        return ticks

    def library(self) -> dict:
        return {**library(), "textmsg": self.textmsg, "sync": self.sync, "wait": self.wait}


def run(text: str, ticks: int = 50) -> tuple[Robot, Interpreter]:
    robot = Robot()
    interpreter = Interpreter(parse(text), robot.library())
    for _ in range(ticks):
        interpreter.step()
    return robot, interpreter


def said(text: str) -> list[str]:
    robot, interpreter = run(text)
    assert interpreter.error is None
    assert not interpreter.running
    return robot.said


def value(expression: str) -> str:
    return said(f"textmsg({expression})")[0]


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("1 + 2 * 3", "7"),
        ("(1 + 2) * 3", "9"),
        ("7 / 2", "3.5"),
        ("7 % 4", "3"),
        ("-2 - -3", "1"),
        ("0x10 + 1e2", "116"),
        ("not 1 == 2 and True", "True"),
        ("True xor True or False", "False"),
        ("[1, 2, 3] * [10, 20, 30]", "[10, 40, 90]"),
        ("10 / [10, 20]", "[1, 0.5]"),
        (
            "[[1, 2], [3, 4], [5, 6]] * [[10, 20, 30], [40, 50, 60]]",
            "[[90, 120, 150], [190, 260, 330], [290, 400, 510]]",
        ),
        ("[[1, 2], [3, 4]] * [10, 20]", "[50, 110]"),
        ("[[1, 2], [3, 4]][1, 0]", "3"),
        ("p[1, 2, 3, 0, 0, 0.5][5]", "0.5"),
        ("p[1, 2, 3, 0, 0, 0]", "p[1, 2, 3, 0, 0, 0]"),
        ("'a' + 1 + \"b\"", "a1b"),
        ("norm([3, 4])", "5"),
        ("pow(2, 10)", "1024"),
        ("get_list_length([1, 2])", "2"),
        ("pose_trans(p[1, 0, 0, 0, 0, 0], p[0, 2, 0, 0, 0, 0])", "p[1, 2, 0, 0, 0, 0]"),
        ("binary_list_to_integer(integer_to_binary_list(-5))", "-5"),
        ("rpy2rotvec([0, 0, 1.5])", "[0, 0, 1.5]"),
        ("struct(a = 4, b = 'x').a", "4"),
        ('str_sub("controller", 3, 4)', "trol"),
        ("2147483647 + 1", "2147483648"),
    ],
)
def test_values(expression: str, expected: str) -> None:
    assert value(expression) == expected


def test_a_program_of_functions_runs_its_first() -> None:
    text = """
    def program():
      def twice(x, by=2):
        if x > 100:
          return 100
        elif x < 0: return 0
        else:
          return x * by
        end
      end
      textmsg(twice(3), twice(by = 5, x = 4))
      textmsg(twice(200), twice(-1))
    end
    def other():
      textmsg("never")
    end
    """
    assert said(text) == ["620", "1000"]


def test_scopes() -> None:
    text = """
    def program():
      shared = 1
      global everywhere = 10
      def inner():
        shared = shared + 1
        local everywhere = 5
        everywhere = everywhere + 1
        mine = 3
        return everywhere
      end
      textmsg(inner())
      textmsg(shared, everywhere)
      textmsg(mine)
    end
    """
    robot, interpreter = run(text)
    assert robot.said == ["6", "210"]
    assert "line 14: there is no variable 'mine'" in str(interpreter.error)


def test_lists_are_copied() -> None:
    assert said("a = [1, 2]\nb = a\nb[0] = 9\ntextmsg(a, b)") == ["[1, 2][9, 2]"]
    assert said("m = [[1, 2], [3, 4]]\nr = m[0]\nr[0] = 9\nm[1, 1] = 7\ntextmsg(m)") == ["[[1, 2], [3, 7]]"]


def test_the_traps_of_the_grammar() -> None:
    # A line that ends after '=' goes on; a variable may be called p; a label of PolyScope says nothing; CRLF.
    text = 'def f():\r\n $ 1 "label"\r\n  global a = # why\r\n    24\r\n  p = [7, 8]\r\n  textmsg(a, p[1])\r\nend\r\n'
    assert said(text) == ["248"]
    assert said("if True: textmsg(1) end") == ["1"]
    assert said("textmsg(1); textmsg(2)") == ["1", "2"]
    assert said("textmsg(\n  1,\n  # the second\n  2\n)") == ["12"]


def test_loops_and_switch() -> None:
    text = """
    i = 0
    while True:
      i = i + 1
      if i == 2:
        continue
      end
      if i > 4:
        break
      end
      switch (i):
        case 1:
          textmsg("one")
        end
        case 3:
          textmsg("three")
          break
          textmsg("never")
        end
        default:
          textmsg("other ", i)
        end
      end
    end
    """
    assert said(text) == ["one", "three", "other 4"]


def test_threads() -> None:
    text = """
    def program():
      global n = 0
      thread count():
        while True:
          n = n + 1
          sync()
        end
      end
      thread short():
        sync()
        textmsg("short")
      end
      handle = run count()
      join run short()
      kill handle
      seen = n
      sync()
      sync()
      textmsg(n - seen)
    end
    """
    assert said(text) == ["short", "0"]


def test_a_killed_thread_ends_what_it_waits_in() -> None:
    robot, interpreter = run("thread t():\n wait(1000)\nend\nh = run t()\nsync()\nsync()\nkill h\nsync()\nwait(3)", 20)
    assert robot.closed == 2
    assert not interpreter.running
    robot, interpreter = run("wait(1000)", 3)
    assert interpreter.running
    interpreter.kill_all()
    assert robot.closed == 1


def test_critical_sections_keep_others_out_but_not_while_they_wait() -> None:
    text = """
    def program():
      global n = 0
      thread other():
        while True:
          n = n + 1
          sync()
        end
      end
      h = run other()
      sync()
      enter_critical
      before = n
      i = 0
      while i < 10000:
        i = i + 1
      end
      inside = n - before
      before = n
      sync()
      sync()
      waiting = n - before
      exit_critical
      textmsg(inside, waiting > 0)
      kill h
    end
    """
    assert said(text) == ["0True"]


def test_halt_ends_all() -> None:
    robot, interpreter = run("thread t():\n while True:\n sync()\n end\nend\nh = run t()\ntextmsg(1)\nhalt\ntextmsg(2)")
    assert robot.said == ["1"]
    assert not interpreter.running


def test_an_endless_loop_leaves_the_tick() -> None:
    text = 'n = 0\nthread t():\n textmsg("other")\nend\nh = run t()\nwhile True:\n n = n + 1\nend'
    robot, interpreter = run(text, 5)
    assert interpreter.running
    assert robot.said == ["other"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = ", "line 1, column 5: end of the program where a value should be"),
        ("x = 3 +\n* 4", r"line 2, column 1: '\*' where a value"),
        ("if True\n end", "line 1, column 8: the end of the line where ':'"),
        ("def f():\n a = 1", "where 'end'|where a value|end of the program"),
        ("a = §", "'§' begins no word"),
        ("f(1)", "line 1: there is no function 'f'"),
        ("def f(a):\nend\nx = 1\nf()", "line 4: f: no 'a' is given"),
        ("def f(a):\nend\nx = 1\nf(1, 2)", "f takes 1 arguments, 2"),
        ("norm()", "line 1: norm: missing"),
        ("run f()", "there is no thread 'f'"),
        ("(" * 100 + "1" + ")" * 100, "within one another"),
        ("x = " + "1 + " * 100 + "1", "operators in a row"),
        ("x = [" + "1," * 5000 + "1]", "2000"),
        ("a" * 2_000_000, "characters"),
    ],
)
def test_what_is_wrong_with_the_text_is_said(text: str, message: str) -> None:
    with pytest.raises(ScriptError, match=message):
        Interpreter(parse(text), Robot().library())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1\ny = x / 0", "line 2: 1 divided by zero"),
        ("x = [1]\n\nx[3] = 4", "line 3: index 3 of a list of 1"),
        ("x = 'a' * 2", "there is no a"),
        ("if 'yes': x = 1 end", "neither True nor False"),
        ("x = sqrt(-1)", "sqrt of -1: not defined"),
        ("x = pow(10, 400)", "not defined"),
        ("x = [1, 2] + [1, 2, 3]", "lists of 2 and 3"),
        ("def f():\n return f()\nend\nx = f()", "calls within one another"),
        ("thread t():\n while True:\n sync()\n end\nend\nwhile True:\n h = run t()\nend", "threads at once"),
        ("s = 'ab'\nwhile True:\n s = s + s\nend", "a string of"),
        ("m = [1]\nwhile True:\n m = [m, m]\nend", "nothing deeper|numbers"),
        ("x = textmsg(1)", "'x' would be nothing"),
        ("exit_critical", "exit_critical without"),
        ("kill 5", "5 is no thread"),
        ("p = p[1, 2, 3, 4, 5, 'a']", "a pose is six numbers"),
        ("x = norm(['a'])", "norm of"),
    ],
)
def test_what_goes_wrong_at_work_is_said_with_its_line(text: str, message: str) -> None:
    import re

    _, interpreter = run(text, 200)
    assert not interpreter.running
    assert re.search(message, str(interpreter.error))
    assert str(interpreter.error).startswith("line ")


_NUMBERS = st.integers(-50, 50).map(lambda n: (str(n) if n >= 0 else f"({n})", n))


@st.composite
def _expressions(draw: st.DrawFn, depth: int = 4) -> tuple[str, float]:
    if depth == 0 or draw(st.booleans()):
        return draw(_NUMBERS)
    left, a = draw(_expressions(depth - 1))
    right, b = draw(_expressions(depth - 1))
    sign = draw(st.sampled_from("+-*"))
    return f"({left} {sign} {right})", {"+": a + b, "-": a - b, "*": a * b}[sign]


@given(_expressions())
def test_arithmetic_is_pythons(case: tuple[str, float]) -> None:
    text, expected = case
    robot = Robot()
    robot.textmsg = lambda s1="", s2="": robot.said.append(s1)  # type: ignore[method-assign]
    interpreter = Interpreter(parse(f"textmsg({text})"), robot.library())
    interpreter.step()
    assert robot.said == [pytest.approx(expected)]


_WORDS = st.sampled_from(
    [
        *(
            "def",
            "f",
            "(",
            ")",
            ":",
            "end",
            "if",
            "while",
            "True",
            "x",
            "=",
            "1",
            "+",
            "[",
            "]",
            ",",
            "p[",
            "1,2",
            "return",
        ),
        *("run", "kill", "thread", "global", "not", "and", ".", "norm", ";", "elif", "\n", '"', "#"),
    ]
)


@settings(max_examples=200, deadline=None)
@given(st.lists(_WORDS, max_size=40).map(" ".join) | st.text(max_size=80))
def test_any_text_ends_within_its_budget(text: str) -> None:
    """Whatever it is: it runs for some ticks, or a ScriptError says what is wrong."""
    try:
        interpreter = Interpreter(parse(text), Robot().library())
    except ScriptError:
        return
    for _ in range(3):
        interpreter.step()
    interpreter.kill_all()
    assert not interpreter.running


def test_poses_agree_with_each_other() -> None:
    functions = library()
    a, b = Pose([0.1, -0.2, 0.3, 0.5, -1.0, 0.2]), Pose([-0.4, 0.1, 0.2, 1.0, 0.4, -0.3])
    there = functions["pose_trans"](functions["pose_inv"](a), functions["pose_trans"](a, b))
    assert there == pytest.approx(b)
    assert functions["pose_add"](functions["pose_sub"](a, b), b) == pytest.approx(a)
    assert functions["interpolate_pose"](a, b, 0) == pytest.approx(a)
    assert functions["interpolate_pose"](a, b, 1) == pytest.approx(b)
    assert functions["rotvec2rpy"](functions["rpy2rotvec"]([0.1, -0.4, 2.0])) == pytest.approx([0.1, -0.4, 2.0])
    # A force at a lever: 1 N along y, 1 m along x from the new origin's place.
    moved = functions["wrench_trans"](Pose([-1.0, 0, 0, 0, 0, 0]), [0, 1.0, 0, 0, 0, 0])
    assert moved == pytest.approx([0, 1.0, 0, 0, 0, 1.0])
    assert functions["pose_dist"](a, a) == pytest.approx(0.0, abs=1e-12)
    assert math.isclose(functions["point_dist"](a, b), math.dist(a[:3], b[:3]))


def test_a_tick_has_a_bound() -> None:
    """A loop gets as many statements as a thread may have in a tick."""
    counted = []
    functions = {**library(), "count": lambda: counted.append(1)}
    interpreter = Interpreter(parse("while True:\n count()\nend"), functions)
    interpreter.step()
    first = len(counted)
    interpreter.step()
    assert first <= limits.STATEMENTS
    assert len(counted) == pytest.approx(2 * first, abs=2)
