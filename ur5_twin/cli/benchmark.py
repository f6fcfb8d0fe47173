"""``ur5-twin benchmark``: all estimators on many simulated contacts. Heavy imports stay inside the command."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from ur5_twin.cli.common import quiet_engine, writable
from ur5_twin.terminal import progress

EXAMPLES = """[bold]Examples[/bold]

ur5-twin benchmark

ur5-twin benchmark --suite full --jobs 8 --out out/full

ur5-twin benchmark --suite full --resume --out out/full   [dim]# after Ctrl-C or a power cut[/dim]

ur5-twin benchmark --estimator mine.py:MyObserver --estimator friction_kalman --out out/mine
"""


def _complete(incomplete: str) -> list[str]:
    from ur5_twin.estimation.registry import estimator_names

    return [name for name in estimator_names() if name.startswith(incomplete)]


def benchmark(
    suite: Annotated[str, typer.Option(help="quick, full, or the path of a TOML like models/suites.toml.")] = "quick",
    seeds: Annotated[
        int | None, typer.Option(min=1, help="How many arms and variations of each scenario. Default: the suite's.")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", min=1, help="Processes at once. Default: one for each core.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with what the output folder holds.")] = False,
    estimator: Annotated[
        list[str] | None,
        typer.Option(
            "--estimator",
            "-e",
            autocompletion=_complete,
            help="A name, or path/to/file.py:Class. Default: the suite's, which ship with all.",
        ),
    ] = None,
    lab: Annotated[
        Path | None,
        typer.Option(help="Folder of the lab's logs: compare the order of estimators with that on the real runs."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Output folder. Default: out/benchmark-<suite>.", callback=writable),
    ] = None,
) -> None:
    """Run estimators on simulated contacts with arms that differ from the one they know, and rank them.

    Writes leaderboard.json, .md and .html, and a file for each finished run. leaderboard.json is the same bit for bit
    for the same suite, whatever --jobs.
    """
    from ur5_twin.evaluation.benchmark import lab_logs, preparation, run
    from ur5_twin.evaluation.benchmark.executor import Processes, Serial
    from ur5_twin.evaluation.benchmark.suite import load_suite
    from ur5_twin.terminal import show_benchmark
    from ur5_twin.views.benchmark import write_benchmark

    quiet_engine()
    chosen = load_suite(suite).with_options(seeds, tuple(estimator or ()))
    logs = None if lab is None else lab_logs.read_logs(lab)
    folder = out if out is not None else Path("out") / f"benchmark-{chosen.name}"
    workers = jobs or os.cpu_count() or 1
    executor = Serial() if workers == 1 else Processes(workers, quiet_engine)
    with progress("identify the drives", preparation.STEPS) as prepared, progress("runs", None) as advance:
        finished = run.run(chosen, folder, executor, resume=resume, preparing=prepared, progress=advance)
    if logs is not None:
        with progress("real runs", len(logs)) as advance:
            finished.board["lab"] = lab_logs.compare(logs, chosen.estimators, finished, advance)
    write_benchmark(finished, folder)
    show_benchmark(finished.board, folder)
