"""``ur5-twin record`` as its users run it, beside the virtual controller and the sensors of its cell."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from ur5_twin.live.watch import ARRIVAL
from ur5_twin.recording import read, read_parquet_metadata
from ur5_twin.scenario import load_scenario
from ur5_twin.wire.controller import VirtualController
from ur5_twin.wire.sensors import NUMBERS, sensor_ports
from ur5_twin.wire.server import Server, port_names
from ur5_twin.wire.version import version

#: What a recording costs in bytes a second, with three devices: enough of it is some seconds.
_SOME = 100_000


class Cell(NamedTuple):
    """A served cell: what the command line is told, and the controller itself."""

    arguments: tuple[object, ...]
    script_port: int
    controller: VirtualController


def serve(series: str, *, run: bool) -> Iterator[Cell]:
    scenario = load_scenario("free_motion")
    both = replace(scenario, arm=replace(scenario.arm, tool="ati_gamma+xsens_mti"))
    controller = VirtualController(both, version(series), run=run)
    ports = dict.fromkeys(port_names(controller.version), 0)
    devices = sensor_ports(both, numbers=dict.fromkeys(NUMBERS, 0))
    with Server(controller, ports=ports, devices=devices) as server:
        found = server.addresses
        host, udp, page = found["net_ft"]
        arguments = (host, "--port", found["realtime"][1], "--ft", f"{host}:{udp},{page}", "--imu", found["mti"])
        yield Cell(arguments, server.addresses["secondary"][1], controller)


@pytest.fixture(scope="module")
def still() -> Iterator[Cell]:
    """A cell whose arm waits at its start."""
    yield from serve("3.x", run=False)


def started(cell: Cell, folder: Path, *options: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "ur5_twin.cli", "record", *cell.arguments, "--out", folder, *options]
    return subprocess.Popen(
        [str(word) for word in command],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ,
    )  # fmt: skip


def wait_for_rows(folder: Path, size: int = _SOME) -> None:
    end = time.monotonic() + 40.0
    journal = folder / "recording.journal"
    while time.monotonic() < end and not (journal.exists() and journal.stat().st_size > size):
        time.sleep(0.05)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_however_it_ends_what_was_recorded_can_be_read(still: Cell, tmp_path: Path, how: signal.Signals) -> None:
    process = started(still, tmp_path / "out")
    wait_for_rows(tmp_path / "out")
    process.send_signal(how)
    out, err = process.communicate(timeout=60)
    log = read(tmp_path / "out")
    assert set(log.tables) == {"robot", "ft", "imu"}, err
    # Rows as they were, one a tick, one a sample.
    np.testing.assert_allclose(np.diff(log.robot.time), 0.008, atol=1e-9)
    assert (np.diff(log.tables["ft"].time) > 0).all()
    np.testing.assert_allclose(np.diff(log.tables["imu"].time), 433 / 115200, rtol=1e-9)
    for table in log.tables.values():
        # Its clock and its rows' arrivals agree, but for what a busy machine does.
        assert table.host_start is not None
        assert np.abs(table[ARRIVAL][:, 0] - table.host_start - table.time).min() < 1.0
    names = {path.name for path in (tmp_path / "out").iterdir()}
    if how is signal.SIGKILL:
        assert names == {"recording.journal"}
        return
    assert (process.returncode, names) == (0, {"recording.parquet", "log"}), err
    assert "written to" in out
    assert "record" in read_parquet_metadata(tmp_path / "out" / "recording.parquet")["command"]
    lab = read(tmp_path / "out" / "log")
    assert len(lab.robot) == len(log.robot)
    assert set(lab.tables) == {"robot", "ft", "imu"}


def test_a_waypoint_file_runs_once_somebody_said_yes(
    still: Cell, run: Callable[..., tuple[int, str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = np.asarray(still.controller.state.signals["actual_q"])
    goal = start + np.array([0.3, 0.1, 0.0, 0.0, 0.0, 0.2])
    file = tmp_path / "points.txt"
    file.write_text(
        "joint_space 1.0\n" + "".join(f"movej([{', '.join(map(str, q.tolist()))}])\n" for q in (start, goal))
    )

    def record(answer: str, out: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "stdin", io.StringIO(answer))
        return run("record", *still.arguments, "--program", file, "--script-port", still.script_port, "--out", out)

    for answer in ("Yes\n", "\n", ""):
        code, _, err = record(answer, "no")
        assert (code, err) == (130, "ur5-twin: stopped\n")
        assert not (tmp_path / "no").exists()
    assert not np.asarray(still.controller.state.signals["target_qd"]).any()
    code, out, err = record("yes\n", "out")
    assert code == 0, err
    assert "where the arm is" in out
    log = read(tmp_path / "out")
    assert any("points.txt: done" in str(note) for note in log.notes)
    # The start was read from the encoders, whose steps are 9 and 16 urad; targets are whole steps too.
    np.testing.assert_allclose(log.robot["target_q"][0], start, atol=3e-5)
    np.testing.assert_allclose(log.robot["target_q"][-1], goal, atol=1e-5)
    # Rest before and after.
    assert not log.robot["target_qd"][:50].any()
    assert not log.robot["target_qd"][-50:].any()
    # The arm is not at the start any more.
    code, _, err = record("yes\n", "again")
    assert code == 2
    assert "the arm is not at its start" in err
    assert "base 17.2 deg" in err
    assert not (tmp_path / "again").exists()


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ((), "nothing to record: give the robot's HOST, --ft or --imu"),
        (("--program", "x.txt"), "a program needs the robot's HOST"),
        (("--ft", "1.2.3.4:x"), "'1.2.3.4:x' is not HOST, HOST:UDP or HOST:UDP,HTTP"),
        (("--ft", "127.0.0.1:1,1"), "--ft 127.0.0.1:1,1: 127.0.0.1:1/netftapi2.xml"),
        (("--imu", "/dev/nothing"), "--imu /dev/nothing: /dev/nothing: no MTi"),
        (("127.0.0.1", "--port", 1), "HOST 127.0.0.1: 127.0.0.1:1: no real-time interface"),
        (("127.0.0.1", "--port", "usb"), "'usb' is none of auto, rtde, realtime"),
    ],
)
def test_what_cannot_be_is_said_before_anything_is_recorded(
    run: Callable[..., tuple[int, str, str]], tmp_path: Path, arguments: tuple[Any, ...], what: str
) -> None:
    code, _, err = run("record", *arguments, "--out", "out")
    assert code == 2
    assert what in err
    assert not (tmp_path / "out").exists()
