"""What a tick of the twin costs, beside the bare physics steps in it.

    python benchmarks/replay_speed.py LOG [--repeat N]

Ratios hold from machine to machine, single times do not: quote the ratios. Runs on one core.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path

import mujoco

from ur5_twin.arm import mjcf
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.gains import load_gains
from ur5_twin.recording import read
from ur5_twin.sources.recorded import RecordedSource
from ur5_twin.twin.closed_loop import SUBSTEP, ClosedLoop
from ur5_twin.twin.lockstep import ServoTwin, ShadowTwin, Twin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path, help="a log to replay")
    parser.add_argument("--model", default="controller")
    parser.add_argument("--repeat", type=int, default=5, help="best of N runs")
    options = parser.parse_args()

    recording = read(options.log)
    source = RecordedSource(recording)
    arm = load_model(options.model)
    duration = recording.robot.time[-1] - recording.robot.time[0]
    steps = math.ceil(duration / (len(source) - 1) / SUBSTEP - 1e-6)

    def loop() -> ClosedLoop:
        return ClosedLoop(arm, arm, load_gains())

    def run(make: Callable[[], Twin]) -> float:
        twin = make()
        start = time.perf_counter()
        for sample in source:
            twin.tick(sample)
        return time.perf_counter() - start

    def bare() -> float:
        model = mjcf.compile(arm, collisions=False)
        data = mujoco.MjData(model)
        data.qpos[:] = recording.robot["actual_q"][0]
        data.ctrl[:] = Dynamics(arm).gravity(data.qpos)
        start = time.perf_counter()
        for _ in range(len(source)):
            for _ in range(steps):
                mujoco.mj_step(model, data)
        return time.perf_counter() - start

    makers = {"servo": lambda: ServoTwin(loop()), "shadow": lambda: ShadowTwin(loop(), arm)}
    for make in makers.values():
        run(make)  # compiles
    reference = min(bare() for _ in range(options.repeat))
    rows = [(f"bare mj_step, {steps} per tick", reference)]
    rows += [(f"{name} tick", min(run(make) for _ in range(options.repeat))) for name, make in makers.items()]
    print(f"{recording.source}: {len(source)} ticks, {duration:.1f} s, model {arm.name}\n")
    print("| what | us per tick | x bare | x real time |\n|---|---:|---:|---:|")
    for name, seconds in rows:
        per_tick = seconds / len(source) * 1e6
        print(f"| {name} | {per_tick:.1f} | {seconds / reference:.2f} | {duration / seconds:.0f} |")


if __name__ == "__main__":
    main()
