"""What a tick of the cell costs beside the bare physics steps in it, and many cells beside ``mujoco.rollout``.

    python benchmarks/cell_speed.py [--cells 128] [--threads 2] [--repeat 5]

The cell: controller, drives, friction, a push, contact with a plate, and the truth at every step. Bare steps are
``mj_step`` of the same model in the same motion, played back open loop, called once a tick (``mj_step(m, d, 4)``).
MuJoCo's Python bindings switch on a timer that costs an eighth of a step and more; it is on for both sides.
Ratios hold from machine to machine, single times do not: quote the ratios.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import mujoco
import numpy as np
from mujoco import rollout

from ur5_twin.scenario import load_scenario
from ur5_twin.twin.cell import PERIOD, Cell
from ur5_twin.twin.closed_loop import SUBSTEP
from ur5_twin.twin.fleet import advance_all
from ur5_twin.twin.scenario_run import ScenarioRun

STEPS = round(PERIOD / SUBSTEP)


def best(repeat: int, prepare: Callable[[], object], run: Callable[[], object]) -> float:
    """Shortest of several runs, s."""
    times = []
    for _ in range(repeat):
        prepare()
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=128)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeat", type=int, default=5)
    options = parser.parse_args()
    print("| what | us per tick | x bare |\n|---|---:|---:|")
    for name in ("free_motion", "slide_plate"):
        one_cell(name, options.repeat)
    many_cells(options.cells, options.threads, options.repeat)


def one_cell(name: str, repeat: int) -> None:
    """A scenario's closed loop, with and without sensors, beside bare steps of the same motion."""
    scenario = load_scenario(name)
    whole = ScenarioRun(scenario, keep_trace=True)
    whole.finish()
    ticks = len(whole.reference.rows)
    trace = whole.trace()

    cell = Cell(whole.setup)
    targets = whole.reference.rows[1:]
    closed = best(repeat, cell.reset, lambda: cell.advance(targets))
    runs: list[ScenarioRun] = []
    sensed = best(repeat, lambda: runs.append(ScenarioRun(scenario)), lambda: runs[-1].finish())

    model, data = cell.model, cell.data
    motor, friction = trace.motor_torque[::STEPS], trace.friction_torque[::STEPS]

    def bare() -> None:
        # Put back onto the cell's motion every tick, so that it meets the same contacts.
        for k in range(len(motor)):
            data.qpos[:6], data.qvel[:6] = trace.q[STEPS * k], trace.qd[STEPS * k]
            data.ctrl[:] = motor[k]
            data.qfrc_applied[:6] = -friction[k]
            mujoco.mj_step(model, data, STEPS)

    def only_copies() -> None:
        for k in range(len(motor)):
            data.qpos[:6], data.qvel[:6] = trace.q[STEPS * k], trace.qd[STEPS * k]
            data.ctrl[:] = motor[k]
            data.qfrc_applied[:6] = -friction[k]

    reset = lambda: mujoco.mj_resetData(model, data)  # noqa: E731
    reference = best(repeat, reset, bare) - best(repeat, reset, only_copies)
    for what, seconds in (("bare mj_step", reference), ("closed loop, truth", closed), ("with sensors", sensed)):
        print(f"| {name}: {what} | {seconds / ticks * 1e6:.1f} | {seconds / reference:.2f} |")


def many_cells(n: int, threads: int, repeat: int) -> None:
    """Cells at once beside rollouts of the same model through the same motion, their torques played back open loop."""
    run = ScenarioRun(load_scenario("free_motion"), keep_trace=True)
    run.finish()
    ticks = 500
    targets, trace = run.reference.rows[1 : ticks + 1], run.trace()
    cells = [Cell(run.setup) for _ in range(n)]

    def reset() -> None:
        for cell in cells:
            cell.reset()

    closed = best(repeat, reset, lambda: advance_all(cells, targets, threads=threads))
    model = cells[0].model
    datas = [mujoco.MjData(model) for _ in range(threads)]
    data = mujoco.MjData(model)
    data.qpos[:6] = run.setup.q_start
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    torque = (trace.motor_torque - trace.friction_torque)[: ticks * STEPS]
    control = np.tile(torque, (n, 1, 1))
    states = np.tile(state, (n, 1))
    with rollout.Rollout(nthread=threads) as roll:
        open_loop = best(repeat, lambda: None, lambda: roll.rollout(model, datas, states, control))
    print(
        f"\n{n} cells, {threads} threads, {ticks} ticks: mujoco.rollout {open_loop:.3f} s, closed loop {closed:.3f} s"
    )
    print(f"speed of the closed loop over mujoco.rollout's: {open_loop / closed:.2f}")


if __name__ == "__main__":
    main()
