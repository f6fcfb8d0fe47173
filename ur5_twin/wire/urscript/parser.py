"""From text to syntax."""

from __future__ import annotations

from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript import limits
from ur5_twin.wire.urscript.lexer import tokens
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
from ur5_twin.wire.urscript.values import kept

#: How strongly binary operators bind; those that bind alike, from the left.
_BINDS = {
    **dict.fromkeys(("or", "xor"), 1),
    "and": 2,
    **dict.fromkeys(("==", "!=", "<", ">", "<=", ">="), 3),
    **dict.fromkeys("+-", 4),
    **dict.fromkeys("*/%", 5),
}
_LOOSEST, _COMPARISON = 1, 3
_POSE = 6


def parse(text: str) -> Program:
    """The program that a text is.

    Raises:
        ScriptError: it is none; names line and column, what is there and what should be.
    """
    return _Parser(text).program()


class _Parser:
    def __init__(self, text: str) -> None:
        found = tokens(text)
        self._tokens = found
        self._kinds, self._words, self._fixed, self._lines = found.kinds, found.words, found.fixed, found.lines
        self._at = 0
        self._depth = 0
        #: Names that have been assigned to so far.
        self._assigned: set[str] = set()
        #: Whether here is a place for ``break``, and for ``continue``.
        self._may_break = self._may_continue = False

    # Tokens

    def _is(self, text: str) -> bool:
        return self._fixed[self._at] == text

    def _accept(self, text: str) -> bool:
        if self._fixed[self._at] != text:
            return False
        self._at += 1
        return True

    def _expect(self, text: str) -> None:
        if self._fixed[self._at] != text:
            raise self._error(f"'{text}'")
        self._at += 1

    def _name(self) -> str:
        if self._kinds[self._at] != "name":
            raise self._error("a name")
        self._at += 1
        return self._words[self._at - 1]

    def _skip_lines(self) -> None:
        while self._kinds[self._at] == "newline":
            self._at += 1

    def _wrong(self, what: str) -> ScriptError:
        return ScriptError(f"{self._tokens.where(self._at)}: {what}")

    def _error(self, wanted: str) -> ScriptError:
        kind, word = self._kinds[self._at], self._words[self._at]
        shown = {"newline": "the end of the line", "end": word}.get(kind, f"'{word[:40]}'")
        return self._wrong(f"{shown} where {wanted} should be")

    def _deeper(self) -> None:
        """Within one more bracket or block; ``self._depth -= 1`` where it ends."""
        self._depth += 1
        if self._depth > limits.NESTING:
            raise self._wrong(f"more than {limits.NESTING} brackets or blocks within one another")

    # Statements

    def program(self) -> Program:
        body = self._until()
        defined = [statement for statement in body if isinstance(statement, Define)]
        first = next((one for one in defined if one.kind != "thread"), None)
        secondary = first is not None and first.kind == "sec" and len(defined) == len(body)
        return Program(body, "" if first is None else first.name, secondary)

    def _until(self, *words: str) -> Block:
        """Statements up to one of the words, or, without any, to the end of the program."""
        statements: list[Statement] = []
        while True:
            while self._kinds[self._at] == "newline" or self._fixed[self._at] == ";":
                self._at += 1
            if self._fixed[self._at] in words or (not words and self._kinds[self._at] == "end"):
                return tuple(statements)
            self._deeper()
            statements.append(self._statement())
            self._depth -= 1

    def _loop(self) -> Block:
        """A block that ``break`` and ``continue`` may leave."""
        before = self._may_break, self._may_continue
        self._may_break = self._may_continue = True
        body = self._until("end")
        self._may_break, self._may_continue = before
        self._expect("end")
        return body

    def _statement(self) -> Statement:
        line, word = self._lines[self._at], self._fixed[self._at]
        match word:
            case None:
                pass
            case "def" | "sec" | "thread":
                return self._define()
            case "if":
                return self._branch()
            case "switch":
                return self._switch()
            case "while":
                self._at += 1
                condition = self._expression()
                self._expect(":")
                return Loop(line, condition, self._loop())
            case "return":
                self._at += 1
                bare = self._kinds[self._at] in ("newline", "end") or self._is("end") or self._is(";")
                return Return(line, None if bare else self._expression())
            case "kill" | "join":
                self._at += 1
                return Thread(line, word, self._expression())
            case "break" | "continue":
                if not (self._may_break if word == "break" else self._may_continue):
                    raise self._wrong(f"'{word}' is not within a loop")
                self._at += 1
                return Plain(line, word)
            case "halt" | "enter_critical" | "exit_critical":
                self._at += 1
                return Plain(line, word)
            case "global" | "local":
                self._at += 1
                name = Name(line, self._name())
                self._assigned.add(name.name)
                self._expect("=")
                return Assign(line, word, name, self._expression())
        begin = self._at
        value = self._expression()
        if self._is("="):
            if not isinstance(value, Name | Index | Member):
                raise self._error("the end of the statement")
            self._at += 1
            match value:
                case Index(of=Name(name="digital_out"), indices=(number,)) if "digital_out" not in self._assigned:
                    # The first controllers' way to set an output.
                    return Evaluate(line, Call(line, "set_digital_out", (number, self._expression())))
                case Name(name=name):
                    self._assigned.add(name)
            return Assign(line, "", value, self._expression())
        if not isinstance(value, Call | Run):
            self._at = begin
            raise self._wrong("a value of which nothing is made: neither a call nor 'name = value'")
        return Evaluate(line, value)

    def _define(self) -> Define:
        line, kind = self._lines[self._at], self._words[self._at]
        self._at += 1
        name = self._name()
        self._expect("(")
        parameters: dict[str, Expression | None] = {}
        self._skip_lines()
        while not self._accept(")"):
            if parameters:
                self._expect(",")
                self._skip_lines()
            if self._words[self._at] in parameters:
                raise self._wrong(f"{name}: two parameters '{self._words[self._at]}'")
            parameter = self._name()
            parameters[parameter] = self._expression() if self._accept("=") else None
            self._skip_lines()
            if len(parameters) > limits.PARAMETERS:
                raise self._error("')'")
        self._expect(":")
        before = self._may_break, self._may_continue
        self._may_break = self._may_continue = False
        body = self._until("end")
        self._may_break, self._may_continue = before
        self._expect("end")
        return Define(line, kind, name, tuple(parameters.items()), body)

    def _branch(self) -> Branch:
        line = self._lines[self._at]
        self._at += 1
        cases: list[tuple[Expression | None, Block]] = []
        while True:
            condition = self._expression()
            self._expect(":")
            cases.append((condition, self._until("elif", "else", "end")))
            if not self._accept("elif"):
                break
        if self._accept("else"):
            self._expect(":")
            cases.append((None, self._until("end")))
        self._expect("end")
        return Branch(line, tuple(cases))

    def _switch(self) -> Switch:
        line = self._lines[self._at]
        self._at += 1
        of = self._expression()
        self._expect(":")
        before, self._may_break = self._may_break, True
        cases: list[tuple[Expression | None, Block]] = []
        self._skip_lines()
        while not self._accept("end"):
            if self._accept("default"):
                value = None
            else:
                self._expect("case")
                value = self._expression()
            self._expect(":")
            cases.append((value, self._until("end")))
            self._expect("end")
            self._skip_lines()
        self._may_break = before
        return Switch(line, of, tuple(cases))

    # Expressions

    def _expression(self) -> Expression:
        self._deeper()
        found = self._binary(_LOOSEST)
        self._depth -= 1
        return found

    def _binary(self, least: int) -> Expression:
        """What operators bind together that bind at least so strongly."""
        left = self._unary()
        chained = 0
        while True:
            at = self._at
            sign = self._fixed[at]
            binds = 0 if sign is None else _BINDS.get(sign, 0)
            if binds < least:
                return left
            assert sign is not None
            # A chain is a tree as deep as it is long.
            chained += 1
            if chained > limits.NESTING:
                raise self._wrong(f"more than {limits.NESTING} operators in a row; use variables")
            self._at += 1
            left = Binary(self._lines[at], sign, left, self._binary(binds + 1))

    def _unary(self) -> Expression:
        # An operand may stand on the next line: 'x = # why', and there the value.
        self._skip_lines()
        sign = self._fixed[self._at]
        if sign not in ("-", "+", "not"):
            return self._postfix(self._primary())
        line = self._lines[self._at]
        self._at += 1
        self._deeper()
        # 'not' takes a comparison, as in 'not a == b'.
        of = self._binary(_COMPARISON) if sign == "not" else self._unary()
        self._depth -= 1
        return Unary(line, sign, of)

    def _postfix(self, of: Expression) -> Expression:
        steps = 0
        while True:
            line, sign = self._lines[self._at], self._fixed[self._at]
            if sign == "[":
                of = Index(line, of, self._indices())
            elif sign == ".":
                self._at += 1
                of = Member(line, of, self._name())
            else:
                return of
            steps += 1
            if steps > limits.NESTING:
                raise self._error("the end of the expression")

    def _primary(self) -> Expression:
        at = self._at
        line, word, kind = self._lines[at], self._words[at], self._kinds[at]
        self._at += 1
        if kind == "name":
            if self._accept("("):
                return self._call(line, word)
            if word == "p" and self._is("["):
                # Six numbers are a pose; one or two are indices into a variable that is called p.
                items = self._indices(_POSE)
                if len(items) == _POSE:
                    return ListOf(line, items, pose=True)
                return Index(line, Name(line, word), items)
            return Name(line, word)
        if kind == "number":
            return Literal(line, _number(word))
        if kind == "string":
            return Literal(line, word)
        match self._fixed[at]:
            case "True" | "False":
                return Literal(line, word == "True")
            case "run":
                name = self._name()
                self._expect("(")
                return Run(line, self._call(line, name))
            case "(":
                inner = self._expression()
                self._skip_lines()
                self._expect(")")
                return inner
            case "[":
                return ListOf(line, self._items("]"))
        self._at = at
        raise self._error("a value")

    def _indices(self, *also: int) -> tuple[Expression, ...]:
        """One index or two in their brackets, or as many items as one of ``also``."""
        begin = self._at
        self._at += 1
        items = self._items("]")
        if len(items) not in (1, 2, *also):
            self._at = begin
            raise self._wrong(f"{len(items)} indices; a list has one, a matrix two")
        return items

    def _items(self, closing: str) -> tuple[Expression, ...]:
        items: list[Expression] = []
        self._skip_lines()
        while not self._accept(closing):
            if items:
                self._expect(",")
                self._skip_lines()
            items.append(self._expression())
            self._skip_lines()
            if len(items) > limits.LIST:
                raise self._error(f"'{closing}' after {limits.LIST} items at the latest")
        return tuple(items)

    def _call(self, line: int, name: str) -> Call:
        arguments: list[Expression] = []
        named: dict[str, Expression] = {}
        self._skip_lines()
        while not self._accept(")"):
            if arguments or named:
                self._expect(",")
                self._skip_lines()
            if self._kinds[self._at] == "name" and self._fixed[self._at + 1] == "=":
                parameter = self._words[self._at]
                if parameter in named:
                    raise self._wrong(f"{name}: '{parameter}' is given twice")
                self._at += 2
                named[parameter] = self._expression()
            elif named:
                raise self._error("'name =', as before,")
            else:
                arguments.append(self._expression())
            self._skip_lines()
            if len(arguments) + len(named) > limits.LIST:
                raise self._error("')'")
        return Call(line, name, tuple(arguments), tuple(named.items()))


def _number(word: str) -> int | float:
    if word[:2] in ("0x", "0X"):
        return kept(int(word, 16)) if len(word) <= 18 else float("inf")
    if word.isdigit() and len(word) <= 10:
        return kept(int(word))
    return float(word)
