"""A scenario from beginning to end: plan, simulate, measure, and keep what came before it went wrong."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ur5_twin.control.program import Reference, plan
from ur5_twin.recording.table import Recording
from ur5_twin.scenario.program import program_of
from ur5_twin.scenario.scenario import Scenario
from ur5_twin.sensing import load_sensors
from ur5_twin.twin import _loop_kernel as kernel
from ur5_twin.twin.cell import PERIOD, Cell, concatenate
from ur5_twin.twin.setup import setup_of
from ur5_twin.twin.telemetry import Telemetry

#: After a protective stop a run goes on for as long, s: the arm brakes, holds, and may yet be pushed away.
_AFTER_STOP = 1.0
#: Ticks at once, four seconds of the robot: the devices' fixed cost per piece is then small beside the physics.
_CHUNK = 500


class ScenarioRun:
    """One run of a scenario.

    Args:
        scenario: what happens.
        seed: of the sensors' noise; the scenario's own if not given. The motion does not depend on it.
        keep_trace: keep the truth at every physics step (``trace``), not only at ticks.

    Attributes:
        setup: what the cell is made of.
        reference: the planned motion, with what was executed and what ignored.
        cell: the cell, at the tick that the run has come to.

    Raises:
        TwinError: the scenario asks for what cannot be: a motion out of reach, a start inside something.
    """

    def __init__(self, scenario: Scenario, seed: int | None = None, *, keep_trace: bool = False) -> None:
        self.scenario = scenario
        self.seed = scenario.seed if seed is None else seed
        self.setup = setup_of(scenario)
        self.reference: Reference = plan(self.setup.controller, scenario.q_start, program_of(scenario), period=PERIOD)
        self._rows = self._lasting(self.reference.rows)
        self.cell = Cell(self.setup)
        suite = load_sensors(scenario.sensors.preset, late_packages=scenario.sensors.late_packages)
        self._telemetry = Telemetry(self.setup, self.cell.geoms, suite, np.random.default_rng(self.seed))
        self._kept: list[kernel.Trace] | None = [] if keep_trace else None

    def __len__(self) -> int:
        """Ticks of the whole run, if nothing ends it before."""
        return len(self._rows) - 1

    @property
    def over(self) -> bool:
        """Whether it has come to its end, planned or not."""
        return self.cell.failure is not None or self.cell.tick >= self._end()

    def advance(self) -> None:
        """Go on by some seconds of the robot's time."""
        first = self.cell.tick
        # Tick k goes from row k to row k + 1.
        rows = self._rows[first + 1 : min(first + _CHUNK, self._end()) + 1]
        for piece in self.cell.advance(rows, to_stop=True):
            self._telemetry.observe(piece)
            if self._kept is not None:
                self._kept.append(piece.trace)

    def finish(self, progress: Callable[[int], object] | None = None) -> Recording:
        """Go on to the end; ``progress`` is called with the number of ticks done."""
        while not self.over:
            self.advance()
            if progress is not None:
                progress(self.cell.tick)
        return self.recording()

    def recording(self) -> Recording:
        """What the devices have reported so far, with the truth."""
        return self._telemetry.recording(self.scenario.name)

    def trace(self) -> kernel.Trace:
        """The truth at every physics step so far, of a run made with ``keep_trace``."""
        assert self._kept, "made without keep_trace, or not begun"
        return concatenate(self._kept)

    def _lasting(self, rows: np.ndarray) -> np.ndarray:
        """The planned rows, held as long as the scenario lasts or cut there, and the row that the last tick goes to."""
        scenario = self.scenario
        seconds = scenario.duration
        if seconds is None:
            planned = (len(rows) - 1) * PERIOD
            seconds = max(planned, scenario.last_event()) + scenario.settle
        ticks = max(2, round(seconds / PERIOD))
        still = np.stack([rows[-1, 0], np.zeros(6), np.zeros(6)])
        return np.concatenate([rows[: ticks + 1], np.tile(still, (max(0, ticks + 1 - len(rows)), 1, 1))])

    def _end(self) -> int:
        if self.cell.stop_tick is None:
            return len(self)
        return min(len(self), self.cell.stop_tick + round(_AFTER_STOP / PERIOD))
