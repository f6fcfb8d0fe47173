"""How much of everything a program may have: a client's program must not eat the controller's time or memory."""

from __future__ import annotations

from typing import Final

#: Characters of a program, and words: names, numbers, signs and ends of lines. ur_rtde's has 50,000 and 7,500.
PROGRAM: Final = 1_000_000
WORDS: Final = 300_000
#: Brackets and blocks within one another.
NESTING: Final = 50
#: Parameters of a function.
PARAMETERS: Final = 100
#: Calls within one another.
CALLS: Final = 50
#: Threads at work at once, the program's own among them.
THREADS: Final = 50
#: Numbers in a list or struct, those of its parts counted.
LIST: Final = 2000
#: Structs and lists within one another.
STRUCTS: Final = 10
#: Characters of a string, and how many of them count as one number.
STRING: Final = 16_384
CHARACTERS: Final = 32
#: Numbers that a program's variables hold together, and how many are made between two counts of them.
HELD: Final = 500_000
COUNTED: Final = 250_000
#: What a thread may spend in a tick, then it waits for the next, and all threads of a program together. A simple
#: statement costs one, which is about a microsecond; so do four numbers that are copied or reckoned with.
STATEMENTS: Final = 3000
TICK: Final = 6000
#: What a single expression may spend beyond that. It cannot be interrupted: what it spends too much, its thread waits.
OVERDRAFT: Final = 10_000
#: Words of an expression.
EXPRESSION: Final = 10_000
#: Secondary programs at once; each has that part of the times above.
SECONDARY: Final = 8
