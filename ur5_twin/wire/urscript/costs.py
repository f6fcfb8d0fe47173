"""What functions of the library take of a thread's time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

_Function = TypeVar("_Function", bound=Callable[..., Any])


def costs(statements: int) -> Callable[[_Function], _Function]:
    """Say what a call takes of ``limits.STATEMENTS``: one for each microsecond, what its lists cost not counted."""

    def mark(function: _Function) -> _Function:
        function.cost = statements  # type: ignore[attr-defined]
        return function

    return mark
