"""Keys: what makes a result what it is, in one number. Where anything of it changes, the key does."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from pathlib import Path

import ur5_twin
from ur5_twin.evaluation.reporting import versions
from ur5_twin.resources import data_dir

#: What shows results and makes none.
_SHOWING = frozenset({"views", "cli", "terminal.py"})


def digest(content: object) -> str:
    """Of plain data, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, allow_nan=False).encode()).hexdigest()


def of_file(path: Path) -> str:
    """Of a file's content."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


@cache
def source_digest() -> str:
    """Of this package's code and models, and the versions of the libraries that shape the numbers."""
    package = Path(ur5_twin.__file__).parent
    kept = [path for path in package.rglob("*.py") if _SHOWING.isdisjoint(path.relative_to(package).parts)]
    # A suite chooses tasks and does not change them.
    models = [path for path in data_dir("models").glob("*.toml") if path.name != "suites.toml"]
    found = {str(path.relative_to(package.parent)): of_file(path) for path in kept}
    return digest([found, {path.name: of_file(path) for path in models}, versions()])
