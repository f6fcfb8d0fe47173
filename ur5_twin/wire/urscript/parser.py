"""From text to syntax."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript import limits
from ur5_twin.wire.urscript.lexer import Token, tokens
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

#: Binary operators, the loosest first; those of a row bind alike, from the left.
_OPERATORS = (("or", "xor"), ("and",), ("==", "!=", "<", ">", "<=", ">="), ("+", "-"), ("*", "/", "%"))
_POSE = 6
_T = TypeVar("_T")


def parse(text: str) -> Program:
    """The program that a text is.

    Raises:
        ScriptError: it is none; names line and column, what is there and what should be.
    """
    return _Parser(text).program()


class _Parser:
    def __init__(self, text: str) -> None:
        self._tokens = list(tokens(text))
        self._at = 0
        self._depth = 0

    # Tokens

    @property
    def _next(self) -> Token:
        return self._tokens[self._at]

    def _take(self) -> Token:
        token = self._next
        if token.kind != "end":
            self._at += 1
        return token

    def _is(self, text: str) -> bool:
        return self._next.kind in ("sign", "keyword") and self._next.text == text

    def _accept(self, text: str) -> bool:
        found = self._is(text)
        if found:
            self._at += 1
        return found

    def _expect(self, text: str) -> Token:
        if not self._is(text):
            raise self._error(f"'{text}'")
        return self._take()

    def _name(self) -> str:
        if self._next.kind != "name":
            raise self._error("a name")
        return self._take().text

    def _skip_lines(self) -> None:
        while self._next.kind == "newline":
            self._at += 1

    def _error(self, wanted: str) -> ScriptError:
        token = self._next
        shown = {"newline": "the end of the line", "end": token.text}.get(token.kind, f"'{token.text[:40]}'")
        return ScriptError(f"line {token.line}, column {token.column}: {shown} where {wanted} should be")

    def _nested(self, read: Callable[[], _T]) -> _T:
        self._depth += 1
        if self._depth > limits.NESTING:
            token = self._next
            raise ScriptError(
                f"line {token.line}, column {token.column}: more than {limits.NESTING} brackets or blocks within one "
                "another"
            )
        found = read()
        self._depth -= 1
        return found

    # Statements

    def program(self) -> Program:
        body = self._block(lambda: self._next.kind == "end")
        defined = [statement for statement in body if isinstance(statement, Define)]
        first = next((one for one in defined if one.kind != "thread"), None)
        secondary = first is not None and first.kind == "sec" and len(defined) == len(body)
        return Program(body, "" if first is None else first.name, secondary)

    def _block(self, over: Callable[[], bool]) -> Block:
        statements: list[Statement] = []
        while True:
            while self._next.kind == "newline" or self._is(";"):
                self._at += 1
            if over():
                return tuple(statements)
            statements.append(self._nested(self._statement))

    def _until(self, *words: str) -> Block:
        return self._block(lambda: any(self._is(word) for word in words))

    def _statement(self) -> Statement:
        token = self._next
        if token.kind == "keyword":
            match token.text:
                case "def" | "sec" | "thread":
                    return self._define()
                case "if":
                    return self._branch()
                case "switch":
                    return self._switch()
                case "while":
                    self._take()
                    condition = self._expression()
                    self._expect(":")
                    body = self._until("end")
                    self._expect("end")
                    return Loop(token.line, condition, body)
                case "return":
                    self._take()
                    bare = self._next.kind in ("newline", "end") or self._is("end") or self._is(";")
                    return Return(token.line, None if bare else self._expression())
                case "kill" | "join":
                    self._take()
                    return Thread(token.line, token.text, self._expression())
                case "break" | "continue" | "halt" | "enter_critical" | "exit_critical":
                    self._take()
                    return Plain(token.line, token.text)
                case "global" | "local":
                    self._take()
                    name = Name(token.line, self._name())
                    self._expect("=")
                    return Assign(token.line, token.text, name, self._expression())
        value = self._expression()
        if not self._is("="):
            return Evaluate(token.line, value)
        if not isinstance(value, Name | Index | Member):
            raise self._error("the end of the statement")
        self._take()
        return Assign(token.line, "", value, self._expression())

    def _define(self) -> Define:
        kind = self._take()
        name = self._name()
        self._expect("(")
        parameters: list[tuple[str, Expression | None]] = []
        self._skip_lines()
        while not self._accept(")"):
            if parameters:
                self._expect(",")
                self._skip_lines()
            parameter = self._name()
            parameters.append((parameter, self._expression() if self._accept("=") else None))
            self._skip_lines()
        self._expect(":")
        body = self._until("end")
        self._expect("end")
        return Define(kind.line, kind.text, name, tuple(parameters), body)

    def _branch(self) -> Branch:
        line = self._take().line
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
        line = self._take().line
        of = self._expression()
        self._expect(":")
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
        return Switch(line, of, tuple(cases))

    # Expressions

    def _expression(self) -> Expression:
        return self._nested(lambda: self._binary(0))

    def _binary(self, level: int) -> Expression:
        if level == len(_OPERATORS):
            return self._unary()
        left = self._binary(level + 1)
        chained = 0
        while any(self._is(sign) for sign in _OPERATORS[level]):
            token = self._take()
            # A chain is a tree as deep as it is long.
            chained += 1
            if chained > limits.NESTING:
                raise ScriptError(
                    f"line {token.line}, column {token.column}: more than {limits.NESTING} operators in a row; use "
                    "variables"
                )
            left = Binary(token.line, token.text, left, self._binary(level + 1))
        return left

    def _unary(self) -> Expression:
        # An operand may stand on the next line: 'x = # why', and there the value.
        self._skip_lines()
        token = self._next
        for sign in ("-", "+", "not"):
            if self._accept(sign):
                # 'not' takes a comparison, as in 'not a == b'.
                of = self._nested(lambda: self._binary(2)) if sign == "not" else self._nested(self._unary)
                return Unary(token.line, sign, of)
        return self._postfix(self._primary())

    def _postfix(self, of: Expression) -> Expression:
        steps = 0
        while True:
            token = self._next
            if self._accept("["):
                of = Index(token.line, of, self._items("]"))
                if not 1 <= len(of.indices) <= 2:
                    raise ScriptError(
                        f"line {token.line}, column {token.column}: {len(of.indices)} indices; a list has one, a "
                        "matrix two"
                    )
            elif self._accept("."):
                of = Member(token.line, of, self._name())
            else:
                return of
            steps += 1
            if steps > limits.NESTING:
                raise self._error("the end of the expression")

    def _primary(self) -> Expression:
        token = self._take()
        match token.kind:
            case "number":
                return Literal(token.line, _number(token))
            case "string":
                return Literal(token.line, token.text)
            case "keyword" if token.text in ("True", "False"):
                return Literal(token.line, token.text == "True")
            case "keyword" if token.text == "run":
                name = self._name()
                self._expect("(")
                return Run(token.line, self._call(token.line, name))
            case "sign" if token.text == "(":
                inner = self._expression()
                self._skip_lines()
                self._expect(")")
                return inner
            case "sign" if token.text == "[":
                return ListOf(token.line, self._items("]"))
            case "name":
                if self._accept("("):
                    return self._call(token.line, token.text)
                if token.text == "p" and self._is("["):
                    # Six numbers are a pose; one or two are indices into a variable that is called p.
                    begin = self._at
                    self._take()
                    items = self._items("]")
                    if len(items) == _POSE:
                        return ListOf(token.line, items, pose=True)
                    self._at = begin
                return Name(token.line, token.text)
        self._at -= token.kind != "end"
        raise self._error("a value")

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
        named: list[tuple[str, Expression]] = []
        self._skip_lines()
        while not self._accept(")"):
            if arguments or named:
                self._expect(",")
                self._skip_lines()
            following = self._tokens[min(self._at + 1, len(self._tokens) - 1)]
            if self._next.kind == "name" and following.kind == "sign" and following.text == "=":
                parameter = self._name()
                self._take()
                if any(parameter == known for known, _ in named):
                    raise ScriptError(f"line {following.line}: {name}: '{parameter}' is given twice")
                named.append((parameter, self._expression()))
            elif named:
                raise self._error("'name =', as before,")
            else:
                arguments.append(self._expression())
            self._skip_lines()
            if len(arguments) + len(named) > limits.LIST:
                raise self._error("')'")
        return Call(line, name, tuple(arguments), tuple(named))


def _number(token: Token) -> int | float:
    if token.text[:2] in ("0x", "0X"):
        return int(token.text, 16) if len(token.text) <= 18 else float("inf")
    if token.text.isdigit() and len(token.text) <= 10:
        return int(token.text)
    return float(token.text)
