"""What several commands share. Heavy imports stay inside the functions."""

from __future__ import annotations

import os
import shlex
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ur5_twin.terminal import progress

if TYPE_CHECKING:
    from ur5_twin.recording.table import Recording
    from ur5_twin.twin.replay import ReplaySettings


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


def writable(path: Path | None) -> Path | None:
    """An output folder as it was given, if it is one or can be made: said before the work, not after it.

    Raises:
        typer.BadParameter: something on the way to it is a file, may not be written to, or is a log of the lab's.
    """
    if path is None:
        return None
    from ur5_twin.recording.lab_layout import holds_log

    there = next(folder for folder in (path, *path.parents, Path("/")) if folder.exists())
    if not there.is_dir():
        raise typer.BadParameter(f"{there} is a file; give a folder")
    for folder in (real := path.resolve(), *real.parents):
        if holds_log(folder):
            raise typer.BadParameter(f"{path} lies in a log, {folder.name}; give another folder, logs stay as they are")
    if not os.access(there, os.W_OK | os.X_OK):
        raise typer.BadParameter(f"{there} may not be written to; give another folder")
    return path


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


def replay_settings(
    model: str,
    plant: str | None,
    gains: str | None,
    joints: str | None,
    wrench: str,
    ft_delay: float | None,
    drive: str,
    target_current: Path | None,
    tool: str,
    payload: str,
    mode: str,
) -> ReplaySettings:
    """What a replay's options say; None where the default depends on other options."""
    from ur5_twin.arm.drive import drives_of, load_joint_drives
    from ur5_twin.arm.parameters import load_model
    from ur5_twin.control.gains import load_gains
    from ur5_twin.control.target_current import load_target_current_law
    from ur5_twin.drives.current_map import load_drive_map
    from ur5_twin.recording.force_sensor import FT_DELAY
    from ur5_twin.twin.replay import ReplaySettings

    if joints is None:
        joints = "plant" if wrench == "measured" else "none"
    rubs = joints != "none"
    if gains is None:
        gains = "servo" if rubs else "thesis_c"
    if plant is None:
        plant = "plant" if rubs else model
    simulated = load_model(plant, tool)
    return ReplaySettings(
        model=load_model(model, payload),
        plant=simulated,
        gains=load_gains(gains),
        drive=load_drive_map(drive),
        target_current=load_target_current_law(target_current),
        mode="shadow" if mode == "shadow" else "servo",
        joints=(drives_of(simulated) if joints == "plant" else load_joint_drives(joints)) if rubs else None,
        wrench="measured" if wrench == "measured" else "none",
        ft_delay=FT_DELAY if ft_delay is None else ft_delay,
    )


@contextmanager
def stop_signals() -> Iterator[threading.Event]:
    """An event that Ctrl-C and SIGTERM set instead of ending the process."""
    stop = threading.Event()
    before = {number: signal.signal(number, lambda *_: stop.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
