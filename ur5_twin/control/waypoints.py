"""Waypoint files in the lab's format: one URScript move a line (thesis section 4.4.1, figure 4.5).

    # keyword and waiting time in s, as the lab's program took them on its command line; may be left out
    joint_space 3.2
    movej([2.181661, -2.135061, -1.745329, 0.275936, -6.021385, 0])
    movel(p[0.4, 0.2, 0.3, 0, 3.1415, 0], a=1.2, v=0.25)

Numbers are in m, rad and s. Under ``task_space`` a movej runs as a movel to the same place.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from ur5_twin.control.commands import Move, MoveJ, MoveL, Pose, Sent
from ur5_twin.control.trajectory import require_positive
from ur5_twin.errors import ScenarioError, TwinError, unknown

Space = Literal["joint_space", "task_space"]
SPACES: tuple[Space, ...] = get_args(Space)
#: The lab's default, s.
WAIT = 3.0
_MOVES: dict[str, type[MoveJ] | type[MoveL]] = {"movej": MoveJ, "movel": MoveL}
#: URScript's order of arguments after the goal.
_ARGUMENTS = ("a", "v", "t", "r")


@dataclass(frozen=True)
class Waypoints:
    """A waypoint file.

    Attributes:
        moves: as written, one a line.
        space: how a movej is planned.
        wait: s between two commands.

    Raises:
        TwinError: no moves, an unknown keyword, a waiting time that is not positive, or, under ``task_space``, a movej
            that gives a or v: they are rad/s^2 and rad/s, a line needs m/s^2 and m/s.
    """

    moves: tuple[Move, ...]
    space: Space = "joint_space"
    wait: float = WAIT

    def __post_init__(self) -> None:
        object.__setattr__(self, "moves", tuple(self.moves))
        if not self.moves:
            raise TwinError("waypoints: there is no move")
        if self.space not in SPACES:
            raise TwinError(f"waypoints: {unknown('keyword', self.space, SPACES)}")
        require_positive("waypoints", wait=self.wait)
        self.commands()

    def commands(self) -> tuple[Move, ...]:
        """The moves as they are planned."""
        return tuple(_planned(move, self.space) for move in self.moves)

    def sent(self) -> Sent:
        """The moves as the lab's program sends them: one each ``wait`` seconds."""
        return Sent.every(self.commands(), self.wait)


def read_waypoints(path: Path, *, space: Space | None = None, wait: float | None = None) -> Waypoints:
    """Read a waypoint file.

    Args:
        path: of the file.
        space: rules over the file's keyword; without both it is ``joint_space``.
        wait: s, rules over the file's; without both it is 3 s.

    Raises:
        ScenarioError: the file cannot be read or a line is wrong; the message names file and line.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ScenarioError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{path.name} is not UTF-8 text: {error}") from None
    moves: list[Move] = []
    numbers: list[int] = []
    file_space: Space | None = None
    file_wait: float | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        content = line.split("#", 1)[0].strip()
        if not content:
            continue
        try:
            if "(" in content:
                moves.append(parse_move(content))
                numbers.append(number)
                continue
            if file_space is not None or moves:
                raise TwinError(f"'{content}' is no move; keyword and waiting time stand once, before the moves")
            file_space, file_wait = _settings(content)
        except TwinError as error:
            raise ScenarioError(f"{path.name} line {number}: {error}") from None
    space = space if space is not None else file_space or "joint_space"
    where = path.name
    try:
        for number, move in zip(numbers, moves, strict=True):
            where = f"{path.name} line {number}"
            _planned(move, space)
        where = path.name
        return Waypoints(tuple(moves), space, wait if wait is not None else file_wait or WAIT)
    except TwinError as error:
        raise ScenarioError(f"{where}: {error}") from None


def write_waypoints(waypoints: Waypoints, path: Path) -> None:
    """Write a waypoint file that ``read_waypoints`` reads back to the same numbers.

    Raises:
        ScenarioError: the file cannot be written.
    """
    lines = [f"{waypoints.space} {waypoints.wait!r}", *(format_move(move) for move in waypoints.moves)]
    try:
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise ScenarioError(f"cannot write {path}: {error.strerror}") from None


def parse_move(text: str) -> Move:
    """A move from URScript: ``movej([q1, ..., q6], a=1.4, v=1.05, t=0, r=0)``, ``movel(p[x, y, z, rx, ry, rz])``.

    Either takes six joint positions in brackets or a pose p[...]; a, v, t and r by name or in this order.

    Raises:
        TwinError: it is no such call.
    """
    try:
        call = ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError):
        raise TwinError(f"'{text}' is no URScript call such as movej([q1, q2, q3, q4, q5, q6])") from None
    if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name):
        raise TwinError(f"'{text}' is no URScript call such as movej([q1, q2, q3, q4, q5, q6])")
    name = call.func.id
    if name not in _MOVES:
        raise TwinError(unknown("command", name, _MOVES))
    if not call.args or len(call.args) > 1 + len(_ARGUMENTS):
        raise TwinError(
            f"{name}: {len(call.args)} arguments, expected a goal and up to {len(_ARGUMENTS)} more (a, v, t, r)"
        )
    values = {key: _number(node, f"{name}: {key}") for key, node in zip(_ARGUMENTS, call.args[1:], strict=False)}
    for keyword in call.keywords:
        if keyword.arg not in _ARGUMENTS:
            raise TwinError(f"{name}: {unknown('argument', str(keyword.arg), _ARGUMENTS)}")
        if keyword.arg in values:
            raise TwinError(f"{name}: {keyword.arg} is given twice")
        values[keyword.arg] = _number(keyword.value, f"{name}: {keyword.arg}")
    return _MOVES[name](_goal(call.args[0], name), **values)


def format_move(move: Move) -> str:
    """A move as URScript; arguments at their defaults are left out."""
    numbers = move.goal.vector if isinstance(move.goal, Pose) else move.goal
    goal = f"{'p' if isinstance(move.goal, Pose) else ''}[{', '.join(map(repr, numbers))}]"
    default = type(move)(move.goal)
    given = [f"{key}={getattr(move, key)!r}" for key in _ARGUMENTS if getattr(move, key) != getattr(default, key)]
    return f"{move.name}({', '.join([goal, *given])})"


def _goal(node: ast.expr, name: str) -> tuple[float, ...] | Pose:
    if isinstance(node, ast.List):
        return tuple(_number(item, f"{name}: goal") for item in node.elts)
    if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name) and node.value.id == "p":
        items = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        return Pose(tuple(_number(item, f"{name}: pose") for item in items))
    raise TwinError(f"{name}: the goal is '{ast.unparse(node)}', expected [q1, ..., q6] or p[x, y, z, rx, ry, rz]")


def _number(node: ast.expr, what: str) -> float:
    try:
        value = ast.literal_eval(node)
    except ValueError:
        value = None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TwinError(f"{what}: '{ast.unparse(node)}' is no number")
    return float(value)


def _settings(content: str) -> tuple[Space, float | None]:
    keyword, *rest = content.split()
    if keyword not in SPACES:
        raise TwinError(f"{unknown('keyword', keyword, SPACES)}; a move looks like movej([q1, q2, q3, q4, q5, q6])")
    if len(rest) > 1:
        raise TwinError(f"'{content}': expected a keyword and at most one waiting time in s")
    try:
        wait = float(rest[0]) if rest else None
    except ValueError:
        raise TwinError(f"waiting time '{rest[0]}' is no number of seconds") from None
    if wait is not None:
        require_positive("keyword line", wait=wait)
    return ("task_space" if keyword == "task_space" else "joint_space"), wait


def _planned(move: Move, space: Space) -> Move:
    if space == "joint_space" or not isinstance(move, MoveJ):
        return move
    default = MoveJ(move.goal)
    if move.t == 0.0 and (move.a, move.v) != (default.a, default.v):
        raise TwinError(
            f"under task_space {format_move(move)} has a or v in rad, which a line of the flange has no use for; "
            "write it as movel with m/s^2 and m/s, or leave them out"
        )
    return MoveL(move.goal, t=move.t, r=move.r)
