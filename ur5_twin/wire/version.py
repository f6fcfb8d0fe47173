"""Versions of the controller's software: what differs between them on the wire."""

from __future__ import annotations

from dataclasses import dataclass

from ur5_twin.errors import WireError

#: Sizes of the real-time interface's packets in bytes, from the version (major, minor) on.
_REALTIME_SIZES = (
    ((1, 0), 756),
    ((1, 7), 764),
    ((1, 8), 812),
    ((3, 0), 1044),
    ((3, 2), 1060),
    ((3, 5), 1108),
    ((3, 10), 1116),
    ((3, 14), 1140),
    ((5, 0), 1108),
    ((5, 4), 1116),
    ((5, 9), 1140),
    ((5, 10), 1220),
)
#: A version that stands for a series: the thesis' robot, and the last of each that was tried with clients.
_SERIES = {"1.x": (1, 8, 0, 0), "3.x": (3, 15, 8, 0), "5.x": (5, 25, 1, 0)}
_MAJORS = (1, 3, 5)


@dataclass(frozen=True)
class Version:
    """A version of the controller's software.

    Attributes:
        major, minor, bugfix, build: 1 and 3 are the CB series, 5 the e-Series.
    """

    major: int
    minor: int
    bugfix: int = 0
    build: int = 0

    @property
    def period(self) -> float:
        """The controller's tick, s: 8 ms, with the e-Series 2 ms."""
        return 0.002 if self.major >= 5 else 0.008

    @property
    def realtime_size(self) -> int:
        """Bytes of a packet of the real-time interface."""
        return [size for since, size in _REALTIME_SIZES if since <= (self.major, self.minor)][-1]

    @property
    def has_rtde(self) -> bool:
        """Whether there is an RTDE port: since 3.3."""
        return (self.major, self.minor) >= (3, 3)

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.bugfix}"


def version(text: str) -> Version:
    """The version that ``1.6``, ``3.15.8``, ``5.x`` names.

    Raises:
        WireError: it names none.
    """
    if text in _SERIES:
        return Version(*_SERIES[text])
    parts = text.split(".")
    if not 2 <= len(parts) <= 4 or not all(part.isascii() and part.isdigit() for part in parts):
        raise WireError(f"'{text}' is no version of the controller's software: 1.6, 1.8, 3.x, 5.x or such as 3.15.8")
    found = Version(*map(int, parts))
    if found.major not in _MAJORS:
        raise WireError(f"there is no version {text}: the CB series has 1.x and 3.x, the e-Series 5.x")
    return found
