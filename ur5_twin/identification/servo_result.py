"""``identify servo``: everything logs tell of a servo, put into one set of gains, and its report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ur5_twin.arm import files
from ur5_twin.arm.drive import load_drive
from ur5_twin.arm.parameters import N_JOINTS, ArmModel
from ur5_twin.control.gains import Gains
from ur5_twin.control.target_current import TargetCurrentLaw
from ur5_twin.errors import IdentificationError
from ur5_twin.evaluation.metrics import mean_absolute
from ur5_twin.evaluation.tables import JOINT_COLUMNS
from ur5_twin.identification.results import Numbers, Result, provenance, sources
from ur5_twin.identification.servo import fit_servo
from ur5_twin.identification.servo_nlse import Nlse
from ur5_twin.identification.servo_tracking import fit_tracking, is_standstill
from ur5_twin.recording.table import Recording
from ur5_twin.twin.replay import ReplaySettings, replay

#: Name of the file, and of its table.
FILE, TABLE = "gains.toml", "mine"
_KEYS = ("kappa0", "kappa1", "kappai")


@dataclass(frozen=True)
class Servo:
    """A servo from logs.

    Attributes:
        gains: what replay takes.
        intervals: by the file's keys, in its units: (6, 2) 95 %, NaN where the base gains stay.
        origin: by the file's keys, six words: where each joint's number is from.
        remarks: sentences for the report.
    """

    gains: Gains
    intervals: dict[str, np.ndarray]
    origin: dict[str, tuple[str, ...]]
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class HeldOut:
    """A moving log replayed with a servo from the other logs; errors (6,) rad over the rows in which targets move.

    Attributes:
        recording: the replay, with the twin's columns.
        moving: the twin's, and ``lag``: the arm's own.
        everywhere, own: the same over all rows, ``own`` as in the thesis' table 5.5.
    """

    recording: Recording
    moving: np.ndarray
    lag: np.ndarray
    everywhere: np.ndarray
    own: np.ndarray


def fit(recordings: Sequence[Recording], base: Gains, controller: ArmModel, law: TargetCurrentLaw) -> Servo:
    """Pushes where the target stands still, tracking errors where it moves; the rest is ``base``.

    Raises:
        IdentificationError: the logs carry neither.
    """
    still = [r for r in recordings if is_standstill(r)]
    moving = [r for r in recordings if not is_standstill(r)]
    kappas = np.stack([base.kappa0, base.kappa1, base.kappai])
    half = np.full((3, N_JOINTS), np.nan)
    origin = np.full(N_JOINTS, f"preset {base.name}", dtype=object)
    remarks = []
    if still:
        try:
            pushes = fit_servo(still, controller, law.torque_constant)
        except IdentificationError as error:
            if not moving:
                raise
            remarks.append(f"pushes: {error}")
        else:
            told = pushes.good.any(axis=0)
            kappas = np.where(told, np.stack(pushes.kappas()), kappas)
            half = np.where(told, pushes.kappa_half_widths(), half)
            origin[told] = "pushes"
    gains = Gains(TABLE, base.source, *kappas, lag=base.lag, share=base.share)
    intervals = {key: _around(k, h) for key, k, h in zip(_KEYS, kappas, half, strict=True)}
    tracked = np.zeros(N_JOINTS, dtype=bool)
    lag = share = np.full((N_JOINTS, 2), np.nan)
    if moving:
        tracking = fit_tracking(moving, gains)
        gains, tracked = tracking.gains, tracking.told
        lag, share = tracking.lag_interval, tracking.share_interval
    words = tuple(np.where(tracked, "tracking", f"preset {base.name}"))
    intervals |= {"lag_ms": 1e3 * lag, "acceleration_share": share}
    sources_of = dict.fromkeys(_KEYS, tuple(origin)) | {"lag_ms": words, "acceleration_share": words}
    return Servo(gains, intervals, sources_of, tuple(remarks))


def held_out(
    recordings: Sequence[Recording],
    base: Gains,
    controller: ArmModel,
    law: TargetCurrentLaw,
    progress: Callable[[int], object],
) -> list[HeldOut]:
    """Each moving log by a servo from all others; empty with fewer than two moving logs."""
    moving = [r for r in recordings if not is_standstill(r)]
    found = []
    for done, unseen in enumerate(moving if len(moving) > 1 else [], start=1):
        gains = fit([r for r in recordings if r is not unseen], base, controller, law).gains
        settings = ReplaySettings(controller, controller, gains, load_drive(), law)
        played = replay(unseen, settings)
        robot = played.robot
        # The replay begins again after a silence: no prediction there.
        there = ~np.isnan(robot["sim_actual_q"]).any(axis=1)
        moves = there & robot["target_qd"].any(axis=1)
        errors = [
            mean_absolute(robot["actual_q"][rows], robot[name][rows])
            for rows in (moves, there)
            for name in ("sim_actual_q", "target_q")
        ]
        found.append(HeldOut(played, *errors))
        progress(done)
    return found


def servo_result(
    servo: Servo, checked: Sequence[HeldOut], nlse: Nlse | None, recordings: Sequence[Recording], command: str
) -> Result:
    """The gains in the layout of ``models/gains.toml``, and the report."""
    values = _values(servo.gains)
    found = [
        f"{key} of joint {j + 1}: {short(values[key][j])}, {servo.origin[key][j]}{_interval(pair)}"
        for key in values
        for j, pair in enumerate(servo.intervals[key])
    ]
    told = np.isfinite(servo.intervals["acceleration_share"]).all(axis=1)
    # What tracking tells of K0: with A and K0 it says (A - 1) / K0, and with A = 0 that would be the servo's whole K0.
    stiffness = np.where(told, servo.gains.kappa0 / (1.0 - servo.gains.share), np.nan)
    title = "Effective K0: what explains the error per acceleration without any of it fed forward"
    tables = [Numbers(title, "1/s^2", ("K0 / (1 - A)",), JOINT_COLUMNS, stiffness[None])] if told.any() else []
    if checked:
        names = tuple(item.recording.source for item in checked)
        ratio = np.stack([item.moving / item.lag for item in checked])
        tables += [
            _numbers("Mean absolute tracking error, targets moving", "mrad", names, checked, "lag"),
            _numbers("The same of the twin, each log by a servo from all the others", "mrad", names, checked, "moving"),
            Numbers("The twin's over the arm's own, targets moving", "ratio", names, JOINT_COLUMNS, ratio),
            Numbers(
                "The same over all rows, as the thesis' table 5.5 counts",
                "ratio",
                names,
                JOINT_COLUMNS,
                np.stack([item.everywhere / item.own for item in checked]),
            ),
        ]
    if nlse is not None:
        who = ", ".join(str(j + 1) for j in np.flatnonzero(nlse.told))
        found.append(
            f"the thesis' fit of PD gains (2.83): the logs tell those of joints {who}"
            if who
            else "the thesis' fit of PD gains (2.83): these logs tell no joint's, its cost hardly depends on them"
        )
        rows = ("kappa0 1/s^2", "kappa1 1/s", "condition of the Jacobian", "half-width of log kappa0", "of log kappa1")
        numbers = np.stack([*nlse.kappa, nlse.condition, *nlse.log_half])
        tables.append(Numbers("Equation (2.83)", "as each row says", rows, JOINT_COLUMNS, numbers))
        spread = np.stack([profile[:, [0, -1]].max(axis=1) for profile in nlse.profile])
        names = ("kappa0", "kappa1")
        tables.append(
            Numbers("Its cost at the ends of the range over the least", "ratio", names, JOINT_COLUMNS, spread)
        )
    where = provenance(recordings, command)
    noted = {key: [[float(x) for x in pair] if np.isfinite(pair).all() else [] for pair in rows]
             for key, rows in servo.intervals.items()}  # fmt: skip
    model = {
        TABLE: {"source": f"{command}, on {', '.join(sources(recordings))}"}
        | {key: value.tolist() for key, value in values.items()}
        | {"provenance": where | {"interval_95": noted, "from": {k: list(v) for k, v in servo.origin.items()}}}
    }
    layout = dict[str, files.GainsSpec]
    return Result(FILE, layout, model, "Servo", (*found, *servo.remarks), tuple(tables), where)


def short(value: float) -> str:
    """A gain in four digits."""
    return f"{value:.4g}"


def _values(gains: Gains) -> dict[str, np.ndarray]:
    return {key: getattr(gains, key) for key in _KEYS} | {
        "lag_ms": 1e3 * gains.lag,
        "acceleration_share": gains.share,
    }


def _interval(pair: np.ndarray) -> str:
    return f", 95 % {short(pair[0])} to {short(pair[1])}" if np.isfinite(pair).all() else ""


def _around(value: np.ndarray, half: np.ndarray) -> np.ndarray:
    return value[:, None] + half[:, None] * np.array([-1.0, 1.0])


def _numbers(title: str, unit: str, rows: tuple[str, ...], items: Sequence[HeldOut], name: str) -> Numbers:
    return Numbers(title, unit, rows, JOINT_COLUMNS, 1e3 * np.stack([getattr(item, name) for item in items]))
