"""The benchmark: results that do not depend on who does them, that survive being killed, and sums done by hand."""

from __future__ import annotations

import json
import math
import pickle
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from ur5_twin.arm import kinematics
from ur5_twin.arm.files import model_path
from ur5_twin.arm.parameters import load_model
from ur5_twin.drives.current_map import load_current_map, table
from ur5_twin.errors import BenchmarkError, EstimationError, ModelError, ScenarioError
from ur5_twin.evaluation.benchmark import executor, lab_logs, preparation, report, task
from ur5_twin.evaluation.benchmark import run as benchmark
from ur5_twin.evaluation.benchmark.arms import with_arm
from ur5_twin.evaluation.benchmark.leaderboard import LEVER, error, leaderboard, pooled
from ur5_twin.evaluation.benchmark.store import Store
from ur5_twin.evaluation.benchmark.suite import Suite, load_suite
from ur5_twin.evaluation.benchmark.variation import varied
from ur5_twin.evaluation.reporting import render_json
from ur5_twin.evaluation.scores import Truth
from ur5_twin.scenario import MoveJ, load_scenario

_TINY = """
[level.odd]
source = "a test"
friction = 0.1
torque_constant = 0.01
link_mass = 0.01
link_center = 0.01
ripple_phase_rad = 0.1
extra_mass_kg = 0.1
extra_mass_height_mm = 50.0
coldest_s = 0.0

[suite.tiny]
title = "A short push"
scenarios = ["short.toml"]
levels = ["none", "odd"]
seeds = 1
first_seed = 3
estimators = ["momentum_observer", "friction_kalman"]
"""
_SHORT = """
title = "A push"
description = "For a test."
duration_s = 1.2

[arm]
tool = "ati_gamma"
declared_payload = "ati_gamma"

[[push]]
at_s = 0.6
profile = "ramp"
duration_s = 0.5
rise_s = 0.1
force_n = [20.0, 0.0, 0.0]
"""


@pytest.fixture
def tiny(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Suite:
    """Two runs of a second; the drives are those that ship, as their identification takes a quarter of a minute."""
    (tmp_path / "tiny.toml").write_text(_TINY)
    (tmp_path / "short.toml").write_text(_SHORT)

    def shipped(folder: Path, progress: Callable[[int], object] = lambda done: None) -> Path:
        home = folder / "nominal" / "shipped"
        home.mkdir(parents=True, exist_ok=True)
        lines = model_path("drives.toml").read_text()
        (home / "thesis.toml").write_text(lines)
        (home / "joints.toml").write_text(model_path("ur5_joints.toml").read_text())
        (home / "drive.toml").write_text(tomli_w.dumps({"lab": table(load_current_map("lab"))}))
        return home

    monkeypatch.setattr(preparation, "prepare", shipped)
    return load_suite(tmp_path / "tiny.toml")


class Counting:
    """Does the tasks here and counts them."""

    def __init__(self) -> None:
        self.done = 0

    def run(self, work: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        for item in tasks:
            self.done += 1
            # As an engine on other machines would send them.
            yield item, json.loads(json.dumps(work(pickle.loads(pickle.dumps(item)))))


def test_the_board_is_the_same_bit_for_bit_whoever_does_the_tasks(tiny: Suite, tmp_path: Path) -> None:
    here = benchmark.run(tiny, tmp_path / "a", executor.Serial())
    there = benchmark.run(tiny, tmp_path / "b", executor.Processes(2))
    assert render_json(here.board) == render_json(there.board)
    assert here.board["runs"] == 2
    # The arm that was changed is another arm.
    one, other = (here.board["levels"][name]["estimators"]["momentum_observer"]["mae"] for name in ("none", "odd"))
    assert one != other
    # What a sample took is measured and no part of the board.
    assert set(here.microseconds) == set(tiny.estimators)
    assert "microseconds" not in render_json(here.board)


def test_a_killed_run_goes_on_without_loss_or_repetition(tiny: Suite, tmp_path: Path) -> None:
    folder = tmp_path / "killed"

    def kill(done: int, of: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        benchmark.run(tiny, folder, Counting(), progress=kill)
    assert len(Store(folder)) == 1
    with pytest.raises(BenchmarkError, match="1 finished runs: go on with them by --resume"):
        benchmark.run(tiny, folder, Counting())
    rest = Counting()
    resumed = benchmark.run(tiny, folder, rest, resume=True)
    assert rest.done == 1
    assert render_json(resumed.board) == render_json(benchmark.run(tiny, tmp_path / "whole").board)
    # Nothing is left to do, and another seed is another task.
    again, more = Counting(), Counting()
    benchmark.run(tiny, folder, again, resume=True)
    benchmark.run(tiny.with_options(seeds=2), folder, more, resume=True)
    assert (again.done, more.done) == (0, 2)


def test_keys_follow_what_a_result_depends_on(tiny: Suite, tmp_path: Path) -> None:
    nominal = preparation.prepare(tmp_path)

    def keys(of: Suite) -> set[str]:
        return {item.key for item in task.tasks_of(of, nominal)}

    before = keys(tiny)
    assert len(before) == 2
    assert keys(tiny) == before
    assert not keys(tiny.with_options(estimators=("controller",))) & before
    (tmp_path / "short.toml").write_text(_SHORT.replace("20.0", "21.0"))
    changed = keys(tiny)
    assert not changed & before
    drives = nominal / "thesis.toml"
    drives.write_text(drives.read_text().replace("7.5", "7.6"))
    assert not keys(tiny) & changed


def test_an_estimator_of_somebody_elses_is_ranked_and_its_file_is_in_the_key(tiny: Suite, tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    code = (
        "from ur5_twin.estimation.momentum_observer import MomentumObserver\n"
        "class Mine(MomentumObserver):\n    '''The same.'''\n"
    )
    file.write_text(code)
    mine = tiny.with_options(estimators=(f"{file}:Mine", "momentum_observer"))
    found = benchmark.run(mine, tmp_path / "out").board["levels"]["odd"]["estimators"]
    assert found["Mine"]["mae"] == found["momentum_observer"]["mae"]
    before = task.tasks_of(mine, tmp_path / "out")[0].key
    file.write_text(code.replace("The same", "Another"))
    assert task.tasks_of(mine, tmp_path / "out")[0].key != before


def made_result(scenario: str, rows: int, mae: float, delays: list[float], false: int) -> dict[str, Any]:
    part = {
        "rows": rows,
        "mae": [mae] * 3 + [mae / 10] * 3,
        "bias": [0.0] * 6,
        "rmse": [mae] * 6,
        "max": [2 * mae] * 6,
        "coverage_90": [0.9] * 6,
        "coverage_95": [1.0] * 6,
    }
    nothing = {"rows": 0, **dict.fromkeys(name for name in part if name != "rows")}
    hits = {"touches": len(delays) + 1, "found": len(delays), "missed": 1, "false_alarms": false}
    score = {
        **part,
        "regimes": {"still": part, "moving": nothing},
        "detection": {**hits, "delays_s": delays, "hours": 0.5},
    }
    worse = score | {"mae": [9.0] * 6}
    return {"scenario": scenario, "level": "odd", "seed": 0, "estimators": {"b": score, "a": worse}}


def test_sums_of_the_board_by_hand() -> None:
    records = [
        ("k2", made_result("two", 300, 4.0, [0.3], 1)),
        ("k1", made_result("one", 100, 2.0, [0.1, 0.2], 0)),
        ("k3", {"scenario": "three", "level": "odd", "seed": 0, "failure": "it fell over"}),
    ]
    board = leaderboard(records, {"levels": {"odd": {}}})
    assert board == leaderboard(reversed(records), {"levels": {"odd": {}}})
    assert board["failed"] == [{"scenario": "three", "level": "odd", "seed": 0, "failure": "it fell over"}]
    assert board["runs"] == 2
    level = board["levels"]["odd"]
    assert level["ranking"] == ["b", "a"]
    b = level["estimators"]["b"]
    # (100 * 2 + 300 * 4) / 400, and the root of (100 * 4 + 300 * 16) / 400.
    assert b["mae"] == pytest.approx([3.5] * 3 + [0.35] * 3)
    assert b["rmse"] == pytest.approx([math.sqrt(13.0)] * 6)
    assert b["largest"] == [8.0] * 6
    # Half of 3.5 N and half of 0.35 Nm over 0.2 m.
    assert LEVER == 0.2
    assert b["error_n"] == pytest.approx(0.5 * 3.5 + 0.5 * 0.35 / 0.2)
    assert b["scenarios"]["one"]["mae"][0] == 2.0
    assert b["regimes"]["still"]["rows"] == 400
    assert b["regimes"]["moving"]["mae"] is None
    hits = b["detection"]
    assert [hits[name] for name in ("touches", "found", "missed", "false_alarms")] == [5, 3, 2, 1]
    # Of 0.1, 0.2 and 0.3 s; a tenth of the last step below the last.
    assert hits["delay_s"] == pytest.approx([0.2, 0.29])
    assert hits["false_alarms_per_hour"] == 1.0
    assert error(None) is None
    assert pooled([])["mae"] is None
    made = report.sections(
        board | {"suite": {**_about(), "levels": {"odd": {"source": "a test"}}}, "key": "0" * 64}, {"b": 12.0}
    )
    page = report.render_html(made, [])
    assert "it fell over" in page
    assert "src=" not in page
    assert "| b | 2.62 | 3.50 |" in report.render_markdown(made, [])


def _about() -> dict[str, Any]:
    return {"name": "made", "title": "Made up", "scenarios": ["one"], "seeds": [0], "versions": {}}


def test_tau_of_orders() -> None:
    one = {"a": 1.0, "b": 2.0, "c": 3.0}
    assert lab_logs.tau(one, one) == pytest.approx(1.0)
    assert lab_logs.tau(one, {"c": 1.0, "b": 2.0, "a": 3.0}) == pytest.approx(-1.0)
    # One of three pairs the other way round.
    assert lab_logs.tau(one, {"a": 1.0, "c": 2.0, "b": 3.0}) == pytest.approx(1.0 / 3.0)


def test_a_contact_beyond_the_tool_is_the_wrench_with_its_torques() -> None:
    arm, rng = load_model("plant", "ati_gamma"), np.random.default_rng(0)
    q = np.array([load_scenario("push_x").q_start] * 2)
    wrench = rng.normal(size=(2, 6))
    tau = np.einsum("nij,ni->nj", kinematics.jacobian(arm, q), wrench)
    truth = Truth("truth", np.arange(2.0), np.full((2, 6), 7.0), tau, np.array([True, True]))
    found = task.at_flange(truth, arm, q, np.array([True, False])).wrench
    assert (found[0] == 7.0).all()
    # Solved through a Jacobian whose condition number is some tens.
    np.testing.assert_allclose(found[1], wrench[1], atol=1e-12)
    singular = np.zeros((2, 6))
    assert np.isnan(task.at_flange(truth, arm, singular, np.array([True, False])).wrench[1]).all()


def test_arms_and_variations_of_a_seed() -> None:
    suite, of = load_suite("full"), load_scenario("push_moving")
    arms = {name: with_arm(of, level, 5) for name, level in suite.levels.items()}
    assert arms["none"].payloads == ()
    np.testing.assert_array_equal(arms["none"].mismatch.friction_scale, 1.0)
    for scale, share in (("friction_scale", "friction"), ("torque_constant_scale", "torque_constant")):
        large, small = (getattr(arms[name].mismatch, scale) - 1.0 for name in ("large", "small"))
        limit = getattr(suite.levels["large"], share)
        assert np.abs(large).max() <= limit
        # Four times as far in the same direction, to rounding of 1 + x.
        np.testing.assert_allclose(large, 4.0 * small, atol=1e-12)
    assert 0.0 < arms["large"].payloads[0].mass <= 0.05
    one, same, other = varied(of, 5), varied(of, 5), varied(of, 6)
    np.testing.assert_array_equal(one.pushes[0].peak, same.pushes[0].peak)  # type: ignore[union-attr]
    assert (one.pushes[0].peak != other.pushes[0].peak).any()  # type: ignore[union-attr]
    # The motion is turned as a whole: its first and its last posture stay as far apart.
    ends = [[m.q for m in scenario.motions if isinstance(m, MoveJ)] for scenario in (of, one)]
    np.testing.assert_allclose(ends[0][-1] - ends[0][0], ends[1][-1] - ends[1][0], atol=1e-12)
    assert one.q_start[0] != of.q_start[0]
    pressed = varied(load_scenario("press_plate"), 5)
    np.testing.assert_array_equal(pressed.q_start, load_scenario("press_plate").q_start)
    assert pressed.obstacles[0].stiffness != load_scenario("press_plate").obstacles[0].stiffness


def test_nothing_touches_the_arm_while_its_drives_are_identified() -> None:
    recording = preparation.free_motion(0)
    assert "contact" not in recording.tables
    # Every joint moves for long: nothing could be told of one that does not.
    assert ((np.abs(recording.robot["target_qd"]) > 0.01).sum(axis=0) > 2000).all()


@pytest.mark.slow
def test_the_drives_that_estimators_get_are_near_the_simulated_ones(tmp_path: Path) -> None:
    nominal = preparation.nominal(preparation.prepare(tmp_path), "ati_gamma")
    truth = load_model("plant", "ati_gamma")
    from ur5_twin.arm.drive import drives_of

    # Joint 6 carries nothing, and its constant shows in its own inertia only.
    np.testing.assert_allclose(nominal.drives.torque_constant, drives_of(truth).torque_constant, rtol=0.15)


@pytest.mark.parametrize(
    ("change", "error_type", "said"),
    [
        (('["short.toml"]', '["push_q"]'), ScenarioError, "unknown scenario 'push_q'"),
        (('"odd"]\nseeds', '"huge"]\nseeds'), BenchmarkError, "unknown level 'huge'"),
        (('"momentum_observer", ', '"momentum_obs", '), EstimationError, "did you mean 'momentum_observer'"),
        (("seeds = 1", "seeds = 0"), ModelError, "seeds"),
        (("friction = 0.1", "frictoin = 0.1"), ModelError, "frictoin"),
        (('["short.toml"]', "[]"), BenchmarkError, "no scenarios"),
    ],
)
def test_suites_that_cannot_be(tmp_path: Path, change: tuple[str, str], error_type: type[Exception], said: str) -> None:
    (tmp_path / "short.toml").write_text(_SHORT)
    assert change[0] in _TINY
    (tmp_path / "bad.toml").write_text(_TINY.replace(*change))
    with pytest.raises(error_type, match=said):
        load_suite(tmp_path / "bad.toml")


def test_names_that_cannot_be() -> None:
    with pytest.raises(BenchmarkError, match="did you mean 'quick'"):
        load_suite("quik")
    with pytest.raises(EstimationError, match="unknown estimator"):
        load_suite("quick").with_options(estimators=("nobody",))
