"""The map from torque and motion to the measured current, with the gears' ripple and what rest remembers.

Per joint, with kept() and passed() of ``drives.terms``::

    i = kept(tau / k + friction) + ripple(q) [+ sticking(q) + passed(i_target + PID(error))]

- tau is the plant's inverse dynamics of the target motion; friction is Coulomb (per direction), load-dependent, viscous
  with the controller's own correction for temperature, and falls towards standstill; kept() lets a joint at rest
  remember the friction it stopped with.
- ripple has whole periods per revolution of the joint: 404 (four per motor turn at gear 101) and its neighbours for the
  small joints, 200, 202 and 404 for the big ones. It stays at rest, where it is a constant that depends on the angle.
- the bracket is what the measured position tells: friction of a joint at rest that is moved on its grip, by tens of
  microradians, turns to oppose them; and the servo, feed-forward and the answer to the position error, of which only
  the fast part counts while the joint moves. A joint whose ``Shape.sticking`` or ``Shape.servo`` is false does without.

With the bracket the map predicts big joints best, and it contains every push: an estimator of contact does without.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ur5_twin.arm import files
from ur5_twin.arm.drive import LinearDrive, load_drive
from ur5_twin.arm.parameters import N_JOINTS, ArmModel, load_model
from ur5_twin.drives import terms
from ur5_twin.errors import ModelError, unknown

_KINDS = (("current_maps.toml", files.CurrentMapSpec), ("drives.toml", files.DriveSpec))
#: Rows before the first move whose mean current tells what the joints remember of earlier moves, 80 ms.
_TARE_ROWS = 10
#: Time constant with which that is forgotten once a joint moves, s.
_TARE_FORGOTTEN = 0.1
#: A joint at rest for ever forgets nothing, s.
_NEVER = 1e9


class Shape(NamedTuple):
    """How a joint's terms remember and see the ripple. Times in s.

    Attributes:
        servo: whether the servo's answer to the measured position error is in it.
        moving: of kept() and passed() while the joint moves.
        forgetting, servo_forgetting: of kept() and of passed() while it rests.
        averages: time constants of the averaged position error.
        integral: whether the servo has an integral.
        orders: of the ripple, periods per revolution.
        delay, lag: of the ripple's answer in the current.
        directed: whether the ripple differs with the direction.
        sticking: whether friction turns where the joint is moved at rest.
    """

    servo: bool
    moving: float
    forgetting: float
    servo_forgetting: float
    averages: tuple[float, ...]
    integral: bool
    orders: tuple[int, ...]
    delay: float
    lag: float
    directed: bool
    sticking: bool

    def names(self) -> list[str]:
        """Names of the coefficients, in the order of ``columns``."""
        servo = terms.servo_names(self.averages, self.integral) if self.servo else []
        sticking = ["sticking"] if self.sticking else []
        return [*terms.friction_names(), *sticking, *servo, *terms.ripple_names(self.orders, directed=self.directed)]


#: A joint sticks with what it stopped with: for SETTLING s after a stop the slow part of the error forgets in
#: SETTLING_TIME s.
SETTLING, SETTLING_TIME = 0.1, 0.05
#: Way on which a resting joint's friction forgets itself and takes up the level that opposes the way, rad. The free
#: logs of the lab's arm are the likelier the longer it is, up to here; beyond, hardly.
TURNING = 1e-4


class Residual(NamedTuple):
    """How a joint's map is wrong on logs it has not seen: standard deviations in A and time constants in s.

    Attributes:
        slow, slow_time, fast, fast_time: of the two parts of the error while the joint moves.
        rest_slow, rest_slow_time, rest_fast, rest_fast_time: while it rests.
        turned: level of a resting joint's friction behind a displacement, A; both the mean and the spread of what it
            turns to.
    """

    slow: float
    slow_time: float
    fast: float
    fast_time: float
    rest_slow: float
    rest_slow_time: float
    rest_fast: float
    rest_fast_time: float
    turned: float


@dataclass(frozen=True)
class CurrentMap:
    """Coefficients of the map.

    Attributes:
        name: of the preset, or the file's.
        source: where the numbers come from.
        model: name of the rigid-body model that gives tau.
        torque_constant: (6,) known torque constants that 1/k is measured from, Nm/A.
        shapes: per joint.
        coefficients: per joint, in the order of ``Shape.names``.
        errors: their standard errors.
        residuals: per joint, how the map errs; none of a map that has not been tried on other logs.
    """

    name: str
    source: str
    model: str
    torque_constant: np.ndarray
    shapes: tuple[Shape, ...]
    coefficients: tuple[np.ndarray, ...]
    errors: tuple[np.ndarray, ...]
    residuals: tuple[Residual, ...]

    def __post_init__(self) -> None:
        if not (self.torque_constant > 0).all():
            raise ModelError(f"{self.name}: torque constants must be positive, not {self.torque_constant} Nm/A")
        for j, (shape, found) in enumerate(zip(self.shapes, self.coefficients, strict=True), start=1):
            if len(found) != len(shape.names()):
                raise ModelError(
                    f"{self.name}: joint {j} has {len(found)} coefficients, its terms {len(shape.names())}: "
                    f"{', '.join(shape.names())}"
                )

    def rigid(self) -> ArmModel:
        """The rigid bodies that the map was fitted with, nothing at the flange."""
        return load_model(self.model)

    def current(self, of: terms.Ride) -> np.ndarray:
        """Expected actual_current (n, 6) in A; row k uses rows up to k only, and no measured current."""
        predicted = np.empty_like(of.angle)
        for j, (shape, x) in enumerate(zip(self.shapes, self.coefficients, strict=True)):
            made, known = columns(of, j, shape, self.torque_constant[j])
            predicted[:, j] = known + made @ x
        return predicted


def columns(of: terms.Ride, j: int, shape: Shape, constant: float) -> tuple[np.ndarray, np.ndarray]:
    """What joint j's coefficients multiply (n, m), and the current (n,) that is known without them, A."""
    slow = terms.kept(terms.friction_columns(of, j), terms.leak(of, j, shape.moving, shape.forgetting))
    known = slow[:, 0] / constant
    made = [slow]
    if shape.sticking:
        made.append(terms.sticking_column(of, j))
    if shape.servo:
        a = terms.leak(of, j, shape.moving, shape.servo_forgetting)
        made.append(terms.passed(terms.servo_columns(of, j, shape.averages, shape.integral), a))
        known = known + terms.passed(of.feed_forward[:, j : j + 1], a)[:, 0]
    made.append(terms.ripple_columns(of, j, shape.orders, shape.delay, shape.lag, directed=shape.directed))
    return np.concatenate(made, axis=1), known


def start(of: terms.Ride, j: int, values: np.ndarray) -> np.ndarray:
    """What ``values`` (n,) or (n, m) are at the log's start, forgotten as joint j moves; the shape of ``values``."""
    memory = np.cumprod(1.0 - terms.leak(of, j, _TARE_FORGOTTEN, _NEVER))
    return np.multiply.outer(memory, values[:_TARE_ROWS].mean(axis=0))


def load_current_map(name: str | Path = "lab") -> CurrentMap:
    """A map by name (``models/current_maps.toml``) or from a file with one table of the same keys.

    Raises:
        ModelError: the name is unknown or the file is wrong.
    """
    key, spec = files.choose(name, "current_maps.toml", files.CurrentMapSpec, "drive")
    shapes = []
    for j, joint in enumerate(spec.joint, start=1):
        shape = Shape(
            joint.servo,
            joint.moving_s,
            joint.forgetting_s,
            joint.servo_forgetting_s,
            joint.averages_s,
            joint.integral,
            joint.orders,
            joint.delay_s,
            joint.lag_s,
            joint.directed,
            joint.sticking,
        )
        if list(joint.terms) != shape.names():
            raise ModelError(f"{key}: joint {j}'s terms are {list(joint.terms)}, expected {shape.names()}")
        shapes.append(shape)
    return CurrentMap(
        name=key,
        source=spec.source,
        model=spec.model,
        torque_constant=np.array(spec.torque_constant_nm_a),
        shapes=tuple(shapes),
        coefficients=tuple(np.array(joint.coefficients) for joint in spec.joint),
        errors=tuple(np.array(joint.standard_errors) for joint in spec.joint),
        residuals=tuple(_residual(joint) for joint in spec.joint),
    )


def _residual(joint: files.JointCurrentSpec) -> Residual:
    parts = (joint.error_moving, joint.error_at_rest)
    numbers = [x for part in parts for x in (part.slow_a, part.slow_s, part.fast_a, part.fast_s)]
    return Residual._make([*numbers, joint.turned_a])


def load_drive_map(name: str | Path) -> CurrentMap | LinearDrive:
    """A map of either kind: a preset of ``current_maps.toml`` or ``drives.toml`` by name, or a file like one of them.

    Raises:
        ModelError: the name is unknown or the file is wrong.
    """
    maps, linear = (files.read_named(file, kind) for file, kind in _KINDS)
    key = str(name).lower().replace("-", "_")
    if key in linear:
        return load_drive(name)
    if key in maps:
        return load_current_map(name)
    if Path(name).suffix != ".toml":
        raise ModelError(unknown("drive", str(name), [*maps, *linear]) + ", or give the path of a .toml file")
    is_map = any(isinstance(of, dict) and "joint" in of for of in files.load(Path(name)).values())
    return load_current_map(name) if is_map else load_drive(name)


def table(of: CurrentMap) -> dict[str, object]:
    """A map in the layout of a table of ``models/current_maps.toml``, coefficients to six digits."""
    if not of.residuals:
        raise ModelError(f"{of.name} does not say how it errs: it has not been tried on logs")
    joints = []
    for shape, found, errors, residual in zip(of.shapes, of.coefficients, of.errors, of.residuals, strict=True):
        parts = [
            dict(zip(("slow_a", "slow_s", "fast_a", "fast_s"), (float(f"{x:.3g}") for x in part), strict=True))
            for part in (residual[:4], residual[4:8])
        ]
        joints.append(
            {
                "servo": shape.servo,
                "moving_s": shape.moving,
                "forgetting_s": shape.forgetting,
                "servo_forgetting_s": shape.servo_forgetting,
                "averages_s": list(shape.averages),
                "integral": shape.integral,
                "orders": list(shape.orders),
                "delay_s": shape.delay,
                "lag_s": shape.lag,
                "directed": shape.directed,
                "sticking": shape.sticking,
                "terms": shape.names(),
                "coefficients": [float(f"{x:.6g}") for x in found],
                "standard_errors": [float(f"{x:.2g}") for x in errors],
                "error_moving": parts[0],
                "error_at_rest": parts[1],
                "turned_a": float(f"{residual.turned:.3g}"),
            }
        )
    assert len(joints) == N_JOINTS
    return {
        "source": of.source,
        "model": of.model,
        "torque_constant_nm_a": of.torque_constant.tolist(),
        "joint": joints,
    }
