"""What a program consists of, as its parser finds it. Lines count from 1."""

from __future__ import annotations

from dataclasses import dataclass

from ur5_twin.wire.urscript.values import Value


@dataclass(slots=True)
class Literal:
    line: int
    value: Value


@dataclass(slots=True)
class Name:
    line: int
    name: str


@dataclass(slots=True)
class ListOf:
    """``[a, b]``, or with ``pose`` ``p[x, y, z, rx, ry, rz]``."""

    line: int
    items: tuple[Expression, ...]
    pose: bool = False


@dataclass(slots=True)
class Index:
    """``of[a]`` or ``of[a, b]``."""

    line: int
    of: Expression
    indices: tuple[Expression, ...]


@dataclass(slots=True)
class Member:
    """``of.name``."""

    line: int
    of: Expression
    name: str


@dataclass(slots=True)
class Call:
    line: int
    name: str
    arguments: tuple[Expression, ...]
    named: tuple[tuple[str, Expression], ...] = ()


@dataclass(slots=True)
class Run:
    """``run name()``, which begins a thread and is its handle."""

    line: int
    call: Call


@dataclass(slots=True)
class Unary:
    line: int
    sign: str
    of: Expression


@dataclass(slots=True)
class Binary:
    line: int
    sign: str
    left: Expression
    right: Expression


Expression = Literal | Name | ListOf | Index | Member | Call | Run | Unary | Binary


@dataclass(slots=True)
class Assign:
    """``scope`` is ``global``, ``local`` or nothing; ``target`` a name, or a part of a list or a struct."""

    line: int
    scope: str
    target: Name | Index | Member
    value: Expression


@dataclass(slots=True)
class Evaluate:
    line: int
    value: Expression


@dataclass(slots=True)
class Branch:
    """``if``, ``elif`` and ``else``: conditions with their blocks, in order; the last one's may be None."""

    line: int
    cases: tuple[tuple[Expression | None, Block], ...]


@dataclass(slots=True)
class Switch:
    """``switch``: values with their blocks; ``default`` has None."""

    line: int
    of: Expression
    cases: tuple[tuple[Expression | None, Block], ...]


@dataclass(slots=True)
class Loop:
    line: int
    condition: Expression
    body: Block


@dataclass(slots=True)
class Return:
    line: int
    value: Expression | None


@dataclass(slots=True)
class Thread:
    """``kill`` or ``join`` of a thread's handle."""

    line: int
    what: str
    handle: Expression


@dataclass(slots=True)
class Plain:
    """``break``, ``continue``, ``halt``, ``enter_critical`` or ``exit_critical``."""

    line: int
    what: str


@dataclass(slots=True)
class Define:
    """``def``, ``sec`` or ``thread``."""

    line: int
    kind: str
    name: str
    parameters: tuple[tuple[str, Expression | None], ...]
    body: Block


Statement = Assign | Evaluate | Branch | Switch | Loop | Return | Thread | Plain | Define
Block = tuple[Statement, ...]


@dataclass(slots=True)
class Program:
    """A whole text.

    Attributes:
        body: its statements.
        name: of its first function; empty if there is none.
        secondary: it is a ``sec`` program, which runs beside the one that runs already and moves nothing.
    """

    body: Block
    name: str
    secondary: bool
