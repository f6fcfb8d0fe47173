"""Estimators by name: those that ship, those that other packages offer, and a class in a file of the user's."""

from __future__ import annotations

import importlib.util
import inspect
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, cast

from ur5_twin.errors import EstimationError, unknown
from ur5_twin.estimation.nominal import NominalModel
from ur5_twin.estimation.protocol import Estimate, Estimator, Factory, Sample

#: Entry points of other packages: name = "package.module:Class".
GROUP = "ur5_twin.estimators"
#: What makes the estimators that ship.
BUILT_IN: Mapping[str, str] = {
    "controller": "controller:Controller",
    "direct": "direct:Direct",
    "direct_friction": "direct:DirectFriction",
    "filtered_dynamics": "filtered_dynamics:FilteredDynamics",
    "recursive_least_squares": "recursive_least_squares:RecursiveLeastSquares",
    "momentum_observer": "momentum_observer:MomentumObserver",
    "extended_state_observer": "extended_state_observer:ExtendedStateObserver",
    "sliding_mode_observer": "sliding_mode_observer:SlidingModeObserver",
    "disturbance_kalman": "disturbance_kalman:DisturbanceKalman",
    "adaptive_observer": "adaptive_observer:AdaptiveObserver",
    "accelerometer_aided": "accelerometer_aided:AccelerometerAided",
    "friction_kalman": "friction_kalman:FrictionKalman",
}
#: Methods that need the whole log before they say anything about its beginning. They are no estimators.
NOT_CAUSAL: Mapping[str, str] = {
    "direct_zero_phase": "direct:zero_phase",
    "direct_friction_zero_phase": "direct:zero_phase_friction",
}
WholeLog = Callable[[NominalModel, Iterable[Sample]], list[Estimate]]


def estimator_names() -> tuple[str, ...]:
    """Names of the estimators that ship, then of those that installed packages offer."""
    return (*BUILT_IN, *(name for name in sorted(_offered()) if name not in BUILT_IN))


def factory(name: str) -> Factory:
    """What makes the estimator of a name.

    Args:
        name: one of ``estimator_names()``, or ``path/to/file.py:Class``.

    Raises:
        EstimationError: the name is unknown, or there is no such class in the file.
    """
    if name in BUILT_IN:
        return _shipped(BUILT_IN[name])
    offered = _offered()
    if name in offered:
        return _checked(offered[name].load(), name)
    path, _, attribute = name.rpartition(":")
    if path.endswith(".py"):
        return _from_file(Path(path), attribute)
    raise EstimationError(unknown("estimator", name, estimator_names()) + ", or give path/to/file.py:Class")


def create(name: str, nominal: NominalModel) -> Estimator:
    """The estimator of a name, new.

    Raises:
        EstimationError: as ``factory``, or what it makes has no ``update``.
    """
    made = factory(name)(nominal)
    if not isinstance(made, Estimator):
        raise EstimationError(f"{name}: what it makes has no method update(sample) -> Estimate")
    return made


def whole_log(name: str) -> WholeLog:
    """A method of ``NOT_CAUSAL``, by name.

    Raises:
        EstimationError: the name is unknown.
    """
    if name not in NOT_CAUSAL:
        raise EstimationError(unknown("method for whole logs", name, NOT_CAUSAL))
    return _shipped(NOT_CAUSAL[name])


def _shipped(place: str) -> Any:
    module, _, attribute = place.partition(":")
    return getattr(import_module(f"ur5_twin.estimation.{module}"), attribute)


def _offered() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}


def _from_file(path: Path, attribute: str) -> Factory:
    if not path.is_file():
        raise EstimationError(f"no file {path}: an estimator of your own is path/to/file.py:Class")
    spec = importlib.util.spec_from_file_location(f"ur5_twin_estimator_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise EstimationError(f"{path} cannot be imported: it is no Python file")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise EstimationError(f"{path} cannot be imported: {type(error).__name__}: {error}") from error
    found = getattr(module, attribute, None)
    if found is None:
        classes = [key for key, item in vars(module).items() if inspect.isclass(item) and item.__module__ == spec.name]
        raise EstimationError(f"{path.name}: " + unknown("class", attribute, classes))
    return _checked(found, f"{path.name}:{attribute}")


def _checked(found: object, name: str) -> Factory:
    if not callable(found):
        raise EstimationError(f"{name} is no class: an estimator is made from a NominalModel")
    return cast(Factory, found)
