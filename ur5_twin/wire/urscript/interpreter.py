"""A program at work: its threads, a tick at a time."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from types import GeneratorType
from typing import Any

import numpy as np

from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript import limits
from ur5_twin.wire.urscript.compiler import VARIABLE, Code, Running, Scope, compiled
from ur5_twin.wire.urscript.syntax import Program
from ur5_twin.wire.urscript.values import Struct, Value, shown, weight

#: What a generator takes of memory, as numbers in a list.
_FRAME = 16
#: So much deeper than when they were made may structs be whose innermost parts got others since.
_DEEPER = 2 * limits.NESTING


class _Thread(Running):
    """A thread of the program, between two of its statements."""

    def __init__(self, program: Interpreter, body: Code, scope: Scope) -> None:
        self.line, self.left, self.calls = 0, 0, 0
        self.exhausted = False
        self.result: Value = None
        self.program = program
        self.work: Generator[None, None, Any] = body.run(self, scope)


class Interpreter:
    """Runs a program.

    Each ``step`` gives every thread a turn, in the order in which they began: until it waits (a built-in yields), has
    spent ``limits.STATEMENTS``, or is over. When all together have spent ``limits.TICK`` the others come first in the
    next tick; what one spends beyond it, in an expression, the program waits for. The program is over when its first
    thread is, or with an error in any of them.

    Args:
        program: what to run.
        library: the functions that it does not define itself. Their parameters have URScript's names. A generator
            function waits a tick at each ``yield``; if its thread is killed meanwhile it is closed. ``costs`` says
            which ones are dear.

    Attributes:
        program: what runs.
        error: what it did wrong, with the line; None if nothing.
        made: numbers that its lists got since they were counted.

    Raises:
        ScriptError: it calls what there is not.
    """

    def __init__(self, program: Program, library: Mapping[str, Callable[..., Any]]) -> None:
        self.program = program
        self.error: ScriptError | None = None
        self._critical: _Thread | None = None
        self._within_critical = 0
        self._begun = 0
        self._threads: dict[int, _Thread] = {}
        self.made = 0
        self._share = limits.SECONDARY if program.secondary else 1
        self._left = 0
        self._late: list[int] = []
        self._now: _Thread | None = None
        main = compiled(program, library)
        self._line = 1
        self.begin(main, Scope(None))

    @property
    def running(self) -> bool:
        """Whether it goes on."""
        return bool(self._threads)

    @property
    def line(self) -> int:
        """Line that the first thread is at, or where the program ended."""
        return next(iter(self._threads.values())).line if self._threads else self._line

    @property
    def thread(self) -> int | None:
        """Handle of the thread whose turn it is; None between the turns."""
        return next((handle for handle, thread in self._threads.items() if thread is self._now), None)

    def step(self) -> None:
        """One tick."""
        self._left = min(self._left, 0) + limits.TICK // self._share
        turns = [*self._late, *(handle for handle in self._threads if handle not in self._late)]
        self._late = []
        # What overflows is infinite: the program's affair, nothing to warn of.
        with np.errstate(all="ignore"):
            self._turns(turns)
        if self.made > limits.COUNTED and self._threads:
            self.made = 0
            if self._holds_too_much():
                self._fail(next(iter(self._threads.values())), "the variables hold more than a program may keep")

    def _turns(self, handles: list[int]) -> None:
        for index, handle in enumerate(handles):
            thread = self._threads.get(handle)
            if thread is None:
                continue
            # Checked at each turn: a thread before it in this tick may have entered.
            critical = self._critical
            if critical is not None and critical is not thread and critical.exhausted:
                continue
            if self._left <= 0:
                self._late = handles[index:]
                break
            self._turn(handle, thread)

    def kill_all(self) -> None:
        """End the program; what waits in it is closed."""
        if self._threads:
            self._line = self.line
        # The newest first: the program's own thread may hold what the others need.
        for handle in reversed(list(self._threads)):
            self._end(handle)

    # What the program's statements ask for

    def begin(self, body: Code, scope: Scope) -> int:
        """Another thread; its first turn is in the next tick."""
        if len(self._threads) >= limits.THREADS:
            raise ScriptError(f"more than {limits.THREADS} threads at once")
        self._begun += 1
        self._threads[self._begun] = _Thread(self, body, scope)
        return self._begun

    def kill(self, handle: Value) -> None:
        """End a thread; one that is over stays so. 0 is no thread, and as on a robot it may be killed all the same."""
        if handle == 0 and not isinstance(handle, bool):
            return
        if not isinstance(handle, int) or isinstance(handle, bool) or not 1 <= handle <= self._begun:
            raise ScriptError(f"{shown(handle)[:40]} is no thread")
        if handle in self._threads and self._threads[handle] is self._now:
            raise ScriptError("a thread cannot kill itself; let it return")
        self._end(handle)

    def alive(self, handle: Value) -> bool:
        """Whether a thread still goes on."""
        if not isinstance(handle, int) or isinstance(handle, bool) or not 1 <= handle <= self._begun:
            raise ScriptError(f"{shown(handle)[:40]} is no thread")
        return handle in self._threads

    def halt(self) -> None:
        """End the program after this statement."""
        for handle in reversed(list(self._threads)):
            if self._threads[handle] is not self._now:
                self._end(handle)
        self._halted = True

    def enter_critical(self, thread: Running) -> None:
        """Until ``exit_critical`` no other thread has a turn because this one's was over.

        While it waits for something others do: the ROS driver's program moves and joins within its sections.
        """
        self._critical = thread  # type: ignore[assignment]
        self._within_critical += 1

    def exit_critical(self, thread: Running) -> None:
        """The others again."""
        if self._critical is not thread:
            raise ScriptError("exit_critical without enter_critical")
        self._within_critical -= 1
        if not self._within_critical:
            self._critical = None

    def _turn(self, handle: int, thread: _Thread) -> None:
        thread.left, thread.exhausted = limits.STATEMENTS // self._share, False
        self._left -= thread.left
        self._now, self._halted = thread, False
        first = handle == next(iter(self._threads))
        try:
            next(thread.work)
            over = False
        except StopIteration:
            over = True
        except Exception as error:  # a built-in's, whatever it is, ends the program that called it
            self._now = None
            deep = isinstance(error, RecursionError)
            self._fail(thread, "calls too deep within one another" if deep else str(error) or type(error).__name__)
            return
        self._now = None
        self._left += thread.left
        if self._halted or (over and first):
            self._line = thread.line
            self.kill_all()
        elif over:
            self._end(handle)

    def _fail(self, thread: _Thread, said: str) -> None:
        if self.error is None:
            self.error = ScriptError(said if said.startswith("line ") else f"line {thread.line}: {said}")
        self.kill_all()
        self._line = thread.line

    def _end(self, handle: int) -> None:
        thread = self._threads.pop(handle, None)
        if thread is None:
            return
        if self._critical is thread:
            self._critical, self._within_critical = None, 0
        try:
            thread.work.close()
        except Exception as error:  # of a built-in that tidies up
            self._fail(thread, str(error) or type(error).__name__)

    def _holds_too_much(self) -> bool:
        """Whether its variables, and what its expressions have at hand, are more than a program may keep."""
        held, scopes = 0, set[int]()
        for thread in self._threads.values():
            work: Any = thread.work
            while isinstance(work, GeneratorType) and work.gi_frame is not None:
                frame = work.gi_frame
                held += _FRAME
                here = frame.f_locals
                for value in [here[name] for name in frame.f_code.co_varnames if name in here]:
                    if isinstance(value, list | Struct | str):
                        held += weight(value, -_DEEPER)
                        continue
                    scope = value if isinstance(value, Scope) else None
                    while scope is not None and id(scope) not in scopes:
                        scopes.add(id(scope))
                        held += sum(VARIABLE + weight(kept, -_DEEPER) for kept in scope.variables.values())
                        scope = scope.parent
                if held > limits.HELD:
                    return True
                work = work.gi_yieldfrom
        return False
