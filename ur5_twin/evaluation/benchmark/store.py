"""What is done: a file for each finished task, whole or not there at all."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ur5_twin.atomic import write_text
from ur5_twin.evaluation.reporting import render_json


class Store:
    """Records of finished tasks by key, in ``tasks/<key>.json`` of a folder.

    Args:
        folder: of the benchmark.
    """

    def __init__(self, folder: Path) -> None:
        self._home = folder / "tasks"

    def __len__(self) -> int:
        return len(list(self._home.glob("*.json")))

    def done(self, keys: Iterable[str]) -> set[str]:
        """Those of the keys whose task is finished."""
        return {key for key in keys if self._path(key).is_file()}

    def read(self, key: str) -> dict[str, Any]:
        return json.loads(self._path(key).read_text(encoding="utf-8"))

    def write(self, key: str, record: dict[str, Any]) -> None:
        write_text(self._path(key), render_json(record))

    def _path(self, key: str) -> Path:
        return self._home / f"{key}.json"
