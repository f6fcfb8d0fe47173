"""``ur5-twin live`` as its users run it, beside the virtual controller and beside a stream that was made."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.estimation import create, estimate, load_nominal, samples_of
from ur5_twin.evaluation.estimate_report import estimate_columns
from ur5_twin.recording import read
from ur5_twin.scenario import load_scenario
from ur5_twin.wire.controller import VirtualController
from ur5_twin.wire.server import Server, port_names
from ur5_twin.wire.version import version


@pytest.fixture
def served() -> Iterator[int]:
    """A scenario behind free ports; the port of its real-time interface."""
    controller = VirtualController(load_scenario("press_plate"), version("3.x"))
    with Server(controller, ports=dict.fromkeys(port_names(controller.version), 0)) as server:
        yield server.addresses["realtime"][1]


def started(folder: Path, port: int, *options: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "ur5_twin.cli", "live", "127.0.0.1", "--port", str(port), "--out", str(folder)]
    return subprocess.Popen(
        [*command, *map(str, options)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ
    )


def wait_for_rows(folder: Path, size: int = 150_000) -> None:
    end = time.monotonic() + 40.0
    journal = folder / "recording.journal"
    while time.monotonic() < end and not (journal.exists() and journal.stat().st_size > size):
        time.sleep(0.05)


def test_a_run_leaves_a_recording_that_says_the_same_again(
    run: Callable[..., tuple[int, str, str]], served: int, tmp_path: Path
) -> None:
    arguments = ("127.0.0.1", "--port", served, "--out", "out", "--tool", "ati_gamma+ball_probe", "--duration", 4)
    code, out, err = run("live", *arguments, "--save", "live.rrd")
    assert (code, "written to out" in out) == (0, True), err
    assert (tmp_path / "live.rrd").stat().st_size > 100_000
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["recording.parquet", "report.json"]
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    log = read(tmp_path / "out")
    assert report["counts"]["rows"] == len(log.robot)
    assert report["counts"]["lost"] == 0
    nominal = load_nominal(tool="ati_gamma+ball_probe")
    again = estimate_columns("k", estimate(create("friction_kalman", nominal), samples_of(log)))
    for what in ("wrench", "tau_ext", "deviation", "contact"):
        np.testing.assert_array_equal(log.robot[f"est_friction_kalman_{what}"], again[f"est_k_{what}"])
    # The twin follows the served arm.
    off = np.abs(log.robot["actual_q"] - log.robot["sim_actual_q"])
    assert np.nanmax(off) < 5e-3
    assert run("live", *arguments)[0] == 2  # what was measured is never written over


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_in_order(served: int, tmp_path: Path, how: signal.Signals) -> None:
    process = started(tmp_path / "out", served, "--mode", "none", "-e", "none")
    wait_for_rows(tmp_path / "out")
    process.send_signal(how)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    assert "written to" in out
    assert "Traceback" not in err
    assert len(read(tmp_path / "out").robot) > 100


def test_killed_at_any_moment_what_came_is_readable(served: int, tmp_path: Path) -> None:
    process = started(tmp_path / "out", served, "--mode", "none", "-e", "direct")
    wait_for_rows(tmp_path / "out")
    process.kill()
    process.communicate(timeout=30)
    log = read(tmp_path / "out")
    assert len(log.robot) > 100
    assert "est_direct_wrench" in log.robot


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--port", "carrier-pigeon"), "none of auto, rtde, realtime and no TCP port"),
        (("--port", "1"), "127.0.0.1:1: no real-time interface"),
        (("--estimator", "kalman"), "unknown estimator 'kalman'"),
        (("--model", "z"), "unknown"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    run: Callable[..., tuple[int, str, str]], arguments: tuple[str, ...], said: str
) -> None:
    code, _, err = run("live", "127.0.0.1", *arguments)
    assert code == 2
    assert said in err
    assert len(err.strip().splitlines()) == 1
