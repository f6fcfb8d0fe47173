"""Draw the pictures of ``docs/drive.md``.

python docs/pictures/render_drive.py lab_logs/kufieta2014
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from ur5_twin.arm.parameters import load_model
from ur5_twin.drives import terms
from ur5_twin.identification import drive
from ur5_twin.recording import read
from ur5_twin.views.style import MEASURED, TWIN

_FREE = (
    "No3_Acc",
    "No4_Acc",
    "No5_Acc_slow_no_disturbance",
    "No6_Acc_slow_Verify_Model",
    "No9_Singularity_Free_NoDist",
)
_SHOWN = 2
_ORDER = 404
#: Speeds of the folded picture: the phase turns little between them, rad/s.
_SLOW = (0.03, 0.2)


def main() -> None:
    """Write drive_ripple.png and drive_amplitude.png."""
    parser = argparse.ArgumentParser(description="Draw the pictures of docs/drive.md.")
    parser.add_argument("logs", type=Path, help="a folder with one folder per movement")
    parser.add_argument("--folder", type=Path, default=Path(__file__).parent, help="where to write")
    options = parser.parse_args()
    model = load_model("plant", "xsens_mti")
    rides = [terms.ride(read(options.logs / f"Movement_{n}", repair=True), model) for n in _FREE]
    _ripple(rides, options.folder / "drive_ripple.png")
    _amplitude(rides, options.folder / "drive_amplitude.png")


def _ripple(rides: list[terms.Ride], path: Path) -> None:
    """Residual current of an unseen log against the angle, folded to one period of the ripple."""
    unseen, rest = rides[_SHOWN], [r for k, r in enumerate(rides) if k != _SHOWN]
    smooth = [candidate._replace(shape=candidate.shape._replace(orders=())) for candidate in drive.FREE]
    figure, axes = plt.subplots(2, 3, figsize=(11, 5), sharex=True, sharey="col", layout="constrained")
    for row, shapes, title, colour in (
        (0, smooth, "friction alone", MEASURED),
        (1, drive.FREE, "and ripple", TWIN),
    ):
        left = unseen.current - drive.fit_drive(rest, shapes).current(unseen)
        for column, j in enumerate((3, 4, 5)):
            speed = np.abs(unseen.qd[:, j])
            rows = (speed > _SLOW[0]) & (speed < _SLOW[1])
            turn = np.mod(_ORDER * unseen.angle[rows, j], 2.0 * np.pi) / (2.0 * np.pi)
            axes[row, column].plot(turn, left[rows, j], ".", markersize=3, color=colour)
            axes[row, column].set_title(f"joint {j + 1}, {title}", fontsize=10)
            axes[row, column].grid(alpha=0.3)
    for axis in axes[1]:
        axis.set_xlabel("angle, periods of 1/404 revolution")
    for axis in axes[:, 0]:
        axis.set_ylabel("residual current A")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _amplitude(rides: list[terms.Ride], path: Path) -> None:
    """Amplitude of the ripple over speed, of the order that each joint shows most."""
    smooth = [candidate._replace(shape=candidate.shape._replace(orders=())) for candidate in drive.FREE]
    fit = drive.fit_drive(rides, smooth)
    rests = [of.current - fit.current(of) for of in rides]
    edges = np.array([0.03, 0.06, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0, 1.2])
    figure, axes = plt.subplots(1, 2, figsize=(11, 3.6), layout="constrained")
    for j in range(6):
        order = 202 if j < 3 else _ORDER
        heights = []
        for low, high in itertools.pairwise(edges):
            size, weight = 0.0, 0
            for of, rest in zip(rides, rests, strict=True):
                for sign in (1.0, -1.0):
                    m = (sign * of.qd[:, j] > low) & (sign * of.qd[:, j] < high)
                    if m.sum() > 60:
                        wave = np.exp(-1j * order * of.angle[m, j])
                        size += m.sum() * abs(2.0 * np.mean(wave * (rest[m, j] - rest[m, j].mean())))
                        weight += int(m.sum())
            heights.append(size / weight if weight else np.nan)
        axes[int(j > 2)].plot(0.5 * (edges[:-1] + edges[1:]), heights, ".-", label=f"joint {j + 1}")
    for axis, order in zip(axes, (202, _ORDER), strict=True):
        axis.set_title(f"order {order}", fontsize=10)
        axis.set_xlabel("speed rad/s")
        axis.set_ylim(bottom=0.0)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    axes[0].set_ylabel("amplitude of the current A")
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main()
