"""``ur5-twin estimate`` as a user runs it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

Run = Callable[..., tuple[int, str, str]]
OWN = '''
from ur5_twin.estimation.skeleton import MomentumEstimator


class Mine(MomentumEstimator):
    """The external torque, averaged over a tenth of a second."""

    def observe(self, arm):
        self.tau += min(arm.dt / 0.1, 1.0) * (arm.mean - self.tau)
        self.variance[:] = 0.04 * arm.white + arm.bias
'''


def test_on_the_demo_by_name_and_by_file(run) -> None:
    Path("mine.py").write_text(OWN, encoding="utf-8")
    code, out, _ = run(
        "estimate", "demo", "--against", "zero", "-e", "friction_kalman", "-e", "mine.py:Mine", "--no-rerun"
    )
    assert code == 0
    assert "written to out/estimate-demo" in out
    report = json.loads(Path("out/estimate-demo/report.json").read_text(encoding="utf-8"))
    assert set(report["wrench"]) == {"friction_kalman", "Mine"}
    for found in report["wrench"].values():
        # Against zero the error is the estimate.
        assert found["mae"] == pytest.approx(found["estimate_mean"])
        assert len(found["percentile_99"]) == 6
        assert found["detection"]["touches"] == 0
    table = pl.read_parquet("out/estimate-demo/recording.parquet")
    assert any("est_friction_kalman_wrench" in name for name in table.columns)
    for name in ("force", "moment", "interval"):
        assert Path(f"out/estimate-demo/figures/{name}.png").stat().st_size > 5_000
    assert "| friction_kalman |" in Path("out/estimate-demo/report.md").read_text(encoding="utf-8")


def test_against_the_truth_of_a_run(run) -> None:
    assert run("run", "push_x", "--no-rerun", "--no-figures", "--out", "push")[0] == 0
    code, out, _ = run(
        "estimate", "push/recording.parquet", "-e", "momentum_observer", "--no-rerun", "--no-figures", "--out", "found"
    )
    assert code == 0
    assert "MAE against truth" in out
    found = json.loads(Path("found/report.json").read_text(encoding="utf-8"))["wrench"]["momentum_observer"]
    # The push is along x; the observer's own law of friction is the plant's.
    assert found["correlation"][0] > 0.9
    assert found["detection"]["found"] >= 1
    assert found["regimes"]["touched"]["rows"] > 100
    assert np.isfinite(found["tau_mae_nm"]).all()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-e", "momentum"], "momentum_observer"),
        (["-e", "nowhere.py:Mine"], "no file nowhere.py"),
        (["--against", "ft"], "no ft_wrench"),
        (["--against", "truth"], "no truth_wrench"),
        (["--current-map", "lap"], "did you mean 'lab'"),
        (["--tool", "hammer"], "ati_gamma"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(run, arguments: list[str], said: str) -> None:
    code, _, err = run("estimate", "demo", *arguments)
    assert code == 2
    assert said in err
    assert err.count("\n") == 1
    assert not Path("out").exists()
