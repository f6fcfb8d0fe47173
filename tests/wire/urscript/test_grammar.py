"""What URScript's text means, by examples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript import Pose, parse
from ur5_twin.wire.urscript.values import Struct


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("1 + 2 * 3", 7),
        ("(1 + 2) * 3", 9),
        ("2 - 3 - 4", -5),
        ("-2 * -3", 6),
        ("1 - -1", 2),
        ("7 / 2", 3.5),
        ("7 % 4", 3),
        ("-7 % 4", -3),
        ("7.5 % 2", 1.5),
        ("1 < 2 and 2 < 3", True),
        ("not 1 == 2", True),
        ("not True or True", True),
        ("True xor True", False),
        ("True or False and False", True),
        ("0x1F", 31),
        ("0xFFFFFFFF", 4294967295.0),
        ("1e3", 1000.0),
        (".5", 0.5),
        ("5.", 5.0),
        ("3000000000", 3e9),
        ('"#no comment" # a comment', "#no comment"),
        ("[1, 2.5, 3][1]", 2.5),
        ("[]", []),
        ("[[1, 2], [3, 4]][1, 0]", 3),
        ("[[1, 2], [3, 4]][1][0]", 3),
        ("p[1, 2, 3, 0, 0, 0]", Pose([1, 2, 3, 0, 0, 0])),
        ("p[1, 2, 3, 0, 0, 0][2]", 3.0),
        ("struct(a = 1, b = [1, 2]).b", [1, 2]),
        ("struct(a = 1)", Struct(a=1)),
        ("1 ≟ 1", True),
        ("1 ≤ 1", True),
        ('"ab" + "c"', "abc"),
    ],
)
def test_expressions(value: Callable[[str], Any], expression: str, expected: Any) -> None:
    found = value(expression)
    assert found == expected
    assert type(found) is type(expected)


@pytest.mark.parametrize(
    "text",
    [
        "global offset = # upper or lower\n 24\ntextmsg(offset)",
        "def f():\r\n  x = 24\r\n  textmsg(x)\r\nend\r\n",
        'def f():\n $ 1 "Robot Program"\n $ 2 "x≟24"\n textmsg(24)\nend',
        "def f(): textmsg(24) end",
        "def f(): # comment\nif (True): textmsg(24) end end",
        "x=[\n 24,\n # why\n 2]\ntextmsg(x[0])",
        "p = [24, 1]\ntextmsg(p[0])",
        "p = p[24, 0, 0, 0, 0, 0]\np[1] = p[0]\ntextmsg(p[1])",
        "p = [[1, 2], [24, 3]]\ntextmsg(p[1, 0])",
        "if 1 > 2:\n textmsg(1)\nelif 2 > 1:\n textmsg(24)\nelse:\n textmsg(3)\nend",
        "x = 0\nwhile True:\n x = x + 1\n if x == 3:\n  continue\n end\n if x == 24:\n  break\n end\nend\ntextmsg(x)",
        "def f():\n def g():\n  return\n end\n g()\n textmsg(24)\nend",
        "def f(a, b = 20):\n return a + b\nend\ntextmsg(f(b = 4, a = 20))",
        "def f(a, b = 20):\n return a + b\nend\ntextmsg(f(4))",
        "def main():\n textmsg(helper())\nend\ndef helper():\n return 24\nend",
        "def f(n):\n if n == 0:\n  return 0\n end\n return n + f(n - 1)\nend\ntextmsg(f(23) - 252)",
        "s = struct(a = 1, b = 2)\ns.a = 24\ntextmsg(s.a)",
        "m = [[1, 2], [3, 4]]\nm[1, 0] = 24\ntextmsg(m[1][0])",
        "m = [[1, 2], [3, 4]]\nm[1][0] = 24\ntextmsg(m[1, 0])",
        "halt_me = 24\ntextmsg(halt_me)\nhalt\ntextmsg(1)",
    ],
)
def test_programs_that_print_24(run: Callable[..., list[str]], text: str) -> None:
    assert run(text) == ["24"]


def test_a_program_has_the_name_of_its_first_function() -> None:
    program = parse("def one():\n x = 1\nend\ndef two():\nend")
    assert program.name == "one"
    assert not program.secondary
    assert parse("sec blink():\n set_digital_out(1, True)\nend").secondary
    assert not parse("set_digital_out(1, True)").secondary


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("end", "line 1, column 1: 'end' where a value should be"),
        ("else:", "'else' where a value should be"),
        ("hello world", "line 1, column 1: a value of which nothing is made"),
        ("x = 1 hello", "line 1, column 7: a value of which nothing is made"),
        ("x == 1", "neither a call nor 'name = value'"),
        ("5 = x", "'=' where the end of the statement should be"),
        ("f(1) = 2", "'=' where the end of the statement should be"),
        ("x = (1", "line 1, column 7: end of the program where ')' should be"),
        ("x = [1 2]", "'2' where ',' should be"),
        ("x = p[1, 2, 3]", "3 indices"),
        ("x = [1][1, 2, 3]", "3 indices"),
        ('x = "open', "line 1, column 5: '\"' begins no word"),
        ("x = 12abc", "line 1, column 5: '12abc' is no number"),
        ("x =  1.2.3", "line 1, column 6: '1.2.3' is no number"),
        ("x = 0xZ", "'0xZ' is no number"),
        ("break", "line 1, column 1: 'break' is not within a loop"),
        ("switch 1:\n case 1:\n  continue\n end\nend", "line 3, column 3: 'continue' is not within a loop"),
        ("while True:\n def f():\n  break\n end\nend", "line 3, column 3: 'break' is not within a loop"),
        ("f(a = 1, 2)", "'2' where 'name =', as before, should be"),
        ("f(a = 1, a = 2)", "line 1, column 10: f: 'a' is given twice"),
        ("def f():\nend\ndef g(a, a):\nend", "line 3, column 10: g: two parameters 'a'"),
        ("x = run 5", "line 1, column 9: '5' where a name should be"),
        ("x = 1 $ 2", "line 1, column 7: '$' begins no word"),
    ],
)
def test_what_is_wrong_is_named(text: str, message: str) -> None:
    with pytest.raises(ScriptError) as caught:
        parse(text)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def f(a):\n x = a\nend", "line 1: f: no 'a' is given"),
        ("x = 1\nmove(x)", "line 2: there is no function 'move'"),
        ("x = sqrt(1, 2)", "line 1: sqrt: too many positional"),
        ("x = sqrt(g = 1)", "line 1: sqrt: missing"),
        ("def f(a):\n return a\nend\nx = f(b = 1)", "line 4: f has no parameter 'b' (a)"),
        ("def f(a):\n return a\nend\nx = f(1, a = 1)", "line 4: f: 'a' is given twice"),
        ("x = run sqrt(4)", "there is no thread 'sqrt' to run"),
        ("thread t():\nend\nx = t()", "line 3: 't' is a thread: run t()"),
        (
            "x = [" + "a + 1, " * 1500 + "1]\ny = length([" + "[a + b, a + b], " * 1800 + "1])",
            "line 2: an expression of",
        ),
    ],
)
def test_what_cannot_be_is_refused_before_it_runs(start: Callable[..., Any], text: str, message: str) -> None:
    with pytest.raises(ScriptError) as caught:
        start(text)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("body", "printed"),
    [
        # A variable of a function around is that one; a local one masks it.
        ("a = 0\ndef f():\n a = 1\nend\nf()\ntextmsg(a)", "1"),
        ("a = 0\ndef f():\n local a = 1\nend\nf()\ntextmsg(a)", "0"),
        ("a = 0\ndef f(a):\n a = 1\nend\nf(5)\ntextmsg(a)", "0"),
        ("def f():\n global a = 7\nend\nf()\ntextmsg(a)", "7"),
        # Lists are values: neither assignment nor call shares them.
        ("a = [1, 2]\nb = a\nb[0] = 9\ntextmsg(a)", "[1, 2]"),
        ("a = [1, 2]\ndef f(x):\n x[0] = 9\n return x\nend\nb = f(a)\ntextmsg(a)", "[1, 2]"),
        ("a = [1, 2]\ndef f():\n return a\nend\nb = f()\nb[0] = 9\ntextmsg(a)", "[1, 2]"),
        ("m = [[1, 2], [3, 4]]\nr = m[0]\nr[0] = 9\ntextmsg(m)", "[[1, 2], [3, 4]]"),
        ("s = struct(a = [1])\nt = s\nt.a[0] = 9\ntextmsg(s.a)", "[1]"),
    ],
)
@pytest.mark.parametrize("whole", [True, False], ids=["in a def", "bare"])
def test_scopes(run: Callable[..., list[str]], body: str, printed: str, whole: bool) -> None:
    assert run(f"def program():\n{body}\nend" if whole else body) == [printed]
