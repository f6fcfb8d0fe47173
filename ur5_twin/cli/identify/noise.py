"""The devices' noise. Heavy imports stay inside the commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ur5_twin.cli.common import command_line, read_all
from ur5_twin.cli.identify.options import Logs, Out, Repair
from ur5_twin.terminal import progress


def identify_noise(
    logs: Logs,
    out: Out = Path("out/noise"),
    sensors: Annotated[str, typer.Option(help="Simulated devices: a preset's name or a TOML.")] = "lab",
    seed: Annotated[int, typer.Option(min=0, help="Of the simulated noise.")] = 0,
    repair: Repair = False,
) -> None:
    """Measure your devices' noise, steps and clocks, beside the simulated devices' in the same motion."""
    from ur5_twin.identification.noise import measure
    from ur5_twin.sensing import load_sensors
    from ur5_twin.twin.retrace import retrace
    from ur5_twin.views.noise import write_noise

    recordings = read_all(logs, repair)
    suite = load_sensors(sensors)
    measured, simulated = [], []
    with progress("retrace", len(recordings)) as advance:
        for done, recording in enumerate(recordings, start=1):
            measured.append(measure(recording))
            simulated.append(measure(retrace(recording, suite, seed)))
            advance(done)
    print(write_noise(measured, simulated, out, command_line()))
    print(f"written to {out}: report.md, report.json, figures")
