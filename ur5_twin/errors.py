"""The project's exceptions.

A message names what was wrong, where (file, row or field), and what would be right. The command line prints it
on one line and exits with 2; nothing else of ours reaches the user as a traceback.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class TwinError(Exception):
    """Base of every error this package raises on purpose."""


class ModelError(TwinError):
    """A parameter file or a request for a model is wrong (unknown name, unknown key, impossible value)."""


class RecordingError(TwinError):
    """A log cannot be read or written as asked; the message names the file and, where there is one, the row."""


class ReplayError(TwinError):
    """A recording was read but cannot be replayed as asked (a needed column is missing, the twin diverged)."""


class SimulationError(TwinError):
    """The simulated cell cannot go on: the message says when and why, what came before is kept."""


class ScenarioError(TwinError):
    """A scenario file is wrong or asks for what no arm can do; the message names the key."""


class IdentificationError(TwinError):
    """The recordings cannot carry the fit that was asked for; the message says what they lack."""


class EstimationError(TwinError):
    """An estimator cannot be had, or a recording lacks what it needs; the message says what."""


class BenchmarkError(TwinError):
    """A benchmark cannot run as asked: a suite or its folder is wrong; the message says what would be right."""


class WireError(TwinError):
    """The virtual controller's ports, or a connection to a robot or sensor: what was asked for cannot be had."""


class ScriptError(WireError):
    """A URScript program is wrong or asks for what cannot be; the message names the line."""


class FetchError(TwinError):
    """Public logs could not be fetched or their checksums differ."""


class MissingExtraError(TwinError):
    """An optional part of the package is not installed; the message gives the pip command that installs it."""

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(f"{what} needs the extra '{extra}': pip install 'ur5-twin[{extra}]'")


def unknown(kind: str, name: str, known: Iterable[str]) -> str:
    """Say that ``name`` is not a known ``kind``, what is, and what may have been meant."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else ""
    return f"unknown {kind} '{name}'{hint} (known: {', '.join(names)})"
