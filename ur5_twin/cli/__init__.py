"""The command line: ``app`` is ur5-twin, ``identify`` its group of that name."""

from ur5_twin.cli.app import app, main

__all__ = ["app", "main"]
