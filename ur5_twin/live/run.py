"""The loop of a live run: from the source through the session to whoever looks, until it is stopped."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from ur5_twin.live.session import Session, Status
from ur5_twin.recording.table import Table
from ur5_twin.sources.device import Device

#: Between two looks at what has come, s: the most that an estimate waits.
_STEP = 0.01
#: Between two times at which views get what has come, and between two status lines, s.
_SHOW, _TELL = 0.08, 0.5
#: Pieces that may wait for a view: some eight seconds. How long a view may take to end, s.
_MOST_WAITING, _PATIENCE = 100, 3.0


class View(Protocol):
    """Anything that shows rows as they come."""

    def show(self, table: Table) -> None:
        """Show the next rows."""
        ...

    def close(self) -> None:
        """Show what is still on its way."""
        ...


class Beside:
    """A view in a thread of its own: one that hangs, a viewer that is gone for example, holds nobody up.

    Attributes:
        left_out: rows that it was too slow for.
    """

    def __init__(self, view: View) -> None:
        self.left_out = 0
        self._view = view
        self._waiting: queue.Queue[Table | None] = queue.Queue(_MOST_WAITING)
        self._thread = threading.Thread(target=self._run, name="ur5-twin view", daemon=True)
        self._thread.start()

    def show(self, table: Table) -> None:
        """Have the next rows shown, if the view keeps up."""
        try:
            self._waiting.put_nowait(table)
        except queue.Full:
            self.left_out += len(table)

    def close(self) -> None:
        """Let it show what is still on its way, for some seconds at most."""
        try:
            self._waiting.put(None, timeout=_PATIENCE)
        except queue.Full:
            return
        self._thread.join(_PATIENCE)

    def _run(self) -> None:
        while (table := self._waiting.get()) is not None:
            self._view.show(table)
        self._view.close()


def run(
    source: Device,
    session: Session,
    views: Sequence[View] = (),
    *,
    stop: threading.Event,
    duration: float | None = None,
    tell: Callable[[Status, list[str]], object] | None = None,
) -> None:
    """Go on until ``stop`` is set or ``duration`` seconds are over; source and views are closed then, nothing is lost.

    Args:
        source: started.
        session: what becomes of the rows.
        views: get the rows with all their columns.
        stop: whoever sets it ends the run.
        duration: s.
        tell: called twice a second with how it goes and what has happened since.

    Raises:
        TwinError: what the session raises; all that came before is in its journal.
    """
    end = None if duration is None else time.monotonic() + duration
    shown = told = time.monotonic()
    waiting: list[Table] = []
    news: list[str] = []
    try:
        while not stop.is_set():
            now = time.monotonic()
            if end is not None and now >= end:
                break
            table = session.take(source.rows())
            if table is not None and views:
                waiting.append(table)
            for what in source.news():
                session.note(what)
                news.append(what)
            if now - shown >= _SHOW:
                shown = now
                _show(views, waiting)
            if tell is not None and now - told >= _TELL:
                told = now
                tell(session.status(), news)
                news = []
            stop.wait(max(0.0, _STEP - (time.monotonic() - now)))
    finally:
        # What the source has until here still counts.
        source.close()
        try:
            table = session.take(source.rows())
            for what in source.news():
                session.note(what)
            if table is not None and views:
                waiting.append(table)
            if tell is not None:
                tell(session.status(), news)
        finally:
            session.close()
            _show(views, waiting)
            for view in views:
                view.close()


def _show(views: Sequence[View], waiting: list[Table]) -> None:
    if not waiting:
        return
    columns = {name: np.concatenate([table[name] for table in waiting]) for name in waiting[0].columns}
    table = replace(waiting[0], time=np.concatenate([table.time for table in waiting]), columns=columns)
    waiting.clear()
    for view in views:
        view.show(table)
