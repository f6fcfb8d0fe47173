"""URScript's text as tokens."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript import limits

KEYWORDS = frozenset(
    (
        *("and", "or", "xor", "not", "True", "False"),
        *("def", "sec", "thread", "end", "return", "global", "local"),
        *("if", "elif", "else", "switch", "case", "default", "while", "break", "continue"),
        *("run", "kill", "join", "halt", "enter_critical", "exit_critical"),
    )
)
_TOKEN = re.compile(
    r"""(?P<space>[ \t\r\f]+|\#[^\n]*)
    |(?P<newline>\n)
    |(?P<number>0[xX][0-9a-fA-F]+|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
    |(?P<name>[A-Za-z_]\w*)
    |(?P<string>"[^"\n]*"|'[^'\n]*')
    |(?P<sign>==|!=|<=|>=|[-+*/%<>=()\[\]{},:.;])
    """,
    re.VERBOSE | re.ASCII,
)
#: A line that PolyScope puts before what a node of its tree makes.
_LABEL = re.compile(r"^[ \t]*\$.*$", re.MULTILINE)


class Token(NamedTuple):
    """A word of the text.

    Attributes:
        kind: ``number``, ``name``, ``keyword``, ``string``, ``sign``, ``newline`` or ``end``.
        text: as written, strings without their quotes.
        line, column: where it begins, from 1.
    """

    kind: str
    text: str
    line: int
    column: int


def tokens(text: str) -> Iterator[Token]:
    """The words of a program, a ``newline`` for each end of a line, ``end`` at last.

    Raises:
        ScriptError: a character that begins no word, or a program too long; names line and column.
    """
    if len(text) > limits.PROGRAM:
        raise ScriptError(f"a program of {len(text)} characters; {limits.PROGRAM} are the most")
    text = _LABEL.sub("", text)
    line, begin, at = 1, 0, 0
    while at < len(text):
        found = _TOKEN.match(text, at)
        if found is None:
            raise ScriptError(f"line {line}, column {at - begin + 1}: {text[at]!r} begins no word of URScript")
        kind, word = str(found.lastgroup), found[0]
        if kind == "name" and word in KEYWORDS:
            kind = "keyword"
        if kind == "string":
            word = word[1:-1]
        if kind != "space":
            yield Token(kind, word, line, at - begin + 1)
        at = found.end()
        if kind == "newline":
            line, begin = line + 1, at
    yield Token("newline", "\n", line, at - begin + 1)
    yield Token("end", "end of the program", line, at - begin + 1)
