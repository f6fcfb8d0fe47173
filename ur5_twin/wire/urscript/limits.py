"""How much of everything a program may have: a client's program must not eat the controller's time or memory."""

from __future__ import annotations

from typing import Final

#: Characters of a program; ur_rtde's has 42,000.
PROGRAM: Final = 1_000_000
#: Brackets and blocks within one another.
NESTING: Final = 50
#: Calls within one another.
CALLS: Final = 50
#: Threads at work at once, the program's own among them.
THREADS: Final = 50
#: Numbers in a list, the inner lists' counted.
LIST: Final = 2000
#: Characters of a string.
STRING: Final = 16_384
#: Statements that a thread runs in a tick; then it waits for the next.
STATEMENTS: Final = 3000
