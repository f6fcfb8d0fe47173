"""The cell as a ``dm_env`` environment: somebody else's loop drives the arm, tick by tick.

    from ur5_twin.twin.environment import CellEnvironment

    environment = CellEnvironment("press_plate")
    step = environment.reset()
    while not step.last():
        step = environment.step(step.observation["target_q"] + 1e-4)

An action is the next target_q, as servoj takes it: the servo goes there within the tick. As with the real robot, what
comes back was measured when the command was sent, so an action shows in the observation after next.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import dm_env
import numpy as np
from dm_env import specs

from ur5_twin.errors import SimulationError
from ur5_twin.recording.table import Recording
from ur5_twin.scenario import Scenario, load_scenario
from ur5_twin.sensing import load_sensors
from ur5_twin.twin.cell import PERIOD, Cell
from ur5_twin.twin.setup import setup_of
from ur5_twin.twin.telemetry import Telemetry

Observation = Mapping[str, np.ndarray]
_NEWEST = {"ft": ("ft_wrench",), "imu": ("imu_acc", "imu_gyro", "imu_mag")}


class CellEnvironment(dm_env.Environment):
    """A scenario's cell without its motion: obstacles, pushes, payloads, mismatch and sensors are the scenario's.

    Args:
        scenario: or its name or path.
        seed: of the sensors' noise in the first episode, the next one's is drawn from it; the scenario's if not given.
        duration: of an episode, s; the scenario's own, or 60 s if it has none.
        reward: of an observation; none is given if there is no such function.
        truth: whether the observations hold ``truth_*`` columns, which no robot publishes.

    Observations hold RTDE's columns of the robot (6,), the newest reading of each sensor that the arm carries (NaN
    before its first), and ``time`` () in s. An episode ends after its duration, or, with a discount of 0, with a
    protective stop or when the simulation cannot go on; ``why`` then says why.
    """

    def __init__(
        self,
        scenario: Scenario | str | Path,
        *,
        seed: int | None = None,
        duration: float | None = None,
        reward: Callable[[Observation], float] | None = None,
        truth: bool = True,
    ) -> None:
        self._scenario = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
        self._setup = setup_of(self._scenario)
        self._cell = Cell(self._setup)
        self._reward = reward
        self._truth = truth
        self._seeds = np.random.default_rng(self._scenario.seed if seed is None else seed)
        seconds = duration or self._scenario.duration or 60.0
        self._ticks = round(seconds / PERIOD)
        self._fastest = self._setup.controller.limits.qd * PERIOD
        self._over = True
        self._newest: dict[str, np.ndarray] = {}
        self._observation_spec = {
            name: specs.Array(value.shape, value.dtype, name) for name, value in self.reset().observation.items()
        }
        self._over = True

    @property
    def why(self) -> str | None:
        """Why the episode ended before its time; None if it did not."""
        return self._cell.failure or self._cell.stop_reason

    def reset(self) -> dm_env.TimeStep:
        """Begin an episode: the arm at the scenario's start, at rest."""
        self._cell.reset()
        suite = load_sensors(self._scenario.sensors.preset, late_packages=False)
        rng = np.random.default_rng(self._seeds.integers(2**63))
        self._telemetry = Telemetry(self._setup, self._cell.geoms, suite, rng)
        self._newest = {}
        self._over = False
        return dm_env.restart(self._tick(self._cell.target[0]))

    def step(self, action: np.ndarray) -> dm_env.TimeStep:
        """Send target_q (6,) in rad for the next tick.

        What is further away than the joints' speed allows is cut to it.

        Raises:
            SimulationError: the action is not six finite numbers.
        """
        if self._over:
            return self.reset()
        try:
            target = np.asarray(action, dtype=float)
        except (TypeError, ValueError):
            target = np.empty(0)
        if target.shape != (6,) or not np.isfinite(target).all():
            raise SimulationError(f"an action is target_q, six finite numbers in rad, not {action!r}")
        observation = self._tick(target)
        reward = 0.0 if self._reward is None else float(self._reward(observation))
        if self.why is not None:
            self._over = True
            return dm_env.termination(reward, observation)
        if self._cell.tick >= self._ticks:
            self._over = True
            return dm_env.truncation(reward, observation)
        return dm_env.transition(reward, observation)

    def action_spec(self) -> specs.BoundedArray:
        """target_q (6,) in rad."""
        limit = self._setup.controller.limits.q
        return specs.BoundedArray((6,), float, -limit, limit, "target_q")

    def observation_spec(self) -> Mapping[str, specs.Array]:
        """What observations hold."""
        return self._observation_spec

    def recording(self) -> Recording:
        """The episode so far as a recording, with all that its sensors read."""
        return self._telemetry.recording(self._scenario.name)

    def _tick(self, target: np.ndarray) -> dict[str, np.ndarray]:
        q, qd, _ = self._cell.target
        step = np.clip(target - q, -self._fastest, self._fastest)
        speed = step / PERIOD
        row = np.stack([q + step, speed, (speed - qd) / PERIOD])
        pieces = self._cell.advance(row[None])
        if not pieces:  # stopped at this very tick: the arm brakes, or nothing goes on
            return self._last_observation
        reported = self._telemetry.observe(pieces[-1])
        observation = {name: values[-1] for name, values in reported["robot"].items()}
        for device, columns in _NEWEST.items():
            for name in columns if device in reported else ():
                readings = reported[device][name]
                self._newest.setdefault(name, np.full(readings.shape[1], np.nan))
                if len(readings):
                    self._newest[name] = readings[-1]
        observation |= self._newest
        if not self._truth:
            observation = {name: value for name, value in observation.items() if not name.startswith("truth_")}
        self._last_observation = {name: np.asarray(value) for name, value in observation.items()}
        return self._last_observation
