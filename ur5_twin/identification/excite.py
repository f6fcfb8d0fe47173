"""``identify excite``: a motion that tells most of what is wanted, tried in the twin, and what it will tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ur5_twin.arm.drive import drives_of
from ur5_twin.arm.parameters import N_JOINTS, load_model
from ur5_twin.control.gains import load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.drives.terms import ride
from ur5_twin.errors import IdentificationError, unknown
from ur5_twin.evaluation.reporting import short_number, versions
from ur5_twin.identification import excite_trial
from ur5_twin.identification.excitation import PURPOSES, Parameter, Question
from ur5_twin.identification.excite_search import EXCHANGES, FORMATS, Format, Search, Tour
from ur5_twin.identification.excite_trial import Load, Trial
from ur5_twin.identification.results import Numbers, Result
from ur5_twin.identification.workspace import Bounds, Workspace, joint_bounds, with_weight
from ur5_twin.recording.table import Recording
from ur5_twin.scenario.files import ScenarioFile
from ur5_twin.sensing import load_sensors
from ur5_twin.twin.cell import PERIOD

#: What a UR5 carries, kg (the manufacturer's data sheet).
_HEAVIEST = 5.0
#: Random tours that one is taken of to compare with.
_RANDOM = 5
#: Told to a share of its size within an hour of such motion, a parameter counts as one that motion can tell.
_TOLD, _HOUR = 0.1, 3600.0


@dataclass(frozen=True)
class Request:
    """What is asked for, in SI units.

    Attributes:
        purpose: one of ``PURPOSES``.
        format: one of ``FORMATS``.
        duration: s.
        plant: name or TOML of the arm.
        tool: on its flange.
        payload: the tool that the controller was told of.
        weight: mass in kg and centre (3,) in the flange frame, m, of a further load; None for none.
        q_start: (6,) rad.
        reach: how far each joint may be from its start, rad.
        speed, acceleration: limits of every joint, rad/s, rad/s^2.
        box: (3, 2) for flange and tool's end, m.
        height: kept over the base's plane, m.
        clearance: kept between the arm's parts, m.
        seed: of the search and of the trial's noise.
    """

    purpose: str
    format: Format
    duration: float
    plant: str
    tool: str
    payload: str
    weight: tuple[float, np.ndarray] | None
    q_start: np.ndarray
    reach: float
    speed: float
    acceleration: float
    box: np.ndarray
    height: float
    clearance: float
    seed: int


@dataclass(frozen=True)
class Excitation:
    """A motion, its files, its trial, and standard errors (n_parameters,) of what it is for.

    Attributes:
        request: what was asked for.
        question: what is to be known.
        workspace: what was kept to.
        tour: the motion.
        trial: the twin's way along it.
        sent: name and text of the file that the controller is sent.
        scenario: the scenario that runs it.
        before: standard errors of random postures at URScript's own speed, as long.
        planned: of this motion, as planned.
        achieved: of this motion, as the simulated arm moved.
        missed: what least squares on the trial's log gets wrong; NaN for the servo, and where nothing is told.
        beside: log -> standard errors of its motion, as if it were as long.
        value, value_before: log det of the information of this motion and of the random one.
    """

    request: Request
    question: Question
    workspace: Workspace
    tour: Tour
    trial: Trial
    sent: tuple[str, str]
    scenario: dict[str, Any]
    before: np.ndarray
    planned: np.ndarray
    achieved: np.ndarray
    missed: np.ndarray
    beside: dict[str, np.ndarray]
    value: float
    value_before: float

    def unknown(self) -> list[Parameter]:
        """What such motion does not tell to a tenth of its size, were it an hour long."""
        scale = np.array([parameter.scale for parameter in self.question.parameters])
        hour = self.planned / scale * np.sqrt(self.request.duration / _HOUR)
        return [
            p for p, told in zip(self.question.parameters, ~(hour > _TOLD) & np.isfinite(hour), strict=True) if not told
        ]


def excite(
    request: Request,
    command: str,
    beside: Sequence[Recording] = (),
    *,
    exchanges: int = EXCHANGES,
    searching: Callable[[int], object] | None = None,
    trying: Callable[[int, int], object] | None = None,
) -> Excitation:
    """Find a motion, try it in the twin and see what it tells.

    Args:
        request: what is asked for.
        command: the command line, for the files' first lines.
        beside: logs whose motion is looked at for comparison.
        exchanges: of the search.
        searching: called with steps of ``GREEDY + exchanges``.
        trying: called with ticks done and all of them.

    Raises:
        IdentificationError: the limits leave no such motion, or the trial passes one.
    """
    for kind, word, known in (("purpose", request.purpose, PURPOSES), ("format", request.format, FORMATS)):
        if word not in known:
            raise IdentificationError(unknown(kind, word, known))
    question, workspace, load = _prepare(request)
    problem = workspace.problem(request.q_start[None])
    if problem is not None:
        raise IdentificationError(f"the start is not allowed: {problem}; give another --q-start or other limits")
    rng = np.random.default_rng(request.seed)
    search = Search(question, workspace, request.format, request.duration, rng)
    tour = search.best(request.q_start, exchanges, searching)
    # Random tours differ: the middle one of some, by what they tell.
    dice = Search(question, workspace, request.format, request.duration, np.random.default_rng([request.seed, 1]))
    random = sorted((dice.random(request.q_start) for _ in range(_RANDOM)), key=lambda one: one.value)[_RANDOM // 2]
    remarks = [command, f"starts at {[round(float(x), 4) for x in tour.start]} rad"]
    sent = excite_trial.SENT[request.format], excite_trial.sent_file(search, tour, request.format, remarks)
    arm = {"plant": request.plant, "tool": request.tool, "declared_payload": request.payload}
    scenario = excite_trial.scenario_of(tour, request.format, arm, load, request.purpose, request.seed)
    trial = excite_trial.try_out(scenario, sent, workspace, trying)

    # Of the random motion only the legs are known; the ripple's angle is along them what it is.
    before = question.information(question.ride(search.rows(random, PERIOD), PERIOD), ripple=True)
    planned = question.information(question.ride(trial.planned, PERIOD), ripple=True)
    moved = question.ride(trial.moved, PERIOD)
    log = ride(trial.recording, question.plant)
    achieved = question.information(moved, ripple=True)
    if question.wants_servo:
        achieved = question.servo_seen(log, achieved)
    length = len(trial.reference) * PERIOD
    others = {}
    for recording in beside:
        of = ride(recording, question.plant)
        told = question.information(of, ripple=True)
        if question.wants_servo:
            told = question.servo_seen(of, told)
        others[recording.source.removeprefix("Movement_")] = question.errors(
            told.times(length / (of.time[-1] - of.time[0]))
        )
    return Excitation(
        request=request,
        question=question,
        workspace=workspace,
        tour=tour,
        trial=trial,
        sent=sent,
        scenario=scenario,
        before=question.errors(before),
        planned=question.errors(planned),
        achieved=question.errors(achieved),
        missed=np.where(np.isfinite(question.errors(planned)), question.fit(log), np.nan),
        beside=others,
        value=question.value(planned),
        value_before=question.value(before),
    )


def excite_result(found: Excitation, command: str) -> Result:
    """The scenario, with what the report says; the other files are ``found.sent`` and the trial's reference."""
    request, parameters = found.request, found.question.parameters
    columns: dict[str, np.ndarray] = {
        "value": np.array([p.value for p in parameters]),
        "random": found.before,
        "this": found.planned,
        "as moved": found.achieved,
        "fit's error": found.missed,
        **found.beside,
    }
    table = Numbers(
        f"Standard errors that no fit beats, for {len(found.trial.reference) * PERIOD:.0f} s: random postures at "
        "URScript's speed, this motion as planned and as the twin moved; error of a fit to the twin's log"
        + ("; the motion of logs, as if it were as long" if found.beside else ""),
        "each in its own",
        tuple(f"{p.label}, {p.unit}" for p in parameters),
        tuple(columns),
        np.stack(list(columns.values()), axis=1),
    )
    return Result(
        excite_trial.SCENARIO,
        ScenarioFile,
        found.scenario,
        f"A motion that tells what '{request.purpose}' asks for",
        tuple(_findings(found)),
        (table, _limits(found)),
        {"command": command, "logs": list(found.beside), "versions": versions()},
        {
            "seed": request.seed,
            "log_det": {"random": found.value_before, "this": found.value},
            "parameters": [
                {"name": p.name, "joint": p.joint, "unit": p.unit, "value": p.value, "scale": p.scale}
                for p in parameters
            ],
        },
    )


def _prepare(request: Request) -> tuple[Question, Workspace, Load | None]:
    bare, controller = load_model(request.plant, request.tool), load_model("controller", request.payload)
    plant, seen, load = bare, bare, None
    if request.weight is not None:
        mass, center = request.weight
        if not 0.0 < mass <= _HEAVIEST:
            raise IdentificationError(
                f"--carry {mass:g} kg: a UR5 carries more than nothing and at most {_HEAVIEST:g} kg"
            )
        # What shall be found out is not told to the controller.
        load = Load(mass, center, told=request.purpose not in ("payload", "all"))
        plant, seen = (with_weight(bare, mass, center, seen=s) for s in (False, True))
        if load.told:
            controller = with_weight(controller, mass, center, seen=False)
    low, high = joint_bounds(plant, request.q_start, request.reach)
    bounds = Bounds(low, high, request.box, request.height, request.clearance, request.speed, request.acceleration)
    for name, value, limit, unit in (
        ("--speed-limit", request.speed, plant.limits.qd.min(), "rad/s"),
        ("--acceleration-limit", request.acceleration, plant.limits.qdd.min(), "rad/s^2"),
    ):
        if value > limit:
            raise IdentificationError(f"{name} {value:g} {unit} is beyond the arm's own limit of {limit:g} {unit}")
    question = Question(
        request.purpose,
        plant,
        controller,
        drives_of(plant),
        load_target_current_law(),
        load_gains("servo"),
        load_sensors("lab"),
    )
    return question, Workspace(seen, bounds), load


def _findings(found: Excitation) -> list[str]:
    request, trial, parameters = found.request, found.trial, found.question.parameters
    both = np.isfinite(found.before) & np.isfinite(found.planned)
    better = found.before[both] / found.planned[both]
    lines = [
        f"{len(found.tour.legs)} moves in {len(trial.reference) * PERIOD:.1f} s; in the twin it came to its end "
        "without a protective stop, within joints, speed, torque and workspace",
        f"beside random postures at URScript's speed, as long: standard errors {np.median(better):.1f} times smaller "
        f"in the median ({better.min():.2f} to {better.max():.1f}); log det of the information {found.value:.1f} "
        f"against {found.value_before:.1f}",
    ]
    lost = [
        p.label
        for p, a, b in zip(parameters, found.before, found.planned, strict=True)
        if np.isfinite(a) > np.isfinite(b)
    ]
    if lost:
        lines.append(f"only the random motion tells {', '.join(lost)}")
    as_moved = found.achieved / found.planned
    lines.append(f"standard errors as the twin moved over those planned: {np.nanmedian(as_moved):.2f} in the median")
    seen = np.isfinite(found.missed) & np.isfinite(found.planned)
    if seen.any():
        share = np.abs(found.missed[seen] / found.planned[seen])
        lines.append(
            f"a fit to the twin's log, with its noise, is off by {np.sqrt(np.mean(share**2)):.1f} standard errors "
            f"(root mean square over {seen.sum()} parameters; 1 if nothing but noise were in the way) and by "
            f"{np.median(share):.1f} in the median"
        )
    for name, errors in found.beside.items():
        both = np.isfinite(errors) & np.isfinite(found.planned)
        ratio = errors[both] / found.planned[both]
        more = int((np.isfinite(found.planned) & ~np.isfinite(errors)).sum())
        lines.append(
            f"beside the motion of {name}: standard errors {np.median(ratio):.1f} times smaller in the median "
            f"({ratio.min():.2f} to {ratio.max():.1f})" + (f", and {more} that it does not tell at all" if more else "")
        )
    lines.append(
        "all of this counts the current's noise and the ripple; what the law of friction does not know of a real joint "
        "comes on top and is often larger"
    )
    return lines + _advice(found, request)


def _advice(found: Excitation, request: Request) -> list[str]:
    """What no such motion can tell, and what to do about it."""
    lacking = found.unknown()
    about = ["a payload's numbers are measured against a kilogram 0.1 m away: 1 kg, 0.1 kg m, 0.01 kg m^2"]
    if all(p.joint for p in found.question.parameters):
        about = []
    if not lacking:
        return [*about, "nothing that was asked for is out of reach of such motion"]
    lines = [*about, f"an hour of such motion would not tell to a tenth: {', '.join(p.label for p in lacking)}"]
    joints = {p.joint for p in lacking if p.name == "torque_constant"}
    for j in sorted(joints):
        if j == N_JOINTS:
            lines.append(
                "joint 6 turns nothing but its own rotor, so its current tells torque constant, friction and rotor "
                "inertia only over each other: carry a known weight off its axis (--carry 1.5 0.06 0 0.05), or take "
                "the rotor inertia from 'identify controller' and ask --for drive"
            )
        elif j == 1:
            lines.append(
                "joint 1 bears no weight: its torque constant shows only in the links' inertia as the arm folds and "
                "stretches; a known weight far out makes more of it"
            )
        else:
            lines.append(f"joint {j} bears too little to tell its torque constant: carry a known weight (--carry)")
    if any(p.name == "load" for p in lacking):
        lines.append(
            "friction that grows with load needs a load: on the joints above, carry a known weight or take it as zero"
        )
    if any(p.joint == 0 for p in lacking):
        lines.append("a payload's small moments of inertia do not show through the drives: take them from its drawing")
    if any(p.name.startswith("kappa") for p in lacking):
        lines.append("the servo shows more when it is pushed at rest than in any motion: see docs/servo.md")
    return lines


def _limits(found: Excitation) -> Numbers:
    trial, bounds, limits = found.trial, found.workspace.bounds, found.question.plant.limits
    ones = np.ones(N_JOINTS)
    rows = {
        "speed planned, rad/s": trial.planned_speed,
        "speed in the twin, rad/s": trial.speed,
        "speed allowed, rad/s": bounds.speed * ones,
        "acceleration planned, rad/s^2": trial.planned_acceleration,
        "acceleration allowed, rad/s^2": bounds.acceleration * ones,
        "acceleration in the twin, with the ripple's, rad/s^2": trial.acceleration,
        "motor torque in the twin, Nm": trial.torque,
        "motor torque at most, Nm": limits.torque,
        "least position planned, rad": trial.reference[:, 0].min(axis=0),
        "greatest position planned, rad": trial.reference[:, 0].max(axis=0),
        "distance from the target in the twin, mrad": 1e3 * trial.error,
    }
    columns = tuple(f"joint {j}" for j in range(1, N_JOINTS + 1))
    title = f"Limits (the controller's own estimate of force reaches {short_number(trial.force)} N)"
    return Numbers(title, "each in its own", tuple(rows), columns, np.stack(list(rows.values())))
