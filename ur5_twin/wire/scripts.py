"""URScript as it comes in over a socket: where a program begins and ends."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from ur5_twin.errors import WireError
from ur5_twin.wire.streams import CutOff, Lines

if TYPE_CHECKING:
    from ur5_twin.wire.controller import VirtualController

#: Bytes of the longest line and of the longest program.
_LONGEST_LINE = 64 * 1024
_LONGEST_PROGRAM = 1024 * 1024
#: A string, a comment, or a word: what may hold a keyword, and what is one.
_TOKEN = re.compile(r'"[^"\n]*"?|\'[^\'\n]*\'?|#.*|[A-Za-z_]\w*')
_OPENS = {"def", "sec", "thread", "if", "while", "switch", "case", "default"}
#: What a program begins with: the rest are statements, which run by themselves when they come alone.
_PROGRAM = re.compile(r"\s*(def|sec|thread)\b")


def depth(line: str) -> int:
    """By how many blocks a line goes deeper (negative: back out)."""
    words = [match[0] for match in _TOKEN.finditer(line)]
    return sum((word in _OPENS) - (word == "end") for word in words)


class ScriptReader:
    """Pieces of a stream -> whole scripts.

    A line outside of any program is a script of its own; a program goes from its ``def`` to the ``end`` of the same
    level. What is there when the connection is closed is a script too: whoever sends it has no other way to end it.
    """

    def __init__(self) -> None:
        self._lines = Lines(_LONGEST_LINE)
        self._program: list[str] = []
        self._size = 0
        self._depth = 0

    def feed(self, data: bytes) -> list[str]:
        """The scripts that are complete with ``data``.

        Raises:
            CutOff: a line or a program is longer than any that makes sense.
        """
        return [script for line in self._lines.feed(data) if (script := self._take(line)) is not None]

    def rest(self) -> str | None:
        """What has come since the last whole script, or None."""
        last = self._lines.rest().decode("utf-8", "replace")
        text = "\n".join([*self._program, last]) if self._program else last
        return f"{text}\n" if text.strip() else None

    def _take(self, data: bytes) -> str | None:
        line = data.decode("utf-8", "replace")
        if not self._program:
            if not line.strip() or line.lstrip().startswith("#"):
                return None
            if not _PROGRAM.match(line):
                return f"{line}\n"
        self._program.append(line)
        self._size += len(data) + 1
        self._depth += depth(line)
        if self._size > _LONGEST_PROGRAM:
            raise CutOff(f"a program of more than {_LONGEST_PROGRAM} bytes")
        if self._depth > 0:
            return None
        script = "\n".join(self._program) + "\n"
        self._program, self._size, self._depth = [], 0, 0
        return script


def upload(controller: VirtualController, script: str) -> None:
    """Have the controller run a script at its next tick; what is wrong with it goes to its messages.

    Raises:
        CutOff: the controller has too much to do already. A client that sends on would lose script after script.
    """
    try:
        controller.post(lambda: controller.run_script(script))
    except WireError as error:
        raise CutOff(f"a script is lost: {error}") from error
