"""Markdown tables of reports."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ur5_twin.arm.parameters import N_JOINTS

#: Heads of six columns, one a joint.
JOINT_COLUMNS = tuple(f"joint {j}" for j in range(1, N_JOINTS + 1))


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]], *, words: int = 1) -> str:
    """A table in Markdown: the first ``words`` columns are text, the others numbers, set to the right."""
    lines = [tuple(head), ("---",) * words + ("---:",) * (len(head) - words), *rows]
    return "\n".join(f"| {' | '.join(line)} |" if line is not lines[1] else f"|{'|'.join(line)}|" for line in lines)
