"""Who does the tasks. An engine that spreads work over machines is another class with ``run``."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Protocol, TypeVar

T = TypeVar("T")
R = TypeVar("R")


class Executor(Protocol):
    """Does independent tasks, in whatever order and place."""

    def run(self, work: Callable[[T], R], tasks: Sequence[T]) -> Iterator[tuple[T, R]]:
        """Each task with what ``work`` made of it, as soon as it is there.

        ``work`` is a module's function and tasks and results are plain data, so that both can be sent elsewhere.
        """
        ...


class Serial:
    """One after the other, here."""

    def run(self, work: Callable[[T], R], tasks: Sequence[T]) -> Iterator[tuple[T, R]]:
        for task in tasks:
            yield task, work(task)


class Processes:
    """So many at once, in processes of their own.

    Args:
        jobs: how many.
        begin: called in each process first.
    """

    def __init__(self, jobs: int, begin: Callable[[], object] | None = None) -> None:
        self._jobs, self._begin = jobs, begin

    def run(self, work: Callable[[T], R], tasks: Sequence[T]) -> Iterator[tuple[T, R]]:
        # Forked processes would share the compilers' and libraries' threads with this one.
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(self._jobs, context, initializer=_start, initargs=(self._begin,)) as pool:
            waiting = {pool.submit(work, task): task for task in tasks}
            try:
                for done in as_completed(waiting):
                    yield waiting[done], done.result()
            finally:
                pool.shutdown(cancel_futures=True)


def _start(begin: Callable[[], object] | None) -> None:
    # Ctrl-C is the parent's to answer: it lets tasks that run come to their end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_outlive_nobody, daemon=True).start()
    if begin is not None:
        begin()


def _outlive_nobody() -> None:
    """A parent that was killed cannot tell its processes to end, and they would wait for tasks for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
