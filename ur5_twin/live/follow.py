"""Each row of the robot through the twin and the estimators, in lockstep, as it comes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ur5_twin.control.held import Holding
from ur5_twin.errors import ReplayError, SimulationError, WireError
from ur5_twin.estimation.protocol import Estimate, Estimator, Sample
from ur5_twin.live.clock import Clock
from ur5_twin.live.ring import Ring
from ur5_twin.recording.journal import Journal
from ur5_twin.recording.table import COLUMN_WIDTHS
from ur5_twin.sources.device import Row
from ur5_twin.twin.lockstep import ServoTwin
from ur5_twin.twin.replay import ReplaySettings, closed_loop
from ur5_twin.twin.sample import Sample as TwinSample

#: Without these there is nothing to follow.
NEEDED = ("target_q", "target_qd", "target_qdd", "actual_q", "actual_qd", "actual_current")
#: What the twin adds to a row.
PREDICTED = {"sim_actual_q": 6, "sim_actual_qd": 6, "sim_moment": 6, "sim_actual_current": 6}
#: How long the last rows are kept in memory, s, at the fastest rate.
REMEMBERED = 120.0
_FASTEST = 0.002
#: Notes that are kept; a bad line must not fill the memory.
_NOTES = 500


@dataclass(frozen=True)
class Beat:
    """A row with what the twin and the estimators make of it.

    Attributes:
        time: s.
        host: when it came, POSIX, s.
        columns: the robot's, ``sim_*`` and ``est_*``.
        estimates: by estimator.
    """

    time: float
    host: float
    columns: Mapping[str, np.ndarray]
    estimates: Mapping[str, Estimate]


class Follower:
    """The twin in lockstep with a robot's rows.

    What it writes beside the robot's columns is what ``ur5-twin replay`` and ``estimate`` make of the same rows.

    Args:
        columns: of the robot's rows: name -> width.
        settings: of the twin, as of a servo replay.
        estimators: by name, new.
        journal: where all rows go; None for nowhere.

    Attributes:
        clock: with the counts.
        drawn: the arm with its tool.
        ring: the last two minutes or more.
        notes: (where, what) of what went wrong.

    Raises:
        WireError: the robot does not publish what a twin needs.
    """

    def __init__(
        self,
        columns: Mapping[str, int],
        settings: ReplaySettings,
        estimators: Mapping[str, Estimator],
        journal: Journal | None = None,
    ) -> None:
        missing = [name for name in NEEDED if name not in columns]
        if missing:
            raise WireError(f"the robot does not publish {', '.join(missing)}; the twin follows {', '.join(NEEDED)}")
        self.clock = Clock()
        self.drawn = settings.plant
        self.notes: list[tuple[str, str]] = []
        self._robot = dict(columns)
        self._settings, self._estimators = settings, dict(estimators)
        self._held = Holding()
        self._twin = ServoTwin(closed_loop(settings))
        self._journal = journal
        every = {**self._robot, **PREDICTED}
        for name in self._estimators:
            every |= {
                f"est_{name}_wrench": 6,
                f"est_{name}_tau_ext": 6,
                f"est_{name}_deviation": 6,
                f"est_{name}_contact": 1,
            }
        self.columns = every
        self.ring = Ring(every, round(REMEMBERED / _FASTEST))
        self._absent = {
            name: np.full(COLUMN_WIDTHS[name], np.nan) for name in Sample._fields[1:] if name not in self._robot
        }
        self._begun = False

    def take(self, row: Row) -> Beat | None:
        """The next row; None if it is not one to go by: repeated, or with a value that is no number."""
        if not np.isfinite(row.time) or not all(np.isfinite(values).all() for values in row.columns.values()):
            self.clock.counts.not_numbers += 1
            if self.clock.counts.not_numbers == 1:
                self.note("robot", "rows with a value that is no number are left out")
            return None
        time = self.clock.take(row.time, row.host)
        if self.clock.said is not None:
            self.note("robot", self.clock.said)
        if time is None:
            return None
        columns = dict(row.columns)
        columns |= self._predicted(time, columns)
        sample = Sample(time, *(columns.get(name, self._absent.get(name)) for name in Sample._fields[1:]))  # type: ignore[arg-type]
        estimates = {name: estimator.update(sample) for name, estimator in self._estimators.items()}
        for name, found in estimates.items():
            columns |= {
                f"est_{name}_wrench": found.wrench,
                f"est_{name}_tau_ext": found.tau_ext,
                f"est_{name}_deviation": np.sqrt(np.maximum(np.diag(found.covariance), 0.0)),
                f"est_{name}_contact": np.array([found.contact]),
            }
        self.ring.append(time, columns)
        if self._journal is not None:
            if not self._begun:
                # The host's clock at the robot's time 0.
                self._journal.begin("robot", self.columns, row.host - time)
                self._begun = True
            self._journal.append(
                "robot", np.array([time]), {name: np.atleast_2d(columns[name]) for name in self.columns}
            )
        return Beat(time, row.host, columns, estimates)

    def note(self, where: str, what: str) -> None:
        """Keep a finding."""
        if len(self.notes) < _NOTES:
            self.notes.append((where, what))
            if self._journal is not None:
                self._journal.note(where, what)

    def _predicted(self, time: float, columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        published = np.stack([columns["target_q"], columns["target_qd"], columns["target_qdd"]])
        target = self._held.update(published)
        sample = TwinSample(time, columns["actual_q"], columns["actual_qd"], target, None, columns["actual_current"])
        restarts = len(self._twin.restarts)
        try:
            said = self._twin.tick(sample)
        except (ReplayError, SimulationError) as error:
            self.note("twin", f"at {time:.3f} s: {error}; it begins again from the robot's state")
            self._twin = ServoTwin(closed_loop(self._settings))
            restarts = -1
            said = self._twin.tick(sample)
        unknown = np.full(6, np.nan)
        again = len(self._twin.restarts) != restarts
        return {
            "sim_actual_q": unknown if again else said.q,
            "sim_actual_qd": unknown if again else said.qd,
            "sim_moment": said.moment,
            "sim_actual_current": unknown if said.current is None else said.current,
        }


def warm_up(settings: ReplaySettings, estimators: Mapping[str, Estimator]) -> None:
    """Have everything compiled before the first row comes; the estimators are used up by it."""
    columns: dict[str, int] = dict.fromkeys((*NEEDED, "target_moment", "target_current"), 6)
    follower = Follower(columns, settings, estimators)
    q = np.array([0.1, -1.4, 1.3, -1.2, -1.5, 0.2])
    for k in range(5):
        row = {name: np.zeros(6) for name in columns} | {"target_q": q, "actual_q": q}
        follower.take(Row(100.0 + 0.008 * k, 100.0 + 0.008 * k, row))
