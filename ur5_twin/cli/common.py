"""What several commands share. Heavy imports stay inside the functions."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ur5_twin.terminal import progress

if TYPE_CHECKING:
    from ur5_twin.recording.table import Recording


def command_line() -> str:
    """The command line as it was given, for provenance."""
    return shlex.join(["ur5-twin", *sys.argv[1:]])


def read_all(logs: list[Path], repair: bool) -> list[Recording]:
    from ur5_twin.errors import IdentificationError
    from ur5_twin.recording import read

    twice = [str(path) for k, path in enumerate(logs) if path.resolve() in [other.resolve() for other in logs[:k]]]
    if twice:
        raise IdentificationError(f"{twice[0]} is given twice: a log cannot be checked against itself")
    recordings = []
    with progress("read", len(logs)) as advance:
        for done, path in enumerate(logs, start=1):
            recordings.append(read(shipped(path), repair=repair))
            advance(done)
    return recordings


def quiet_engine() -> None:
    """dm_control logs MuJoCo's warnings; a simulation that diverges is an error of ours, in one line."""
    from absl import logging

    logging.set_verbosity(logging.ERROR)


def shipped(path: Path) -> Path:
    """A log that ships, by name, where there is no such path."""
    if path.exists() or len(path.parts) != 1:
        return path
    from ur5_twin.resources import data_dir

    found = data_dir("replay") / path
    return found if found.is_dir() else path


def complete_models(incomplete: str) -> list[str]:
    from ur5_twin.arm.parameters import model_names

    return [name for name in model_names() if name.startswith(incomplete)]


def complete_gains(incomplete: str) -> list[str]:
    from ur5_twin.control.gains import gain_names

    return [name for name in gain_names() if name.startswith(incomplete)]


def complete_tools(incomplete: str) -> list[str]:
    from ur5_twin.arm.parameters import tool_names

    return [name for name in tool_names() if name.startswith(incomplete)]
