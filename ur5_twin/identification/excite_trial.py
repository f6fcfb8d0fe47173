"""The files of an exciting motion, and its trial in the twin before any real arm moves."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from ur5_twin.control.commands import MoveJ
from ur5_twin.control.waypoints import Waypoints, format_move
from ur5_twin.errors import IdentificationError, TwinError
from ur5_twin.identification.excite_search import GAIN, LOOKAHEAD, WAIT, Format, Search, Tour
from ur5_twin.identification.workspace import Workspace, ball_radius
from ur5_twin.recording.table import Recording
from ur5_twin.scenario import load_scenario
from ur5_twin.twin.cell import PERIOD
from ur5_twin.twin.scenario_run import ScenarioRun

#: Names of what is written: the scenario, what the controller is sent, and what it makes of it.
SCENARIO, SENT, PLAIN = "scenario.toml", {"waypoints": "waypoints.txt", "servoj": "servoj.txt"}, "trajectory.csv"
#: Columns of the last of these, with their units.
_COLUMNS = (("q", "rad"), ("qd", "rad_s"), ("qdd", "rad_s2"))
#: A UR5 of the CB series stops at this force of its own estimate as it is delivered, N.
_FORCE = 150.0
#: Shares of a limit that the simulated arm may reach: the servo overshoots a speed a little, and a motor at its limit
#: of torque says nothing.
_SPEED, _TORQUE = 1.05, 0.9
#: Joint position that the servo may be off, rad: lab and twin stay below.
_ERROR = 0.01
#: Ticks between two postures that are looked at, 40 ms: 0.06 rad at 1.5 rad/s.
_EVERY = 5


@dataclass(frozen=True)
class Load:
    """A known weight at the flange, or an unknown one of about these numbers.

    Attributes:
        mass: kg.
        center: (3,) in the flange frame, m.
        told: whether the controller is told of it.
    """

    mass: float
    center: np.ndarray
    told: bool


@dataclass(frozen=True)
class Trial:
    """A motion as the twin moved along it.

    Attributes:
        recording: what its devices reported, with the truth.
        reference: (n, 3, 6) the controller's target rows, one a tick.
        planned: (n, 3, 6) the same with qdd as in ``moved``.
        moved: (n, 3, 6) the joints' true q and qd; their qdd trembles with the ripple, so it is the target's, as the
            derivative of target_qd: servoj's target_qdd has a sawtooth.
        speed, acceleration, torque: (6,) greatest of the truth, rad/s, rad/s^2, Nm.
        planned_speed, planned_acceleration: (6,) greatest of the reference.
        error: (6,) greatest distance of a joint from its target, rad.
        force: greatest force of the controller's own estimate, N.
    """

    recording: Recording
    reference: np.ndarray
    planned: np.ndarray
    moved: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray
    planned_speed: np.ndarray
    planned_acceleration: np.ndarray
    error: np.ndarray
    force: float


def scenario_of(
    tour: Tour, format: Format, arm: dict[str, Any], load: Load | None, purpose: str, seed: int
) -> dict[str, Any]:
    """The scenario that runs a tour's file, in the layout of ``scenarios/*.toml``."""
    motion: dict[str, Any] = {"type": format, "file": SENT[format]}
    if format == "servoj":
        motion |= {"lookahead_s": LOOKAHEAD, "gain": GAIN}
    found: dict[str, Any] = {
        "title": f"Excitation for {purpose}",
        "description": f"A motion by 'ur5-twin identify excite' that tells most of what '{purpose}' asks for.",
        "seed": seed,
        "arm": arm,
        "start": {"q_rad": tour.start.tolist()},
        "motion": [motion],
        "limits": {"force_n": _FORCE},
    }
    if load is not None:
        tensor = inertia_of(load)
        found["payload"] = [
            {
                "at_s": 0.0,
                "mass_kg": load.mass,
                "center_mm": (1e3 * load.center).tolist(),
                "inertia_kg_m2": [tensor] * 3,
                **({"declared_at_s": 0.0} if load.told else {}),
            }
        ]
    return found


def inertia_of(load: Load) -> float:
    """Moment of inertia of the weight about any axis through its centre, as a steel ball's, kg m^2."""
    return 0.4 * load.mass * ball_radius(load.mass) ** 2


def sent_file(search: Search, tour: Tour, format: Format, remarks: list[str]) -> str:
    """What the controller is sent, as ``control.waypoints`` or a scenario's servoj reads it."""
    head = [f"# {line}" for line in remarks]
    if format == "waypoints":
        moves = [
            MoveJ(tuple(tour.start.tolist())),
            *(MoveJ(tuple(leg.goal.tolist()), a=leg.acceleration, v=leg.speed) for leg in tour.legs),
        ]
        points = Waypoints(tuple(moves), "joint_space", WAIT)
        return "\n".join([*head, f"{points.space} {points.wait!r}", *map(format_move, points.moves), ""])
    points = search.samples(tour, PERIOD)
    lines = [f"{k * PERIOD:.3f} " + " ".join(f"{x:.6f}" for x in point) for k, point in enumerate(points)]
    return "\n".join([*head, "# time in s, six joint positions in rad", *lines, ""])


def plain_file(reference: np.ndarray) -> str:
    """The target rows (n, 3, 6) as CSV: time, q, qd and qdd, for a controller of any make."""
    names = ["time_s", *(f"{name}{j}_{unit}" for name, unit in _COLUMNS for j in range(1, 7))]
    table = reference.reshape(len(reference), -1)
    lines = [f"{k * PERIOD:.3f}," + ",".join(f"{x:.6f}" for x in row) for k, row in enumerate(table)]
    return "\n".join([",".join(names), *lines, ""])


def try_out(
    scenario: dict[str, Any],
    sent: tuple[str, str],
    workspace: Workspace,
    progress: Callable[[int, int], object] | None = None,
) -> Trial:
    """Run the files in the twin, with motors, friction and the lab's sensors, and look at what really happened.

    Args:
        scenario: of ``scenario_of``.
        sent: name and text of the file that it sends.
        workspace: what must be kept to.
        progress: called with the ticks done and how many there are.

    Raises:
        IdentificationError: a limit is passed, in the plan or in truth, or the controller stops the arm.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / SCENARIO
        path.write_text(tomli_w.dumps(scenario), encoding="utf-8")
        (path.parent / sent[0]).write_text(sent[1], encoding="utf-8")
        try:
            run = ScenarioRun(load_scenario(path), keep_trace=True)
        except TwinError as error:
            raise IdentificationError(f"the motion cannot be had: {error}") from None
    bounds = workspace.bounds
    planned = run.reference.rows
    if run.reference.ignored:
        first = run.reference.ignored[0]
        raise IdentificationError(
            f"the controller would ignore move {first.index}: it comes at {first.time:g} s while the arm still moves; "
            "raise the speed limit"
        )
    planned_speed, planned_acceleration = np.abs(planned[:, 1]).max(axis=0), np.abs(planned[:, 2]).max(axis=0)
    _within("the planned speed", planned_speed, np.full(6, bounds.speed), "rad/s")
    _within("the planned acceleration", planned_acceleration, np.full(6, bounds.acceleration), "rad/s^2")
    recording = run.finish(None if progress is None else lambda done: progress(done, len(run)))
    ended = run.cell.failure or run.cell.stop_reason
    if ended:
        raise IdentificationError(f"in the twin the motion does not come to its end: {ended}; nothing is written")
    robot, trace = recording.robot, run.trace()
    speed, acceleration = np.abs(trace.qd).max(axis=0), np.abs(trace.qdd).max(axis=0)
    torque, limits = np.abs(trace.motor_torque).max(axis=0), run.setup.plant.limits
    _within("in the twin the speed", speed, np.full(6, _SPEED * bounds.speed), "rad/s")
    _within("in the twin the acceleration", acceleration, limits.qdd, "rad/s^2")
    _within("in the twin the motor's torque", torque, _TORQUE * limits.torque, "Nm")
    if len(trace.contact_row):
        raise IdentificationError(
            f"in the twin the arm touches itself at {trace.time[trace.contact_row[0]]:.3f} s; raise --clearance"
        )
    truth = trace.q[:: _EVERY * round(len(trace.q) / len(robot))]
    eased = replace(bounds, low=bounds.low - _ERROR, high=bounds.high + _ERROR)
    problem = Workspace(workspace.plant, eased).problem(truth)
    if problem is not None:
        raise IdentificationError(f"in the twin the arm leaves its workspace: {problem}; nothing is written")
    moved = np.stack([robot["truth_q"], robot["truth_qd"], np.gradient(robot["target_qd"], PERIOD, axis=0)], axis=1)
    n = min(len(planned), len(robot))
    return Trial(
        recording=recording,
        reference=planned,
        planned=np.stack([planned[:, 0], planned[:, 1], np.gradient(planned[:, 1], PERIOD, axis=0)], axis=1),
        moved=moved,
        speed=speed,
        acceleration=acceleration,
        torque=torque,
        planned_speed=planned_speed,
        planned_acceleration=planned_acceleration,
        error=np.abs(robot["truth_q"][:n] - planned[:n, 0]).max(axis=0),
        force=float(np.linalg.norm(robot["actual_TCP_force"][:, :3], axis=1).max()),
    )


def _within(what: str, values: np.ndarray, limits: np.ndarray, unit: str) -> None:
    beyond = values > limits
    if beyond.any():
        j = int(np.argmax(values / limits))
        raise IdentificationError(
            f"{what} of joint {j + 1} is {values[j]:.4g} {unit}, more than {limits[j]:.4g} {unit}; nothing is written"
        )
