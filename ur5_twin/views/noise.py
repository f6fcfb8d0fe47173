"""The noise of logs beside that of the simulated devices: tables and spectra."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ur5_twin.arm.parameters import JOINT_NAMES
from ur5_twin.atomic import write_text
from ur5_twin.evaluation.reporting import short_number, versions
from ur5_twin.evaluation.tables import markdown
from ur5_twin.identification.noise import Noise, rows
from ur5_twin.spatial import WRENCH_AXES
from ur5_twin.views import paper
from ur5_twin.views.style import MEASURED, TWIN

_SIZE = (13.0, 7.0)
_AXES = {
    "actual_current": (JOINT_NAMES, "A^2/Hz"),
    "ft_wrench": (WRENCH_AXES, "N^2/Hz, Nm^2/Hz"),
    "imu_acc": (("x", "y", "z"), "(m/s^2)^2/Hz"),
    "imu_gyro": (("x", "y", "z"), "(rad/s)^2/Hz"),
}
_TITLES = {
    ("actual_current", "moving"): "Motor currents in motion",
    ("actual_current", "still"): "Motor currents at rest",
    ("ft_wrench", "still"): "Force sensor at rest",
    ("imu_acc", "still"): "Accelerometer at rest",
    ("imu_gyro", "still"): "Gyroscope at rest",
}


def write_noise(measured: Sequence[Noise], simulated: Sequence[Noise], folder: Path, command: str) -> str:
    """Write ``report.md``, ``report.json`` and ``figures/*.png``; returns the tables as Markdown."""
    drawn = [draw_spectra(measured, simulated, name, phase, folder / "figures") for name, phase in _TITLES]
    tables = _tables(measured, simulated)
    lines = ["# Noise of the devices", "", f"Command: `{command}`", "", tables]
    lines += ["", *(f"![{path.stem}](figures/{path.name})" for path in drawn if path is not None), ""]
    data = {
        "logs": [noise.source for noise in measured],
        "noise": [
            {"signal": name, "what": what, "unit": unit, "measured": _known(real), "simulated": _known(twin)}
            for name, what, unit, real, twin in rows(measured, simulated)
        ],
        "clocks": {
            who: {device: vars(clock) for noise in noises for device, clock in noise.clocks.items()}
            for who, noises in (("measured", measured), ("simulated", simulated))
        },
        "versions": versions(),
    }
    write_text(folder / "report.md", "\n".join(lines))
    write_text(folder / "report.json", json.dumps(data, indent=2, allow_nan=False) + "\n")
    return tables


def draw_spectra(
    measured: Sequence[Noise], simulated: Sequence[Noise], name: str, phase: str, folder: Path
) -> Path | None:
    """Power spectra of what is left of a signal beside a smooth curve, one panel an axis, as a PNG."""
    parts, unit = _AXES[name]
    lines = [_spectra(noises, name, phase) for noises in (measured, simulated)]
    if any(not spectra for spectra in lines):
        return None
    figure = paper.new_figure(*_SIZE, f"{_TITLES[name, phase]}: noise by frequency, {unit}")
    axes = paper.panels(figure, 3 if len(parts) == 6 else 1, 2 if len(parts) == 6 else 3)
    for i, part in enumerate(parts):
        panel = axes[i % 3, i // 3] if len(parts) == 6 else axes[0, i]
        paper.name(panel, part)
        for spectra, colour, label, width in zip(lines, (MEASURED, TWIN), ("lab", "twin"), (2.6, 1.3), strict=True):
            for k, (frequency, spectrum) in enumerate(spectra):
                panel.semilogy(
                    frequency[2:], spectrum[2:, i], color=colour, linewidth=width, alpha=0.8, label="" if k else label
                )
        panel.set_xlabel("Hz", fontsize=8)
    _legend(figure)
    return paper.save(figure, folder / f"{name}_{phase}.png")


def _legend(figure: Figure) -> None:
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper right", ncols=2, frameon=False, fontsize=9)


def _spectra(noises: Sequence[Noise], name: str, phase: str) -> list[tuple[np.ndarray, np.ndarray]]:
    found = []
    for noise in noises:
        if name in noise.signals:
            spectrum = getattr(noise.signals[name], f"spectrum_{phase}")
            if np.isfinite(spectrum).any():
                found.append((noise.signals[name].frequency, spectrum))
    return found


def _tables(measured: Sequence[Noise], simulated: Sequence[Noise]) -> str:
    body = []
    for name, what, unit, real, twin in rows(measured, simulated):
        for who, values in (("lab", real), ("twin", twin)):
            shown = [short_number(value) for value in values] + [""] * (6 - len(values))
            body.append((name, what, unit, who, *shown))
    head = ("signal", "noise", "unit", "of", *(str(i) for i in range(1, 7)))
    clocks = [
        (
            device,
            who,
            f"{clock.rate:.2f}",
            f"{clock.jitter * 1e3:.3f}",
            "-" if clock.repeated is None else f"{clock.repeated:.3f}",
        )
        for device in ("robot", "ft", "imu")
        for who, noises in (("lab", measured), ("twin", simulated))
        for clock in [next((noise.clocks[device] for noise in noises if device in noise.clocks), None)]
        if clock is not None
    ]
    return "\n\n".join(
        [
            markdown(head, body, words=4),
            markdown(("device", "of", "rows a second", "interval's spread, ms", "repeated at rest"), clocks, words=2),
        ]
    )


def _known(values: list[float]) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in values]
