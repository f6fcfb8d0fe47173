"""How well an estimator's wrenches and contacts agree with the truth, overall and regime by regime."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ur5_twin.estimation.detection import ContactDetector, Thresholds
from ur5_twin.estimation.samples import Estimates
from ur5_twin.evaluation import metrics

#: Force from which on something counts as touching the arm, N: beyond the noise of a force sensor, and what the
#: detection is asked to find.
TOUCHED = 3.0
#: A touch shorter than this, or closer than this to the last one, is a part of it, s.
_APART = 0.3
#: Force that a touch must reach to count as missed if nobody tells it, N.
_WORTH_FINDING = 10.0
#: An alarm this long before a touch is of the touch: sensors come late and hands lean, s.
_EARLY = 0.1
#: Target speed that counts as motion, rad/s, and how long after a turn a joint still reverses, s.
_MOVING, _TURNING = 1e-3, 0.25
#: Smallest singular value of J, in m and rad, below which a posture is near a singularity.
NEAR_SINGULARITY = 0.1
#: Normal quantiles of central intervals that hold 90 % and 95 %.
NINETY, _NINETY_FIVE = 1.6449, 1.9600
_INTERVALS = {"coverage_90": NINETY, "coverage_95": _NINETY_FIVE}


@dataclass(frozen=True)
class Truth:
    """What an estimate is compared with, on the estimate's clock.

    Attributes:
        what: ``truth`` of a simulated run, ``ft`` for a force sensor.
        time: (n,) s.
        wrench: (n, 6) on the arm at the flange in base axes, N and Nm; NaN where it is not known.
        tau_ext: (n, 6) Nm by contacts anywhere; NaN where it is not known.
        touched: (n,) whether anything acts on the arm.
    """

    what: str
    time: np.ndarray
    wrench: np.ndarray
    tau_ext: np.ndarray
    touched: np.ndarray


def score(estimates: Estimates, truth: Truth, regimes: dict[str, np.ndarray], thresholds: Thresholds) -> dict[str, Any]:
    """All numbers of one estimator on one log.

    - ``mae``, ``rmse``, ``max``, ``bias`` (estimate minus truth), ``correlation``, ``coverage_90`` and ``coverage_95``
      (shares of rows in which the truth lies within the stated interval): six numbers, three in N and three in Nm (no
      unit for the last three), over all rows; null where there are none.
    - ``tau_mae_nm``: six numbers, joint 1 to 6.
    - ``regimes``: the same for the rows of each regime, and ``rows``.
    - ``detection``: see ``detection``.

    Args:
        estimates: row for row with the truth.
        truth: what is compared with.
        regimes: name -> (n,) rows.
        thresholds: of the contact detector on the probability of contact.
    """
    known = np.asarray(np.isfinite(np.concatenate([truth.wrench, estimates.wrench], axis=1)).all(axis=1))
    return {
        **_errors(estimates, truth, known),
        "regimes": {name: _errors(estimates, truth, np.logical_and(known, rows)) for name, rows in regimes.items()},
        "detection": detection(estimates.time, estimates.contact, truth, thresholds),
    }


@dataclass(frozen=True)
class Told:
    """What a detector made of a log.

    Attributes:
        touches: how many there were.
        delays: s from a touch's beginning to the alarm, of those told while they lasted.
        missed: touches that reached 10 N and were not.
        false: alarms without a touch.
        hours: without a touch.
    """

    touches: int
    delays: tuple[float, ...]
    missed: int
    false: int
    hours: float


def told(time: np.ndarray, level: np.ndarray, truth: Truth, thresholds: Thresholds) -> Told:
    """Contacts found, missed and imagined.

    Args:
        time: (n,) s.
        level: (n,) that grows with the contact: its probability, or a force in N.
        truth: row for row.
        thresholds: of the detector.
    """
    detector = ContactDetector(thresholds)
    alarm = np.array([detector.update(t, p) for t, p in zip(time.tolist(), level.tolist(), strict=True)])
    touches = _episodes(time, truth.touched)
    force = np.linalg.norm(np.nan_to_num(truth.wrench[:, :3]), axis=1)
    explained = np.zeros(len(time), dtype=bool)
    begins = np.flatnonzero(alarm & ~np.concatenate([[False], alarm[:-1]]))
    delays, missed = [], 0
    for first, last in touches:
        early = int(np.searchsorted(time, time[first] - _EARLY))
        explained[early : last + 1] = True
        # An alarm that has been on for long says nothing of this touch.
        rows = begins[(begins >= early) & (begins <= last)]
        if len(rows):
            delays.append(max(float(time[rows[0]] - time[first]), 0.0))
        elif force[first : last + 1].max() >= _WORTH_FINDING:
            missed += 1
    false = int((~explained[begins]).sum())
    hours = float(np.diff(time, append=time[-1])[~truth.touched].sum()) / 3600.0
    return Told(len(touches), tuple(delays), missed, false, hours)


def detection(time: np.ndarray, level: np.ndarray, truth: Truth, thresholds: Thresholds) -> dict[str, Any]:
    """What ``told`` finds, as a report has it (``summary``)."""
    return summary(told(time, level, truth, thresholds))


def summary(of: Told) -> dict[str, Any]:
    """What ``told`` found, as plain data.

    - ``touches``: how many; ``found``, an alarm began with them, or up to 0.1 s before; ``missed`` reached 10 N and
      were not found.
    - ``delay_s``: median and 95th percentile from a touch's beginning to the alarm, null where none is found.
    - ``false_alarms``, ``false_alarms_per_hour``: alarms without a touch, over the hours without one.
    """
    return {
        "touches": of.touches,
        "found": len(of.delays),
        "missed": of.missed,
        "delay_s": None if not of.delays else [float(np.median(of.delays)), float(np.percentile(of.delays, 95))],
        "false_alarms": of.false,
        "false_alarms_per_hour": of.false / of.hours if of.hours > 0 else None,
    }


def regimes_of(
    truth: Truth, target_qd: np.ndarray, sigma_min: np.ndarray, at_tool: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """Rows of each regime, which may overlap: name -> (n,).

    ``still`` no target moves; ``moving`` one does; ``reversing`` one has turned round within 0.25 s;
    ``near_singularity`` the Jacobian's smallest singular value is below 0.1; ``touched`` something acts on the arm,
    ``untouched`` nothing does; ``beyond_tool`` it acts elsewhere than at the tool. The first four come with
    ``_touched`` too: where nothing acts, an estimate of nothing lies in any interval.

    Args:
        truth: row for row.
        target_qd: (n, 6) rad/s.
        sigma_min: (n,) m and rad.
        at_tool: (n,) whether all that touches the arm touches it at its tool; None where nobody knows.
    """
    moving = np.abs(target_qd) > _MOVING
    still = np.asarray(~moving.any(axis=1))
    reversing = np.zeros(len(still), dtype=bool)
    for j in range(target_qd.shape[1]):
        rows = np.flatnonzero(moving[:, j])
        turns = rows[1:][np.sign(target_qd[rows[1:], j]) != np.sign(target_qd[rows[:-1], j])]
        for row in turns:
            reversing |= np.abs(truth.time - truth.time[row]) < _TURNING
    motion = {
        "still": still,
        "moving": ~still,
        "reversing": reversing,
        "near_singularity": sigma_min < NEAR_SINGULARITY,
    }
    found = {
        **motion,
        **{f"{name}_touched": rows & truth.touched for name, rows in motion.items()},
        "touched": truth.touched,
        "untouched": ~truth.touched,
    }
    if at_tool is not None:
        found["beyond_tool"] = truth.touched & ~at_tool
    return found


def _errors(estimates: Estimates, truth: Truth, rows: np.ndarray) -> dict[str, Any]:
    found: dict[str, Any] = {"rows": int(rows.sum())}
    names = ("mae", "rmse", "max", "bias", "correlation", *_INTERVALS, "tau_mae_nm")
    if not rows.any():
        return found | dict.fromkeys(names)
    said, true = estimates.wrench[rows], truth.wrench[rows]
    deviation = np.sqrt(np.maximum(np.einsum("nii->ni", estimates.covariance[rows]), 0.0))
    for name, metric in (
        ("mae", metrics.mean_absolute),
        ("rmse", metrics.root_mean_square),
        ("max", metrics.largest),
        ("bias", metrics.bias),
    ):
        found[name] = metric(true, said).tolist()
    spread = true.std(axis=0) * said.std(axis=0)
    together = ((true - true.mean(axis=0)) * (said - said.mean(axis=0))).mean(axis=0)
    found["correlation"] = [float(c / s) if s > 0 else None for c, s in zip(together, spread, strict=True)]
    for name, quantile in _INTERVALS.items():
        found[name] = (np.abs(said - true) <= quantile * deviation).mean(axis=0).tolist()
    torque = np.isfinite(truth.tau_ext[rows]).all(axis=1)
    found["tau_mae_nm"] = (
        metrics.mean_absolute(truth.tau_ext[rows][torque], estimates.tau_ext[rows][torque]).tolist()
        if torque.any()
        else None
    )
    return found


def _episodes(time: np.ndarray, touched: np.ndarray) -> list[tuple[int, int]]:
    """First and last row of each touch; those less than ``_APART`` apart are one."""
    rows = np.flatnonzero(touched)
    if not len(rows):
        return []
    cuts = np.flatnonzero(np.diff(time[rows]) > _APART)
    return list(zip(rows[np.concatenate([[0], cuts + 1])], rows[np.concatenate([cuts, [len(rows) - 1]])], strict=True))
