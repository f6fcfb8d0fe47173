"""What is drawn, under which name, in which unit and colour: one answer for the figures and for the viewer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ur5_twin.recording.table import Table

#: The roles' colours, told apart by the colour-blind and readable on white paper and on the viewer's black.
MEASURED = "#2a86d1"
TARGET = "#8a8f98"
TWIN = "#ec7014"
#: A second thing the twin says of the same quantity.
TWIN_TOO = "#b05cc6"
#: The force sensor: seen against the measured arm.
SENSOR = "#cda300"
TRUTH = "#1ba36b"
#: A second truth beside it: friction, and pushes beside contacts.
TRUTH_TOO = "#d4526e"
#: Pairs of a link and an obstacle, and pushes on links, in the order in which they are met.
CONTACTS = (TRUTH, "#7fb800", "#0f9aa8", "#b3c95a", "#5f8a5b")
PUSHES = (TRUTH_TOO, "#f08a5d", "#9c4f96")
#: From a protective stop on.
STOPPED = "#c62f2f"
#: Estimators, in the order in which they are met.
ESTIMATES = (TWIN, TWIN_TOO, "#d4526e", "#7a5c3e")

#: Below this a force is noise, model error or the weight of a cable, N; no arrow is drawn.
LEAST_FORCE = 3.0


@dataclass(frozen=True)
class Series:
    """One line of a plot: a column of the robot table.

    Attributes:
        column: RTDE's name, ``sim_`` before it if the twin says so.
        label: the legend's word for it.
        colour: ``#rrggbb``.
    """

    column: str
    label: str
    colour: str


@dataclass(frozen=True)
class Difference:
    """The line ``of - minus`` of two columns; ``label`` and ``colour`` as in ``Series``."""

    of: str
    minus: str
    label: str
    colour: str


@dataclass(frozen=True)
class Quantity:
    """One page of plots, a row per joint.

    Attributes:
        key: name of the figure's file; the words in it, of the viewer's tab.
        title: what it is.
        unit: of the series, which are drawn as recorded.
        series: lines of the signal; only those whose column is there are drawn.
        differences: lines of the error.
        error_title: what the differences are.
        error_unit, error_scale: a difference times ``error_scale`` is in ``error_unit``.
        noisy: the measured line is a band; where it is not, it is drawn broad, so that a twin on top of it shows both.
    """

    key: str
    title: str
    unit: str
    series: tuple[Series, ...]
    differences: tuple[Difference, ...]
    error_title: str
    error_unit: str
    error_scale: float = 1.0
    noisy: bool = False

    def series_in(self, table: Table) -> list[Series]:
        """The series that the table holds, in drawing order."""
        return [item for item in self.series if has(table, item.column)]

    def differences_in(self, table: Table) -> list[Difference]:
        """The differences that the table allows, the twin's first."""
        return [item for item in self.differences if has(table, item.of) and has(table, item.minus)]

    def error(self, difference: Difference, table: Table) -> np.ndarray:
        """(n, width) a difference in ``error_unit``; NaN where one of its columns is."""
        return (table[difference.of] - table[difference.minus]) * self.error_scale

    def error_name(self, difference: Difference) -> str:
        """Name of a difference in ``error_unit`` as a column, with the unit in it."""
        return f"{difference.of}_minus_{difference.minus}_{self.error_unit.replace('/', '_')}"


QUANTITIES = (
    Quantity(
        "position",
        "Joint position",
        "rad",
        (
            Series("actual_q", "measured", MEASURED),
            Series("target_q", "target", TARGET),
            Series("sim_actual_q", "twin", TWIN),
            Series("truth_q", "truth", TRUTH),
        ),
        (
            Difference("actual_q", "sim_actual_q", "measured - twin", TWIN),
            Difference("truth_q", "target_q", "truth - target", TRUTH),
            Difference("actual_q", "target_q", "measured - target", TARGET),
        ),
        "Position error",
        "mrad",
        1e3,
    ),
    Quantity(
        "velocity",
        "Joint velocity",
        "rad/s",
        (
            Series("actual_qd", "measured", MEASURED),
            Series("target_qd", "target", TARGET),
            Series("sim_actual_qd", "twin", TWIN),
            Series("truth_qd", "truth", TRUTH),
        ),
        (
            Difference("actual_qd", "sim_actual_qd", "measured - twin", TWIN),
            Difference("truth_qd", "target_qd", "truth - target", TRUTH),
            Difference("actual_qd", "target_qd", "measured - target", TARGET),
        ),
        "Velocity error",
        "mrad/s",
        1e3,
    ),
    Quantity(
        "torque",
        "Joint torque",
        "Nm",
        (
            Series("target_moment", "controller", MEASURED),
            Series("sim_moment", "twin's motors", TWIN_TOO),
            Series("sim_target_moment", "twin, for the target motion", TWIN),
            Series("truth_moment", "truth: motors", TRUTH),
            Series("truth_friction", "truth: friction", TRUTH_TOO),
        ),
        (
            Difference("target_moment", "sim_target_moment", "controller - twin, for the target motion", TWIN),
            Difference("target_moment", "sim_moment", "controller - twin's motors", TWIN_TOO),
            Difference("target_moment", "truth_moment", "controller - true motors", TRUTH),
        ),
        "Torque residual",
        "Nm",
    ),
    Quantity(
        "current",
        "Motor current",
        "A",
        (
            Series("actual_current", "measured", MEASURED),
            Series("target_current", "controller's target", TARGET),
            Series("sim_actual_current", "twin", TWIN),
            Series("sim_target_current", "twin's target", TWIN_TOO),
        ),
        (
            Difference("actual_current", "sim_actual_current", "measured - twin", TWIN),
            Difference("actual_current", "target_current", "measured - target", TARGET),
            Difference("target_current", "sim_target_current", "target - twin's target", TWIN_TOO),
        ),
        "Current residual",
        "A",
        noisy=True,
    ),
    Quantity(
        "external_torque",
        "External joint torque by contacts and pushes",
        "Nm",
        (Series("truth_tau_ext", "truth", TRUTH),),
        (),
        "External torque residual",
        "Nm",
    ),
)


def has(table: Table, column: str) -> bool:
    """Whether a column is there and holds at least one number."""
    return column in table and bool(np.isfinite(table[column]).any())


def rgb(colour: str) -> tuple[int, int, int]:
    """``#rrggbb`` as three numbers from 0 to 255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
