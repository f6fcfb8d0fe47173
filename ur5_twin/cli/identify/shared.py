"""What the commands of ``ur5-twin identify`` share. Heavy imports stay inside the functions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ur5_twin.identification.results import Result

Logs = Annotated[list[Path], typer.Argument(help="Logs, as 'replay' takes them. More logs, more to check against.")]
Repair = Annotated[bool, typer.Option("--repair", help="Repair what is broken in a log and report it.")]


def report(result: Result, folder: Path, figures: Sequence[Path] = ()) -> None:
    """Write it, and say on stdout what was found and where it is."""
    from ur5_twin.identification.results import write

    tables = write(result, folder, figures)
    print(*(f"- {finding}" for finding in result.findings), sep="\n")
    if tables:
        print(f"\n{tables}\n")
    print(f"written to {folder}: {', '.join(file.name for file in result.files)}, report.md, report.json")


def error_figures(result: Result, folder: Path) -> list[Path]:
    """The figure of the result's tables, if it has any."""
    from ur5_twin.views.identification import draw_errors

    return [draw_errors(result.tables, folder / "figures" / "errors.png")] if result.tables else []
