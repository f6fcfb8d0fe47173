"""What every estimator keeps: no truth, no look ahead, no NaN, names, and a user's own in a few lines."""

from __future__ import annotations

import ast
import math
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

import ur5_twin
import ur5_twin.estimation as package
from ur5_twin.arm.files import model_path
from ur5_twin.control.tcp_force import last_known, viscous_ratio
from ur5_twin.errors import EstimationError, ModelError
from ur5_twin.estimation import (
    Estimator,
    NominalModel,
    Sample,
    create,
    estimate,
    estimator_names,
    load_nominal,
    registry,
    samples_of,
)
from ur5_twin.estimation.motor_torque import PlantTorque
from ur5_twin.estimation.samples import stacked
from ur5_twin.recording import Recording, Table
from ur5_twin.scenario import load_scenario
from ur5_twin.twin.scenario_run import ScenarioRun

SOURCE = Path(package.__file__).parent
#: What holds truth, makes it, or has seen it.
FORBIDDEN = ("twin", "scenario", "sources", "identification", "evaluation", "views", "cli")

OWN = '''
from ur5_twin.estimation.skeleton import MomentumEstimator


class Averager(MomentumEstimator):
    """The external torque, averaged over a tenth of a second."""

    def observe(self, arm):
        self.tau += min(arm.dt / 0.1, 1.0) * (arm.mean - self.tau)
        self.variance[:] = 0.04 * arm.white + arm.bias


class Nothing:
    def __init__(self, nominal):
        pass
'''


def imports(path: Path) -> set[str]:
    """Modules that a file imports, at any depth of it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import hides where it leads"
            assert node.module is not None
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in found if name.startswith("ur5_twin.")}


def file_of(module: str) -> Path | None:
    base = Path(ur5_twin.__file__).parent.joinpath(*module.split(".")[1:])
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file():
            return path
    return None


def test_estimation_reaches_nothing_that_holds_the_truth() -> None:
    """All modules that any module of the package imports, and those import, and so on."""
    waiting, seen = sorted(SOURCE.glob("*.py")), set()
    assert len(waiting) > 10
    while waiting:
        path = waiting.pop()
        if path in seen:
            continue
        seen.add(path)
        for module in imports(path):
            assert module.split(".")[1] not in FORBIDDEN, f"{path} imports {module}"
            if (found := file_of(module)) is not None:
                waiting.append(found)


def test_samples_hold_what_a_real_robot_publishes(run_of) -> None:
    assert not [name for name in Sample._fields if name.startswith(("truth", "sim", "est", "ft"))]
    recording = run_of("push_x")
    assert any(name.startswith("truth") for name in recording.robot.columns)
    columns = {name: values for name, values in recording.robot.columns.items() if not name.startswith("truth")}
    blind = Recording({"robot": replace(recording.robot, columns=columns)}, "blind", "test")
    for a, b in zip(samples_of(recording), samples_of(blind), strict=True):
        for x, y in zip(a, b, strict=True):
            np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("name", estimator_names())
def test_no_estimator_looks_ahead(name: str, nominal: NominalModel, run_of) -> None:
    """What comes later changes nothing of what was said; two runs say the same."""
    samples = list(samples_of(run_of("push_moving")))[:500]
    whole = estimate(create(name, nominal), samples)
    turned = (s._replace(actual_current=-s.actual_current, actual_TCP_force=-s.actual_TCP_force) for s in samples[300:])
    other = [*samples[:300], *turned]
    part = estimate(create(name, nominal), other)
    for field in ("tau_ext", "wrench", "covariance", "contact"):
        np.testing.assert_array_equal(getattr(whole, field)[:300], getattr(part, field)[:300])
    assert not np.array_equal(whole.wrench[300:], part.wrench[300:])


@pytest.mark.parametrize("name", estimator_names())
def test_missing_signals_leave_no_trace_of_nan(name: str, nominal: NominalModel, run_of) -> None:
    """Late and broken packets: NaN here and there, a whole row, the first ones, a stamp twice and a gap of a second."""
    rng = np.random.default_rng(4)
    samples = list(samples_of(run_of("push_moving")))[:700]
    clean = estimate(create(name, nominal), samples)
    nothing = Sample(samples[0].time - 0.008, *(np.full_like(x, np.nan) for x in samples[0][1:]))
    broken = [nothing]
    for k, sample in enumerate(samples):
        if 400 <= k < 520:
            continue
        if k % 9 == 3:
            field = Sample._fields[1 + int(rng.integers(8))]
            values = getattr(sample, field).copy()
            values[rng.integers(6)] = [np.nan, np.inf][k % 2]
            sample = sample._replace(**{field: values})
        if k % 50 == 7:
            sample = nothing._replace(time=sample.time)
        broken.append(sample)
        if k % 40 == 5:
            broken.append(sample)
    broken.append(samples[-1]._replace(time=np.nan))
    found = estimate(create(name, nominal), broken)
    assert np.isfinite(found.wrench).all()
    assert np.isfinite(found.tau_ext).all()
    assert np.isfinite(found.covariance).all()
    assert ((found.contact >= 0) & (found.contact <= 1)).all()
    # Nothing is known before the first sample that can be used.
    assert np.abs(found.wrench[0]).max() == 0.0
    # Neither has it changed what is said in the end by more than a fraction: the gap ends 1.4 s before.
    assert np.abs(found.wrench[-1] - clean.wrench[-1])[:3].max() < 10.0


def test_late_packages_change_nothing(nominal: NominalModel) -> None:
    """Every third package comes with the next one: the controller's stamp says when it was measured."""
    scenario = replace(load_scenario("push_moving"), duration=4.0)
    found = []
    for late in (False, True):
        sensors = replace(scenario.sensors, preset="lab", late_packages=late)
        recording = ScenarioRun(replace(scenario, sensors=sensors)).finish()
        found.append(estimate(create("momentum_observer", nominal), samples_of(recording)).wrench)
    assert "timestamp" in recording.robot
    np.testing.assert_array_equal(found[0], found[1])


def test_a_gap_costs_what_happened_in_it_only(exact: NominalModel, frictionless: Recording) -> None:
    """With every third row lost the momentum observer ends up where it does with all rows."""
    samples = list(samples_of(frictionless))
    whole = estimate(create("momentum_observer", exact), samples)
    thin = estimate(create("momentum_observer", exact), [s for k, s in enumerate(samples) if k % 3 != 1])
    same = np.isin(whole.time, thin.time)
    # Torques of up to 40 Nm; steps twice as long know the current half as often.
    assert np.abs(thin.tau_ext - whole.tau_ext[same]).mean(axis=0).max() < 0.5


def test_names() -> None:
    for name in estimator_names():
        assert isinstance(create(name, load_nominal()), Estimator)
    with pytest.raises(EstimationError, match=r"unknown estimator 'momentum'.*known: accelerometer_aided"):
        registry.factory("momentum")
    with pytest.raises(EstimationError, match="unknown method for whole logs 'direct'"):
        registry.whole_log("direct")


def test_an_estimator_of_ones_own(tmp_path: Path, nominal: NominalModel, wandering: list[Sample]) -> None:
    """From a file, in far less than 30 lines, with all that the others have."""
    path = tmp_path / "mine.py"
    path.write_text(OWN, encoding="utf-8")
    assert len(OWN.split("class Nothing", maxsplit=1)[0].splitlines()) < 30
    found = estimate(create(f"{path}:Averager", nominal), wandering)
    assert np.isfinite(found.wrench).all()
    assert np.abs(found.tau_ext).max() > 1.0
    with pytest.raises(EstimationError, match="unknown class 'Averagr'; did you mean 'Averager'"):
        create(f"{path}:Averagr", nominal)
    with pytest.raises(EstimationError, match="no method update"):
        create(f"{path}:Nothing", nominal)
    with pytest.raises(EstimationError, match="no file"):
        create(f"{tmp_path / 'other.py'}:Averager", nominal)
    path.write_text("import nowhere_at_all", encoding="utf-8")
    with pytest.raises(EstimationError, match="cannot be imported: ModuleNotFoundError"):
        create(f"{path}:Averager", nominal)


def test_other_packages_offer_estimators(monkeypatch: pytest.MonkeyPatch, nominal: NominalModel) -> None:
    point = EntryPoint("theirs", "ur5_twin.estimation.momentum_observer:MomentumObserver", registry.GROUP)
    monkeypatch.setattr(registry, "entry_points", lambda group: [point] if group == registry.GROUP else [])
    assert estimator_names()[-1] == "theirs"
    assert isinstance(create("theirs", nominal), Estimator)


def test_settings_are_checked(tmp_path: Path) -> None:
    text = model_path("estimators.toml").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("forgetting = 0.97", "forgetting = 1.5"), encoding="utf-8")
    with pytest.raises(ModelError, match="forgetting"):
        load_nominal(settings=path)
    path.write_text(text.replace("forgetting = 0.97", "forgettin = 0.97"), encoding="utf-8")
    with pytest.raises(ModelError, match=r"unknown field .*known keys"):
        load_nominal(settings=path)


def test_a_recording_without_currents_is_refused(made_recording: Recording) -> None:
    robot = made_recording.robot
    columns = {name: values for name, values in robot.columns.items() if name != "actual_current"}
    without = Recording({"robot": Table("robot", robot.time, columns)}, "halved", "test")
    with pytest.raises(EstimationError, match="halved: no actual_current; an estimator needs"):
        list(samples_of(without))
    assert len(stacked([], []).wrench) == 0


class TestMotorTorque:
    """The plant's law, from what is published alone."""

    def test_is_the_twins_in_motion(self, run_of) -> None:
        """Against the simulated truth, friction and ripple included, without noise of the sensors."""
        scenario = load_scenario("free_motion")
        recording = run_of("free_motion", "ideal")
        nominal = load_nominal("plant", scenario.arm.tool, sensors="ideal")
        law, found = PlantTorque(nominal), []
        for k, sample in enumerate(samples_of(recording)):
            law.update(sample, 0.0 if k == 0 else 0.008)
            found.append(law.torque.copy())
        truth = recording.robot["truth_moment"] - recording.robot["truth_friction"]
        error = np.abs(np.array(found) - truth)
        moving = np.abs(recording.robot["target_qd"]) > 0.05
        friction = np.abs(recording.robot["truth_friction"])
        for j in range(6):
            # The measured direction differs from the target's where a joint turns back, and speed swings with ripple.
            assert error[moving[:, j], j].mean() < 0.05 * friction[moving[:, j], j].mean()

    def test_at_rest_it_follows_a_push_and_says_what_it_cannot_know(self, run_of) -> None:
        recording = run_of("push_x", "ideal")
        nominal = load_nominal("plant", "ati_gamma", sensors="ideal")
        law, found, spread = PlantTorque(nominal), [], []
        for k, sample in enumerate(samples_of(recording)):
            law.update(sample, 0.0 if k == 0 else 0.008)
            found.append(law.dry.copy())
            spread.append(np.sqrt(law.bias))
        truth = recording.robot["truth_friction"]
        # The push turns friction of joint 1 round; the spring between is in the encoder's steps.
        assert np.ptp(truth[:, 0]) > 2.0
        assert np.abs(np.array(found) - truth)[50:, 0].mean() < 0.25 * np.abs(truth[50:, 0]).mean()
        friction = nominal.drives.friction
        least = np.maximum(friction.coulomb_positive, friction.coulomb_negative) + friction.stribeck
        assert (law.bias >= least**2 / 3.0).all()
        # Uniform within its level: never beyond root three spreads, but for the spring's damping while it slips.
        assert (np.abs(truth) <= math.sqrt(3.0) * np.array(spread) + 0.05)[50:].mean() > 0.98

    def test_temperature_is_the_controllers_own(self, nominal: NominalModel, wandering: list[Sample]) -> None:
        """Sample by sample as for the whole log: the last ratio that target_current showed."""
        rng = np.random.default_rng(2)
        qd, moment = (np.array([getattr(s, name) for s in wandering]) for name in ("target_qd", "target_moment"))
        moment[100:140] = 0.0
        warm = 1.0 + 0.2 * np.sin(np.arange(len(qd)) / 70.0)[:, None]
        law = nominal.law
        plain = law.current(moment, qd)
        viscous = plain - moment / law.torque_constant - law.load * np.abs(moment) * np.sign(qd)
        current = plain + (warm - 1.0) * viscous + 1e-7 * rng.normal(size=qd.shape)
        expected = last_known(viscous_ratio(law, qd, moment, current), np.ones(6))
        drive = PlantTorque(nominal)
        for k, sample in enumerate(wandering):
            drive.update(sample._replace(target_moment=moment[k], target_current=current[k]), 0.0 if k == 0 else 0.008)
            moving = np.abs(qd[k]) > 1e-3
            ratio = drive.viscous / (nominal.drives.friction.viscous * np.where(moving, qd[k], np.nan))
            np.testing.assert_allclose(ratio[moving], expected[k][moving], rtol=1e-12)
        assert np.abs(expected[300] - warm[300]).max() < 0.01
