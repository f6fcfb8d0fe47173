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
from ur5_twin.wire.urscript.values import NUMBERS, SCALARS, Pose, Struct, Value, truth, weight

#: How a block ended, if not at its end.
BREAK, CONTINUE, RETURN = "break", "continue", "return"
_ARITHMETIC = frozenset("+-*/%")
#: What built-ins cost that do not say it with ``costs``: the rest, and those that may wait, as moves are planned.
_BUILTIN, _WAITING = 4, 300
#: What a call and a variable take of memory, as numbers in a list.
_CALL, VARIABLE = 100, 4
_MISSING = object()


class Scope:
    """Variables of a call, and the scope in which its function was defined."""

    __slots__ = ("parent", "variables")

    def __init__(self, parent: Scope | None) -> None:
        self.variables: dict[str, Value] = {}
        self.parent = parent


class Running:
    """A thread, as its closures see it.

    Attributes:
        line: of the statement it is at.
        left: what it may still spend in this tick.
        exhausted: its last turn ended because it had spent all.
        calls: functions it is within.
        result: what the function that just ended returned.
        program: the interpreter.
    """

    line: int
    left: int
    exhausted: bool
    calls: int
    result: Value
    program: Any

    def pay(self, cost: int) -> None:
        """Take from what is left for an expression, which cannot wait.

        Raises:
            ScriptError: an expression spends far more than a tick has.
        """
        self.left -= cost
        if self.left < -limits.OVERDRAFT:
            raise ScriptError("a line that takes far more than a tick; split it")

    def handle(self, value: Value) -> None:
        """Pay for a value that is copied, made or reckoned with."""
        if type(value) not in NUMBERS:
            numbers = weight(value)
            self.program.made += numbers
            self.pay(numbers >> 2)

    def own(self, value: Value) -> Value:
        """A value of which no part is shared."""
        if type(value) in SCALARS:
            return value
        self.handle(value)
        return values.copied(value)


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
        price: what its parameters cost at each call.
        body: its block, compiled.
        defaults: of its parameters, by name.
    """

    define: Define
    depth: int
    price: int = 0
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
        self._words = 0
        self._fitting: set[tuple[str, int, tuple[str, ...]]] = set()

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
            before = self._words
            function.defaults = {name: self._expression(e) for name, e in one.parameters if e is not None}
            function.price = self._price(one.line, before)
            function.body = self._scoped(one.body)
        code = self._block(body)
        self._known.pop()
        return code

    # Statements: generators that return how the block ended, or None.

    def _price(self, line: int, before: int) -> int:
        """What the words cost that were compiled since there were ``before``.

        Raises:
            ScriptError: too many for one expression, which runs in one go.
        """
        words = self._words - before
        if words > limits.EXPRESSION:
            raise ScriptError(f"line {line}: an expression of {words} words; {limits.EXPRESSION} are the most")
        return 1 + words // 4

    def _condition(self, one: Expression) -> tuple[Code, int]:
        before = self._words
        return self._expression(one), self._price(one.line, before)

    def _block(self, body: Block) -> Code:
        items: list[tuple[int, int, bool, Callable[..., Any]]] = []
        for one in body:
            if isinstance(one, Define):
                continue
            before = self._words
            code = self._statement(one)
            # What has blocks of its own lets its conditions pay for themselves.
            cost = 1 if isinstance(one, Branch | Switch | Loop) else self._price(one.line, before)
            items.append((one.line, cost, code.waits, code.run))

        def run(thread: Running, scope: Scope) -> Generator[None, None, str | None]:
            for line, cost, waits, statement in items:
                thread.line = line
                thread.left -= cost
                if thread.left < 0:
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
                struct[name] = thread.own(_given(name, new))
                values.bounded(struct)

            return _then(_all([of, value]), set_member)
        indices = [self._expression(index) for index in one.target.indices]

        def set_item(thread: Running, scope: Scope, found: list[Value]) -> None:
            values.set_item(found[0], found[1:-1], thread.own(found[-1]))

        return _then(_all([of, *indices, value]), set_item)

    def _branch(self, one: Branch) -> Code:
        cases = [
            (None if condition is None else self._condition(condition), self._block(body).run)
            for condition, body in one.cases
        ]

        def run(thread: Running, scope: Scope) -> Generator[None, None, str | None]:
            for priced, body in cases:
                if priced is not None:
                    condition, cost = priced
                    thread.left -= cost
                    if thread.left < 0:
                        thread.exhausted = True
                        yield
                    said = condition.run(thread, scope)
                    if condition.waits:
                        said = yield from said
                    if not truth(said):
                        continue
                return (yield from body(thread, scope))
            return None

        return Code(run, True)

    def _switch(self, one: Switch) -> Code:
        of, price = self._condition(one.of)
        cases = [
            (None if value is None else self._condition(value), self._block(body).run) for value, body in one.cases
        ]

        def run(thread: Running, scope: Scope) -> Generator[None, None, str | None]:
            thread.left -= price
            found = (yield from of.run(thread, scope)) if of.waits else of.run(thread, scope)
            for priced, body in cases:
                if priced is not None:
                    value, cost = priced
                    thread.left -= cost
                    if thread.left < 0:
                        thread.exhausted = True
                        yield
                    said = (yield from value.run(thread, scope)) if value.waits else value.run(thread, scope)
                    thread.handle(said)
                    if said != found:
                        continue
                ended = yield from body(thread, scope)
                return None if ended == BREAK else ended
            return None

        return Code(run, True)

    def _loop(self, one: Loop) -> Code:
        condition, cost = self._condition(one.condition)
        body, line = self._block(one.body).run, one.line

        def run(thread: Running, scope: Scope) -> Generator[None, None, str | None]:
            while True:
                thread.line = line
                thread.left -= cost
                if thread.left < 0:
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
        self._words += 1
        match one:
            case Literal(value=value):
                return Code(lambda thread, scope: value, False)
            case Name(name=name):
                return Code(_load(name), False)
            case ListOf(items=items, pose=pose):
                make = Pose if pose else values.listed
                return _then(
                    _all([self._expression(item) for item in items]),
                    lambda thread, scope, found: make([thread.own(_given("an item", item)) for item in found]),
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
            return _then(of, _negative)
        return _then(of, _positive)

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
            return Code(lambda t, s: work(t, first(t, s), second(t, s)), False)
        return _then(_all([left, right]), lambda thread, scope, found: work(thread, *found))

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
            return _then(
                given,
                lambda thread, scope, found: values.bounded(
                    Struct({name: thread.own(_given(name, value)) for name, value in zip(names, found, strict=True)})
                ),
            )
        return self._built_in(one, given, n, names)

    def _built_in(self, one: Call, given: Code, n: int, names: list[str]) -> Code:
        """A call of a function of the library: the first ``n`` values are given without a name."""
        builtin = self._library.get(one.name)
        if builtin is None:
            raise ScriptError(f"line {one.line}: there is no function '{one.name}'")
        call_of = (one.name, n, tuple(names))
        if call_of not in self._fitting:
            try:
                inspect.signature(builtin).bind(*one.arguments, **dict(one.named))
            except TypeError as error:
                raise ScriptError(f"line {one.line}: {one.name}: {error}") from None
            self._fitting.add(call_of)
        waits = inspect.isgeneratorfunction(builtin)
        cost: int = getattr(builtin, "cost", _WAITING if waits else _BUILTIN)

        def begin(thread: Running, found: list[Value]) -> Any:
            thread.pay(cost)
            for value in found:
                thread.handle(_given(one.name, value))
            return builtin(*found[:n], **dict(zip(names, found[n:], strict=True))) if names else builtin(*found)

        if waits:

            def wait(thread: Running, scope: Scope) -> Generator[None, None, Value]:
                found = (yield from given.run(thread, scope)) if given.waits else given.run(thread, scope)
                result = yield from begin(thread, found)
                thread.handle(result)
                return result

            return Code(wait, True)

        def call(thread: Running, scope: Scope, found: list[Value]) -> Value:
            result = begin(thread, found)
            thread.handle(result)
            return result

        return _then(given, call)

    def _own(self, function: Function, given: Code, names: list[str]) -> Code:
        """A call of one of the program's functions: ``given`` are the values of its parameters ``names``."""
        # The scope in which the function was defined is so many functions further out than its caller's.
        outwards = len(self._known) - 1 - function.depth

        def run(thread: Running, scope: Scope) -> Generator[None, None, Value]:
            found = (yield from given.run(thread, scope)) if given.waits else given.run(thread, scope)
            thread.pay(function.price)
            thread.program.made += _CALL + VARIABLE * len(function.define.parameters)
            parent = _outwards(scope, outwards)
            inner = Scope(parent)
            for name, value in zip(names, found, strict=True):
                inner.variables[name] = thread.own(_given(name, value))
            for name, default in function.defaults.items():
                if name not in inner.variables:
                    value = (yield from default.run(thread, parent)) if default.waits else default.run(thread, parent)
                    inner.variables[name] = thread.own(_given(name, value))
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


def _operation(sign: str) -> Callable[[Running, Value, Value], Value]:
    if sign == "xor":
        return lambda thread, a, b: truth(a) != truth(b)
    work = values.arithmetic if sign in _ARITHMETIC else values.compared

    def operate(thread: Running, a: Value, b: Value) -> Value:
        thread.handle(a)
        thread.handle(b)
        return work(sign, a, b)

    return operate


def _negative(thread: Running, scope: Scope, value: Value) -> Value:
    thread.handle(value)
    return values.negative(value)


def _positive(thread: Running, scope: Scope, value: Value) -> Value:
    if not (isinstance(value, list) or values.is_number(value)):
        raise ScriptError(f"there is no +{values.shown(value)[:40]}")
    return value


def _given(what: str, value: Value) -> Value:
    if value is None:
        raise ScriptError(f"'{what}' would be nothing: the function gives no value")
    return value


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
        _given(name, value)
        target = scope
        if where == "global":
            while target.parent is not None:
                target = target.parent
        elif where == "":
            while name not in target.variables and target.parent is not None:
                target = target.parent
            if name not in target.variables:
                target = scope
        if name not in target.variables:
            thread.program.made += VARIABLE
        target.variables[name] = thread.own(value)

    return store


def _member(of: Value, name: str) -> Value:
    if not isinstance(of, Struct) or name not in of:
        raise ScriptError(f"{values.shown(of)[:40]} has no '{name}'")
    return of[name]
