"""Cost of an estimator's sample, in microseconds and against one step of the physics, taken in one run.

    python benchmarks/estimator_cost.py [--samples 2000] [--repeats 5]

Everything runs on one thread and is called from Python, a sample at a time, as a live loop does. Samples come from a
simulated run of scenarios/push_moving.toml, tool and noise included.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import mujoco
import numpy as np

from ur5_twin.arm.files import model_path
from ur5_twin.estimation import NominalModel, create, estimator_names, load_nominal, samples_of
from ur5_twin.estimation.localisation import Localiser
from ur5_twin.scenario import load_scenario
from ur5_twin.twin.scenario_run import ScenarioRun


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=2000, help="samples of the run")
    parser.add_argument("--repeats", type=int, default=5, help="runs of each, the fastest counts")
    options = parser.parse_args()

    scenario = load_scenario("push_moving")
    nominal = load_nominal("plant", scenario.arm.tool)
    samples = list(samples_of(ScenarioRun(scenario).finish()))[: options.samples]
    n = len(samples)
    unpublished = [s._replace(actual_TCP_force=np.full(6, np.nan)) for s in samples]

    model = mujoco.MjModel.from_xml_path(str(model_path("ur5_plant.xml")))
    data = mujoco.MjData(model)

    def physics() -> None:
        mujoco.mj_resetData(model, data)
        mujoco.mj_step(model, data, nstep=n)

    def through(name: str, rows: list, believed: NominalModel = nominal) -> Callable[[], object]:
        def run() -> None:
            update = create(name, believed).update
            for sample in rows:
                update(sample)

        return run

    localiser, tau = Localiser(nominal), np.array([20.0, -15.0, 8.0, 1.0, 0.5, 0.1])

    def localise() -> None:
        for sample in samples[:: max(n // 50, 1)]:
            localiser.locate(sample.actual_q, tau, np.ones(6))

    step = fastest(physics, options.repeats) / n
    print(f"mj_step of the plant: {step * 1e6:.2f} us; {n} samples of {scenario.name}")
    print(f"{'':44s}{'us/sample':>10s}{'x mj_step':>11s}")
    rows = [(name, through(name, samples), n) for name in estimator_names()]
    rows.append(("controller, actual_TCP_force not published", through("controller", unpublished), n))
    felt = [s._replace(imu_acc=np.array([0.0, 0.0, 9.82])) for s in samples]
    carrying = load_nominal("plant", "both")
    rows.append(("accelerometer_aided, with an IMU", through("accelerometer_aided", felt, carrying), n))
    rows.append(
        (f"where the contact is, {len(localiser.surface.link)} points", localise, len(samples[:: max(n // 50, 1)]))
    )
    for name, run, count in rows:
        seconds = fastest(run, options.repeats) / count
        print(f"{name:44s}{seconds * 1e6:10.1f}{seconds / step:11.1f}")


def fastest(run: Callable[[], object], repeats: int) -> float:
    run()  # compiles, or reads the compiler's cache
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        best = min(best, time.perf_counter() - start)
    return best


if __name__ == "__main__":
    main()
