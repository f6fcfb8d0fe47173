"""From syntax to closures that run it.

An expression without calls that may wait becomes a plain function of thread and scope; the others, and all blocks,
become generators, which yield when their thread waits for the next tick.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript import limits, values
from ur5_twin.wire.urscript.syntax import (
    Assign,
    Binary,
    Block,
    Branch,
    Call,
    Define,
    Evaluate,
    Expression,
    Index,
    ListOf,
    Literal,
    Loop,
    Member,
    Name,
    Plain,
    Program,
    Return,
    Run,
    Statement,
    Switch,
    Thread,
    Unary,
)
from ur5_twin.wire.urscript.values import Pose, Struct, Value, truth

#: How a block ended, if not at its end.
BREAK, CONTINUE, RETURN = "break", "continue", "return"
_ARITHMETIC = frozenset("+-*/%")
_MISSING = object()


class Scope:
    """Variables of a call, and the scope in which its function was defined."""

    __slots__ = ("parent", "variables")

    def __init__(self, parent: Scope | None) -> None:
        self.variables: dict[str, Value] = {}
        self.parent = parent


class Running:
    """What a thread's closures need of their thread: see ``interpreter.Thread``."""

    line: int
    spent: int
    exhausted: bool
    calls: int
    result: Value
    program: Any


class Code(NamedTuple):
    """``run(thread, scope)`` gives the value, or, if it ``waits``, a generator that returns it."""

    run: Callable[[Any, Scope], Any]
    waits: bool


@dataclass
class Function:
    """A function of the program.

    Attributes:
        define: its syntax.
        depth: how many functions it is defined within.
        body: its block, compiled.
        defaults: of its parameters, by name.
    """

    define: Define
    depth: int
    body: Code | None = None
    defaults: dict[str, Code] = field(default_factory=dict)


def compiled(program: Program, library: Mapping[str, Callable[..., Any]]) -> Code:
    """The program as one closure; run it in an empty scope.

    Raises:
        ScriptError: it calls what nobody defined, or calls something wrongly.
    """
    try:
        return _Compiler(library).program(program)
    except RecursionError:
        raise ScriptError("the program is nested too deeply") from None


class _Compiler:
    def __init__(self, library: Mapping[str, Callable[..., Any]]) -> None:
        self._library = library
        self._known: list[dict[str, Function]] = []

    def program(self, program: Program) -> Code:
        body = program.body
        defines = [one for one in body if isinstance(one, Define) and one.kind != "thread"]
        if defines and all(isinstance(one, Define) for one in body):
            # A text of functions alone is a program: the first one is what runs.
            first = defines[0]
            body = (*body, Evaluate(first.line, Call(first.line, first.name, ())))
        return self._scoped(body)

    def _scoped(self, body: Block) -> Code:
        """A block with its own functions, which are known throughout it."""
        here: dict[str, Function] = {}
        self._known.append(here)
        defined = [one for one in _within(body) if isinstance(one, Define)]
        for one in defined:
            here[one.name] = Function(one, len(self._known) - 1)
        for one in defined:
            function = here[one.name]
            if function.define is not one:
                continue
            function.defaults = {name: self._expression(e) for name, e in one.parameters if e is not None}
            function.body = self._scoped(one.body)
        code = self._block(body)
        self._known.pop()
        return code

    # Statements: generators that return how the block ended, or None.

    def _block(self, body: Block) -> Code:
        items = [
            (one.line, code.waits, code.run)
            for one in body
            if not isinstance(one, Define)
            for code in [self._statement(one)]
        ]

        def run(thread: Running, scope: Scope) -> Generator[None, None, str | None]:
            for line, waits, statement in items:
                thread.line = line
                thread.spent += 1
                if thread.spent > limits.STATEMENTS:
                    thread.exhausted = True
                    yield
                ended = (yield from statement(thread, scope)) if waits else statement(thread, scope)
                if ended is not None:
                    return ended
            return None

        return Code(run, True)

    def _statement(self, one: Statement) -> Code:
        match one:
            case Assign():
                return self._assign(one)
            case Evaluate():
                return _then(self._expression(one.value), lambda thread, scope, value: None)
            case Branch():
                return self._branch(one)
            case Switch():
                return self._switch(one)
            case Loop():
                return self._loop(one)
            case Return():
                value = Code(lambda thread, scope: None, False) if one.value is None else self._expression(one.value)
                return _then(value, _return)
            case Thread(what="kill"):
                return _then(self._expression(one.handle), lambda thread, scope, value: thread.program.kill(value))
            case Thread():
                return self._join(one)
            case Plain():
                return self._plain(one)
        raise AssertionError(one)

    def _assign(self, one: Assign) -> Code:
        value = self._expression(one.value)
        if isinstance(one.target, Name):
            return _then(value, _store(one.target.name, one.scope))
        of = self._expression(one.target.of)
        if isinstance(one.target, Member):
            name = one.target.name

            def set_member(thread: Running, scope: Scope, found: list[Value]) -> None:
                struct, new = found
                if not isinstance(struct, Struct) or name not in struct:
                    raise ScriptError(f"{values.shown(struct)[:40]} has no '{name}'")
                struct[name] = values.copied(new)

            return _then(_all([of, value]), set_member)
        indices = [self._expression(index) for index in one.target.indices]

        def set_item(thread: Running, scope: Scope, found: list[Value]) -> None:
            values.set_item(found[0], found[1:-1], found[-1])

        return _then(_all([of, *indices, value]), set_item)

    def _branch(self, one: Branch) -> Code:
        cases = [
            (None if condition is None else self._expression(condition), self._block(body).run)
            for condition, body in one.cases
        ]

        def run(thread: Running, scope: Scope) -> Generator[None, None, str | None]:
            for condition, body in cases:
                if condition is not None:
                    said = condition.run(thread, scope)
                    if condition.waits:
                        said = yield from said
                    if not truth(said):
                        continue
                return (yield from body(thread, scope))
            return None

        return Code(run, True)

    def _switch(self, one: Switch) -> Code:
        of = self._expression(one.of)
        cases = [
            (None if value is None else self._expression(value), self._block(body).run) for value, body in one.cases
        ]

        def run(thread: Running, scope: Scope) -> Generator[None, None, str | None]:
            found = (yield from of.run(thread, scope)) if of.waits else of.run(thread, scope)
            for value, body in cases:
                if value is not None:
                    said = (yield from value.run(thread, scope)) if value.waits else value.run(thread, scope)
                    if said != found:
                        continue
                ended = yield from body(thread, scope)
                return None if ended == BREAK else ended
            return None

        return Code(run, True)

    def _loop(self, one: Loop) -> Code:
        condition, body, line = self._expression(one.condition), self._block(one.body).run, one.line

        def run(thread: Running, scope: Scope) -> Generator[None, None, str | None]:
            while True:
                thread.line = line
                thread.spent += 1
                if thread.spent > limits.STATEMENTS:
                    thread.exhausted = True
                    yield
                said = condition.run(thread, scope)
                if condition.waits:
                    said = yield from said
                if not truth(said):
                    return None
                ended = yield from body(thread, scope)
                if ended == BREAK:
                    return None
                if ended == RETURN:
                    return ended

        return Code(run, True)

    def _join(self, one: Thread) -> Code:
        handle = self._expression(one.handle)

        def run(thread: Running, scope: Scope) -> Generator[None, None, None]:
            found = (yield from handle.run(thread, scope)) if handle.waits else handle.run(thread, scope)
            while thread.program.alive(found):
                yield

        return Code(run, True)

    def _plain(self, one: Plain) -> Code:
        match one.what:
            case "break" | "continue":
                return Code(lambda thread, scope: one.what, False)
            case "halt":

                def halt(thread: Running, scope: Scope) -> Generator[None, None, None]:
                    thread.program.halt()
                    yield

                return Code(halt, True)
            case "enter_critical":
                return Code(lambda thread, scope: thread.program.enter_critical(thread), False)
            case _:
                return Code(lambda thread, scope: thread.program.exit_critical(thread), False)

    # Expressions

    def _expression(self, one: Expression) -> Code:
        match one:
            case Literal(value=value):
                return Code(lambda thread, scope: value, False)
            case Name(name=name):
                return Code(_load(name), False)
            case ListOf(items=items, pose=pose):
                make = Pose if pose else values.listed
                return _then(
                    _all([self._expression(item) for item in items]),
                    lambda thread, scope, found: make([values.copied(item) for item in found]),
                )
            case Index():
                parts = _all([self._expression(part) for part in (one.of, *one.indices)])
                return _then(parts, lambda thread, scope, found: values.item(found[0], found[1:]))
            case Member(name=name):
                return _then(self._expression(one.of), lambda thread, scope, found: _member(found, name))
            case Unary():
                return self._unary(one)
            case Binary():
                return self._binary(one)
            case Call():
                return self._call(one)
            case Run(call=call):
                return self._run(call)
        raise AssertionError(one)

    def _unary(self, one: Unary) -> Code:
        of = self._expression(one.of)
        if one.sign == "not":
            return _then(of, lambda thread, scope, found: not truth(found))
        if one.sign == "-":
            return _then(of, lambda thread, scope, found: values.negative(found))
        return of

    def _binary(self, one: Binary) -> Code:
        sign, left, right = one.sign, self._expression(one.left), self._expression(one.right)
        if sign in ("and", "or"):
            # What decides alone decides.
            decisive = sign == "or"
            if not left.waits and not right.waits:
                first, second = left.run, right.run
                if decisive:
                    return Code(lambda t, s: truth(first(t, s)) or truth(second(t, s)), False)
                return Code(lambda t, s: truth(first(t, s)) and truth(second(t, s)), False)

            def run(thread: Running, scope: Scope) -> Generator[None, None, bool]:
                said = (yield from left.run(thread, scope)) if left.waits else left.run(thread, scope)
                if truth(said) == decisive:
                    return decisive
                return truth((yield from right.run(thread, scope)) if right.waits else right.run(thread, scope))

            return Code(run, True)
        work = _operation(sign)
        if not left.waits and not right.waits:
            first, second = left.run, right.run
            return Code(lambda t, s: work(first(t, s), second(t, s)), False)
        return _then(_all([left, right]), lambda thread, scope, found: work(*found))

    def _function(self, name: str) -> Function | None:
        return next((known[name] for known in reversed(self._known) if name in known), None)

    def _call(self, one: Call) -> Code:
        function = self._function(one.name)
        n, names = len(one.arguments), [name for name, _ in one.named]
        # Each argument is compiled once: calls within calls would else take as long as two to their depth.
        given = _all([self._expression(e) for e in (*one.arguments, *(value for _, value in one.named))])
        if function is not None:
            _check(one, function.define)
            return self._own(function, given, [*(name for name, _ in function.define.parameters[:n]), *names])
        if one.name == "struct" and not n:
            return _then(given, lambda thread, scope, found: Struct(zip(names, map(values.copied, found), strict=True)))
        builtin = self._library.get(one.name)
        if builtin is None:
            raise ScriptError(f"line {one.line}: there is no function '{one.name}'")
        try:
            inspect.signature(builtin).bind(*one.arguments, **dict(one.named))
        except TypeError as error:
            raise ScriptError(f"line {one.line}: {one.name}: {error}") from None
        if inspect.isgeneratorfunction(builtin):

            def wait(thread: Running, scope: Scope) -> Generator[None, None, Value]:
                found = (yield from given.run(thread, scope)) if given.waits else given.run(thread, scope)
                return (yield from builtin(*found[:n], **dict(zip(names, found[n:], strict=True))))

            return Code(wait, True)
        if not names:
            return _then(given, lambda thread, scope, found: builtin(*found))
        return _then(
            given, lambda thread, scope, found: builtin(*found[:n], **dict(zip(names, found[n:], strict=True)))
        )

    def _own(self, function: Function, given: Code, names: list[str]) -> Code:
        """A call of one of the program's functions: ``given`` are the values of its parameters ``names``."""
        # The scope in which the function was defined is so many functions further out than its caller's.
        outwards = len(self._known) - 1 - function.depth

        def run(thread: Running, scope: Scope) -> Generator[None, None, Value]:
            found = (yield from given.run(thread, scope)) if given.waits else given.run(thread, scope)
            parent = _outwards(scope, outwards)
            inner = Scope(parent)
            for name, value in zip(names, found, strict=True):
                inner.variables[name] = values.copied(value)
            for name, default in function.defaults.items():
                if name not in inner.variables:
                    value = (yield from default.run(thread, parent)) if default.waits else default.run(thread, parent)
                    inner.variables[name] = values.copied(value)
            thread.calls += 1
            if thread.calls > limits.CALLS:
                raise ScriptError(f"more than {limits.CALLS} calls within one another")
            assert function.body is not None
            line, thread.result = thread.line, None
            yield from function.body.run(thread, inner)
            thread.calls -= 1
            thread.line = line
            result, thread.result = thread.result, None
            return result

        return Code(run, True)

    def _run(self, call: Call) -> Code:
        function = self._function(call.name)
        if function is None or function.define.kind != "thread":
            raise ScriptError(f"line {call.line}: there is no thread '{call.name}' to run")
        if call.arguments or call.named:
            raise ScriptError(f"line {call.line}: thread '{call.name}' takes no arguments")
        outwards = len(self._known) - 1 - function.depth

        def run(thread: Running, scope: Scope) -> int:
            assert function.body is not None
            return thread.program.begin(function.body, Scope(_outwards(scope, outwards)))

        return Code(run, False)


def _outwards(scope: Scope, functions: int) -> Scope:
    """The scope of the so many-th function around."""
    for _ in range(functions):
        assert scope.parent is not None
        scope = scope.parent
    return scope


def _within(body: Block) -> list[Statement]:
    """Statements of a block and of its branches and loops: what they define belongs to the function they are in."""
    found: list[Statement] = []
    for one in body:
        found.append(one)
        if isinstance(one, Branch | Switch):
            for _, inner in one.cases:
                found += _within(inner)
        elif isinstance(one, Loop):
            found += _within(one.body)
    return found


def _check(call: Call, define: Define) -> None:
    if define.kind == "thread":
        raise ScriptError(f"line {call.line}: '{call.name}' is a thread: run {call.name}()")
    parameters = [name for name, _ in define.parameters]
    needed = [name for name, default in define.parameters if default is None]
    if len(call.arguments) > len(parameters):
        raise ScriptError(
            f"line {call.line}: {call.name} takes {len(parameters)} arguments, {len(call.arguments)} are given"
        )
    given = parameters[: len(call.arguments)]
    for name, _ in call.named:
        if name not in parameters:
            raise ScriptError(f"line {call.line}: {call.name} has no parameter '{name}' ({', '.join(parameters)})")
        if name in given:
            raise ScriptError(f"line {call.line}: {call.name}: '{name}' is given twice")
        given.append(name)
    missing = [name for name in needed if name not in given]
    if missing:
        raise ScriptError(f"line {call.line}: {call.name}: no '{missing[0]}' is given")


def _operation(sign: str) -> Callable[[Value, Value], Value]:
    if sign in _ARITHMETIC:
        return lambda a, b: values.arithmetic(sign, a, b)
    if sign == "xor":
        return lambda a, b: truth(a) != truth(b)
    if sign == "==":
        return lambda a, b: a == b
    return lambda a, b: values.compared(sign, a, b)


def _all(codes: list[Code]) -> Code:
    """The values of several expressions as a list."""
    if not any(code.waits for code in codes):
        runs = [code.run for code in codes]
        return Code(lambda thread, scope: [run(thread, scope) for run in runs], False)

    def run(thread: Running, scope: Scope) -> Generator[None, None, list[Value]]:
        found = []
        for code in codes:
            value = code.run(thread, scope)
            found.append((yield from value) if code.waits else value)
        return found

    return Code(run, True)


def _then(of: Code, work: Callable[[Any, Scope, Any], Any]) -> Code:
    """``work`` on an expression's value."""
    first = of.run
    if not of.waits:
        return Code(lambda thread, scope: work(thread, scope, first(thread, scope)), False)

    def run(thread: Running, scope: Scope) -> Generator[None, None, Any]:
        return work(thread, scope, (yield from first(thread, scope)))

    return Code(run, True)


def _return(thread: Running, scope: Scope, value: Value) -> str:
    thread.result = value
    return RETURN


def _load(name: str) -> Callable[[Running, Scope], Value]:
    def load(thread: Running, scope: Scope | None) -> Value:
        while scope is not None:
            value = scope.variables.get(name, _MISSING)
            if value is not _MISSING:
                return value  # type: ignore[return-value]
            scope = scope.parent
        raise ScriptError(f"there is no variable '{name}'")

    return load


def _store(name: str, where: str) -> Callable[[Running, Scope, Value], None]:
    """Into the variable of that name wherever it is, a new one of this call if there is none."""

    def store(thread: Running, scope: Scope, value: Value) -> None:
        if value is None:
            raise ScriptError(f"'{name}' would be nothing: the function gives no value")
        target = scope
        if where == "global":
            while target.parent is not None:
                target = target.parent
        elif where == "":
            while name not in target.variables and target.parent is not None:
                target = target.parent
            if name not in target.variables:
                target = scope
        target.variables[name] = values.copied(value)

    return store


def _member(of: Value, name: str) -> Value:
    if not isinstance(of, Struct) or name not in of:
        raise ScriptError(f"{values.shown(of)[:40]} has no '{name}'")
    return of[name]
