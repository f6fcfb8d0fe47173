"""Threads, ticks and what ends them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from ur5_twin.wire.urscript import Interpreter, costs, library, limits, parse

ENDLESS = "while True:\n x = 1\nend"


def test_a_tick_runs_to_the_next_sync(start: Callable[..., Any]) -> None:
    ran = start("i = 0\nwhile i < 3:\n i = i + 1\n textmsg(i)\n sync()\nend\ntextmsg(9)")
    for printed in (["1"], ["1", "2"], ["1", "2", "3"], ["1", "2", "3", "9"]):
        assert ran.interpreter.running
        assert ran.steps(1).printed == printed
    assert not ran.interpreter.running
    assert ran.interpreter.error is None
    assert ran.steps(1).printed == ["1", "2", "3", "9"]


def test_a_built_in_blocks_for_as_many_ticks_as_it_yields(start: Callable[..., Any]) -> None:
    def wait(ticks: int) -> Iterator[None]:
        for _ in range(ticks):
            yield
        return "done"

    ran = start("textmsg(wait(ticks = 2))\ntextmsg(wait(0))", {"wait": wait}).steps(2)
    assert ran.printed == []
    assert ran.interpreter.line == 1
    assert ran.steps(1).printed == ["done", "done"]


def test_threads_take_turns_in_the_order_they_were_started(start: Callable[..., Any]) -> None:
    text = """
    def program():
      thread a():
        while True:
          textmsg("a")
          sync()
        end
      end
      thread b():
        while True:
          textmsg("b")
          sync()
        end
      end
      run b()
      run a()
      while True:
        textmsg("main")
        sync()
      end
    end"""
    # A thread has its first turn in the tick after.
    assert start(text).steps(3).printed == ["main", *["main", "b", "a"] * 2]


def test_kill_closes_what_a_thread_waits_for(start: Callable[..., Any]) -> None:
    closed: list[str] = []

    def move(name: str) -> Iterator[None]:
        try:
            while True:
                yield
        finally:
            closed.append(name)

    text = """
    def program():
      thread t():
        move("t")
        textmsg("not reached")
      end
      h = run t()
      sync()
      sync()
      kill h
      h = 0
      kill h
      textmsg("killed")
      move("main")
    end"""
    ran = start(text, {"move": move}).steps(3)
    assert closed == ["t"]
    assert ran.printed == ["killed"]
    ran.interpreter.kill_all()
    assert closed == ["t", "main"]
    assert not ran.interpreter.running
    assert ran.interpreter.line == 14
    assert ran.interpreter.error is None


def test_the_end_of_the_program_ends_its_threads(start: Callable[..., Any]) -> None:
    text = 'def f():\n thread t():\n  while True:\n   textmsg("t")\n   sync()\n  end\n end\n run t()\n sync()\nend'
    ran = start(text).steps(5)
    assert ran.printed == []
    assert not ran.interpreter.running


def test_halt_in_any_thread_ends_all(start: Callable[..., Any]) -> None:
    text = "def f():\n thread t():\n  sync()\n  halt\n end\n run t()\n while True:\n  textmsg(1)\n  sync()\n end\nend"
    ran = start(text).steps(5)
    assert ran.printed == ["1", "1", "1"]
    assert not ran.interpreter.running
    assert ran.interpreter.error is None


def test_an_error_in_any_thread_ends_the_program_with_its_line(start: Callable[..., Any]) -> None:
    text = "def f():\n thread t():\n  sync()\n  x = [1,\n   2][5]\n end\n run t()\n while True:\n  sync()\n end\nend"
    ran = start(text).steps(5)
    assert not ran.interpreter.running
    assert str(ran.interpreter.error) == "line 4: index 5 of a list of 2"


def test_an_error_inside_a_call_has_the_line_inside(start: Callable[..., Any]) -> None:
    ran = start("def f():\n def g(x):\n  return sqrt(x)\n end\n y = 1\n g(-1)\nend").steps(1)
    assert str(ran.interpreter.error) == "line 3: sqrt of -1: not defined there"
    assert ran.interpreter.line == 3


@pytest.mark.parametrize("error", [ValueError("as bad as can be"), KeyError(3), ZeroDivisionError("zero")])
def test_whatever_a_built_in_raises_ends_the_program(start: Callable[..., Any], error: Exception) -> None:
    def bad() -> None:
        raise error

    ran = start("x = 1\nbad()", {"bad": bad}).steps(1)
    assert str(ran.interpreter.error) == f"line 2: {error}"


def test_a_variable_without_value_is_named(start: Callable[..., Any]) -> None:
    ran = start("if False:\n x = 1\nend\ntextmsg(x)").steps(1)
    assert str(ran.interpreter.error) == "line 4: there is no variable 'x'"
    ran = start("def p():\n def f():\n  if False:\n   y = 1\n  end\n  return y\n end\n f()\nend").steps(1)
    assert str(ran.interpreter.error) == "line 6: there is no variable 'y'"


@pytest.fixture
def scarce(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ticks in which a thread runs some tens of statements, and all together some more."""
    monkeypatch.setattr(limits, "STATEMENTS", 50)
    monkeypatch.setattr(limits, "TICK", 120)


CRITICAL = """
    def program():
      n = 0
      thread t():
        while True:
          textmsg(n)
          sync()
        end
      end
      run t()
      sync()
      {}
      while n < 100:
        n = n + 1
      end
      {}
      textmsg("counted")
      sync()
      sync()
    end"""


@pytest.mark.usefixtures("scarce")
def test_a_critical_section_is_not_interrupted_at_the_end_of_a_budget(start: Callable[..., Any]) -> None:
    """Counting to 100 takes some ticks; the other thread sees what is between only outside of a section."""
    seen = start(CRITICAL.format("", "")).steps(30).printed
    between = [text for text in seen if text not in ("0", "100", "counted")]
    assert between
    seen = start(CRITICAL.format("enter_critical", "exit_critical")).steps(30).printed
    assert [text for text in seen if text not in ("0", "100", "counted")] == []
    assert seen[-3:] == ["counted", "100", "100"]


def test_who_waits_in_a_critical_section_lets_others_run(start: Callable[..., Any]) -> None:
    """As in the ROS driver's program: a motion thread whose loop is a section, a main that joins it within its own."""
    text = """
    def program():
      on = True
      thread move():
        while on:
          enter_critical
          textmsg("moving")
          sync()
          exit_critical
        end
        sync()
        textmsg("moved")
      end
      h = run move()
      enter_critical
      sync()
      sync()
      on = False
      join h
      textmsg("joined")
      exit_critical
    end"""
    assert start(text).steps(8).printed == ["moving", "moved", "joined"]


SECTION = """
    def program():
      thread t():
        enter_critical
        i = 0
        while i < {}:
          i = i + 1
        end
      end
      run t()
      sync()
      sync()
      sync()
      textmsg("main")
    end"""


@pytest.mark.usefixtures("scarce")
def test_a_thread_that_ends_in_a_critical_section_leaves_it(start: Callable[..., Any]) -> None:
    assert start(SECTION.format(50)).steps(20).printed == ["main"]


@pytest.mark.usefixtures("scarce")
def test_a_thread_that_never_leaves_its_critical_section_can_be_ended(start: Callable[..., Any]) -> None:
    # What runs before it in a tick does not know of it yet: the main thread has its turn until then.
    ran = start(SECTION.format(2000000000)).steps(20)
    assert ran.printed == []
    assert ran.interpreter.running
    ran.interpreter.kill_all()
    assert not ran.interpreter.running


def test_what_a_built_in_costs_is_taken_from_the_budget(start: Callable[..., Any]) -> None:
    calls: list[int] = []

    @costs(limits.STATEMENTS // 10)
    def dear() -> None:
        calls.append(1)

    start("while True:\n dear()\nend", {"dear": dear}).steps(1)
    assert 8 <= len(calls) <= 10


@pytest.mark.usefixtures("scarce")
def test_threads_that_had_no_turn_come_first_in_the_next_tick(start: Callable[..., Any]) -> None:
    """Nine threads that never wait, where the tick has time for two or three."""
    turns: dict[int, int] = {}

    def note(number: int) -> None:
        turns[number] = turns.get(number, 0) + 1

    text = "def f():\n global i = 0\n thread t():\n  n = i\n  while True:\n   note(n)\n  end\n end\n"
    text += " while i < 8:\n  i = i + 1\n  run t()\n  sync()\n  sync()\n end\n while True:\n  note(0)\n end\nend"
    ran = start(text, {"note": note}).steps(60)
    turns.clear()
    ran.steps(60)
    assert len(turns) == 9
    assert max(turns.values()) < 1.5 * min(turns.values())


def test_the_same_program_runs_alike_twice() -> None:
    text = "def f():\n thread t():\n  while True:\n   note(random())\n  end\n end\n run t()\n run t()\n join 2\nend"

    def noted() -> list[float]:
        found: list[float] = []
        interpreter = Interpreter(parse(text), {**library(), "note": found.append})
        for _ in range(20):
            interpreter.step()
        return found

    assert noted() == noted()
    assert len(noted()) > 1000
