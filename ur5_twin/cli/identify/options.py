"""What the commands of ``ur5-twin identify`` share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ur5_twin.cli.common import writable

if TYPE_CHECKING:
    from ur5_twin.identification.results import Result

EXAMPLES = """[bold]Examples[/bold]

ur5-twin identify controller monday.csv tuesday.csv --out out/mine

ur5-twin replay wednesday.csv --model out/mine/controller.toml

ur5-twin identify drive monday.csv tuesday.csv wednesday.csv --out out/drive

ur5-twin replay thursday.csv --joints out/drive/joints.toml

ur5-twin identify servo pushed.csv monday.csv tuesday.csv --out out/servo

ur5-twin replay thursday.csv --gains out/servo/gains.toml

ur5-twin identify plant monday.csv tuesday.csv --tool ati_gamma --out out/plant

ur5-twin replay thursday.csv --plant out/plant/plant.toml --joints plant

ur5-twin identify payload loaded.csv --bare unloaded.csv --out out/payload

ur5-twin replay loaded.csv --tool out/payload/payload.toml

ur5-twin identify sensor monday.csv tuesday.csv --out out/sensor

ur5-twin run free_motion --sensors out/sensor/sensors.toml
"""

Logs = Annotated[list[Path], typer.Argument(help="Logs, as 'replay' takes them. More logs, more to check against.")]
Out = Annotated[Path, typer.Option("--out", "-o", help="Output folder.", callback=writable)]
Repair = Annotated[bool, typer.Option("--repair", help="Repair what is broken in a log and report it.")]


def write_result(result: Result, folder: Path, figures: Sequence[Path] = ()) -> None:
    """Write it, and say on stdout what was found and where it is."""
    from ur5_twin.identification.results import write

    tables = write(result, folder, figures)
    print(*(f"- {finding}" for finding in result.findings), sep="\n")
    if tables:
        print(f"\n{tables}\n")
    written = "".join(f"{file.name}, " for file in result.files)
    print(f"written to {folder}: {written}report.md, report.json")


def error_figure(result: Result, folder: Path) -> list[Path]:
    """The figure of the result's tables, if it has any."""
    from ur5_twin.views.identification import draw_errors

    return [draw_errors(result.tables, folder / "figures" / "errors.png")] if result.tables else []
