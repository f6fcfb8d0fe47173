"""A robot that is listened to: connected, lost and found again."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

from ur5_twin.errors import WireError
from ur5_twin.live.follow import Beat, Follower
from ur5_twin.sources.device import Device

#: Between two tries to connect again: the first, and the longest, s.
_BACK_OFF = (0.5, 5.0)


def beats(robot: Device, follower: Follower, stopped: threading.Event) -> Iterator[list[Beat]]:
    """What the follower makes of a robot's rows, as they come, until it is stopped.

    A connection that is lost is looked for again, with longer and longer waits; that is noted and counted. Between
    beats an empty list comes some hundred times a second, so that the caller can do other things.

    Args:
        robot: started.
        follower: takes the rows.
        stopped: ends it.
    """
    wait, next_try = _BACK_OFF[0], None
    while not stopped.is_set():
        if next_try is not None:
            if time.monotonic() < next_try:
                stopped.wait(0.02)
                yield []
                continue
            try:
                robot.start()
            except WireError:
                wait = min(2.0 * wait, _BACK_OFF[1])
                next_try = time.monotonic() + wait
                yield []
                continue
            follower.clock.counts.reconnects += 1
            follower.note("robot", "connected again")
            wait, next_try = _BACK_OFF[0], None
        try:
            rows = robot.rows()
        except WireError as error:
            follower.note("robot", str(error))
            next_try = time.monotonic() + wait
            continue
        yield [beat for row in rows if (beat := follower.take(row)) is not None]
