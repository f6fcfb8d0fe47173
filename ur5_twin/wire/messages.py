"""What the controller shows to whom it may concern: lines of programs, popups, errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ur5_twin.wire.controller import VirtualController


@dataclass(frozen=True)
class Message:
    """Something that the controller shows.

    Attributes:
        kind: ``text``, ``popup`` or ``error``.
        text: what.
        timestamp: the controller's clock, s.
        number: counts all messages.
    """

    kind: str
    text: str
    timestamp: float
    number: int


class News:
    """What the controller has said since it was last asked, for a port that forwards it.

    What was said before the port began is old.

    Args:
        controller: whose messages.
    """

    def __init__(self, controller: VirtualController) -> None:
        self._controller = controller
        self._told = self._newest()

    def fresh(self) -> list[Message]:
        """The messages that nobody has asked for yet, as far as they are still kept."""
        newest = self._newest()
        if newest == self._told:
            return []
        # A copy: the tick thread goes on writing.
        found = [message for message in list(self._controller.messages) if self._told < message.number <= newest]
        self._told = newest
        return found

    def _newest(self) -> int:
        """The number of the newest message; -1 before the first."""
        try:
            return self._controller.messages[-1].number
        except IndexError:
            return -1
