"""URScript's text as tokens."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

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
    r"""(?:[ \t\r\f]+|\#[^\n]*)*+(?:
    (?P<newline>\n)
    |(?P<number>(?:0[xX][0-9a-fA-F]++|(?:\d++\.?\d*+|\.\d++)(?:[eE][+-]?\d++)?+)(?![\w.]))
    |(?P<name>[A-Za-z_]\w*)
    |(?P<string>"[^"\n]*"|'[^'\n]*')
    |(?P<sign>==|!=|<=|>=|[-+*/%<>=()\[\]{},:.;≟≠≤≥])
    |(?P<end>\Z))
    """,
    re.VERBOSE | re.ASCII,
)
#: As PolyScope writes comparisons.
_SIGNS = {"≟": "==", "≠": "!=", "≤": "<=", "≥": ">="}
_BLANK = re.compile(r"(?:[ \t\r\f]+|#[^\n]*)*")
_WORD = re.compile(r"[\w.]+")
#: A line that PolyScope puts before what a node of its tree makes.
_LABEL = re.compile(r"^[ \t]*\$.*$", re.MULTILINE)


@dataclass
class Tokens:
    """The words of a text, the last one its ``end``; a list for each thing to know of them.

    Attributes:
        text: that they are from.
        kinds: ``number``, ``name``, ``string``, ``newline``, ``end``, or empty for signs and keywords.
        words: as written, strings without their quotes.
        fixed: the same of signs and keywords, None of all others.
        lines: where each is, from 1.
        places: characters before each.
    """

    text: str
    kinds: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    fixed: list[str | None] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    places: list[int] = field(default_factory=list)

    def where(self, index: int) -> str:
        """Line and column of a word, for messages."""
        return f"line {self.lines[index]}, column {_column(self.text, self.places[index])}"


def _column(text: str, place: int) -> int:
    return place - text.rfind("\n", 0, place)


def tokens(text: str) -> Tokens:
    """The words of a program, a ``newline`` for each end of a line, the last one's too.

    Raises:
        ScriptError: a character that begins no word, a number that is none, or a program too long; names line and
            column.
    """
    if len(text) > limits.PROGRAM:
        raise ScriptError(f"a program of {len(text)} characters; {limits.PROGRAM} are the most")
    if "$" in text:
        text = _LABEL.sub("", text)
    found = Tokens(text)
    kinds, words, fixed, lines, places = found.kinds, found.words, found.fixed, found.lines, found.places
    match = _TOKEN.match
    at, line = 0, 1
    kind = ""
    while kind != "end":
        one = match(text, at)
        if one is None:
            raise _no_word(text, at, line)
        kind = one.lastgroup or ""
        word = one[kind]
        at = one.end()
        places.append(at - len(word))
        if kind == "sign":
            kind, word = "", _SIGNS.get(word, word)
        elif kind == "name" and word in KEYWORDS:
            kind = ""
        elif kind == "string":
            word = word[1:-1]
        elif kind == "end":
            word = "end of the program"
            places.append(at)
            for each, last in ((kinds, "newline"), (words, "\n"), (fixed, None), (lines, line)):
                each.append(last)  # type: ignore[arg-type]
        kinds.append(kind)
        words.append(word)
        fixed.append(None if kind else word)
        lines.append(line)
        if kind == "newline":
            line += 1
        if len(kinds) > limits.WORDS:
            raise ScriptError(f"line {line}: a program of more than {limits.WORDS} words")
    return found


def _no_word(text: str, at: int, line: int) -> ScriptError:
    blank = _BLANK.match(text, at)
    at = blank.end() if blank else at
    where = f"line {line}, column {_column(text, at)}"
    if text[at] == "." or text[at].isdigit():
        return ScriptError(f"{where}: '{_WORD.match(text, at)[0][:40]}' is no number")  # type: ignore[index]
    return ScriptError(f"{where}: {text[at]!r} begins no word of URScript")
