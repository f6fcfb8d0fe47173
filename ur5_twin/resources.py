"""Where the data that ships with the package lies: inside the wheel, or at the top of a source tree."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from ur5_twin.errors import TwinError


def data_dir(kind: Literal["models", "scenarios", "replay"]) -> Path:
    """The folder of shipped models, scenarios or replay data.

    Raises:
        TwinError: the installation carries no such folder.
    """
    package = Path(__file__).resolve().parent
    for folder in (package / "_data" / kind, package.parent / kind):
        if folder.is_dir():
            return folder
    raise TwinError(f"this installation has no '{kind}' folder: reinstall ur5-twin")
