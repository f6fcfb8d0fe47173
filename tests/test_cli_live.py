"""``ur5-twin live`` beside a served cell, with the real client and over the real-time interface."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.estimation.nominal import load_nominal
from ur5_twin.estimation.registry import create
from ur5_twin.estimation.samples import estimate, samples_of
from ur5_twin.recording import read
from ur5_twin.scenario import load_scenario
from ur5_twin.wire.controller import VirtualController
from ur5_twin.wire.server import Server
from ur5_twin.wire.version import version

_PID = os.getpid()
#: ur_rtde knows no port but 30004: a loopback address of this process' own keeps others' robots apart.
HOST = f"127.{128 + (_PID >> 16 & 63)}.{_PID >> 8 & 255}.{max(_PID & 255, 1)}"


def live(*arguments: str, cwd: Path) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "ur5_twin.cli", "live", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )


@pytest.mark.parametrize("way", ["rtde", "realtime"])
def test_beside_a_served_contact(way: str, tmp_path: Path) -> None:
    """The twin follows through a contact; Ctrl-C loses nothing; afterwards the estimates are the same."""
    controller = VirtualController(load_scenario("press_plate"), version("3.x"))
    with Server(controller, bind=HOST):
        process = live(
            HOST, "--port", way, "--tool", "ati_gamma+ball_probe", "-o", "out", "--save", "twin.rrd", cwd=tmp_path
        )
        journal = tmp_path / "out" / "recording.journal"
        began = time.monotonic()
        while time.monotonic() - began < 60.0 and process.poll() is None:
            time.sleep(0.25)
            # Some seconds of rows have reached the file.
            if journal.exists() and journal.stat().st_size > 2_000_000:
                break
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    assert "written to out" in out
    assert not journal.exists()
    recording = read(tmp_path / "out")
    robot = recording.robot
    assert len(robot) > 300
    assert (tmp_path / "twin.rrd").stat().st_size > 100_000
    offline = estimate(create("friction_kalman", load_nominal("plant", "ati_gamma+ball_probe")), samples_of(recording))
    np.testing.assert_array_equal(robot["est_friction_kalman_wrench"], offline.wrench)
    off = np.nan_to_num(np.abs(robot["sim_actual_q"] - robot["actual_q"]))
    # Free of contact the twin is within milliradians; pressed, as far as the plate yields.
    assert np.median(off) < 5e-3
    assert off.max() < 0.05


def test_nobody_there_is_said(tmp_path: Path) -> None:
    process = live("127.0.0.1", "--port", "1", cwd=tmp_path)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "no connection" in err
    assert not (tmp_path / "out").exists()
    process = live("127.0.0.1", "--port", "telepathy", cwd=tmp_path)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "--port telepathy" in err
