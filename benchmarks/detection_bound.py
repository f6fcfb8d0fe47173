"""What the noise of the currents leaves to any detector of a contact: a bound, and no detector.

    python benchmarks/detection_bound.py [--force 10] [--steps 4000]

A step of force in a random direction acts at the flange, in the postures and on the moving joints of the scenario
free_motion. Arm, drives, friction, the step's size and its instant are all known, and the torque shows in the current
at once. What is left is the noise of the currents with its size and colour, and the likelihood ratio of step and no
step is then the best that anybody can do (Neyman and Pearson): with d^2 = s' R^-1 s, s the step in the currents and R
their covariance over the window, a share Phi(d - Phi^-1(1 - alpha)) is found at a share alpha of windows alarmed
falsely. alpha is an hour's false alarms times the window. The second line of each size knows neither the direction nor
the moment of the force, but tests all six torques (chi square). Two noises: what the twin's currents have at the lab's
level (models/sensors.toml), and how the lab's current map errs (models/current_maps.toml), friction that it does not
know included. Friction that holds a push before any current sees it is not in it, nor is what a model of the servo
could read from the arm's motion. Prints the table of docs/benchmark.md as Markdown.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from scipy.stats import chi2, ncx2, norm

from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import load_model
from ur5_twin.drives.current_map import load_current_map
from ur5_twin.estimation.nominal import PERIOD
from ur5_twin.evaluation.tables import markdown
from ur5_twin.scenario import load_scenario
from ur5_twin.sensing.specs import load_sensors
from ur5_twin.twin.scenario_run import ScenarioRun

WINDOWS = (0.03, 0.06, 0.2, 0.6)
HOURLY = (1.0, 10.0, 100.0, 600.0)
MOVING = 1e-3


def first_order(n: int, size: float, kept: float) -> np.ndarray:
    """(n, n) covariance of n samples of a process that keeps so much from one to the next."""
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    return size**2 * kept**apart


def twins(n: int, j: int, moving: bool) -> np.ndarray:
    """Covariance of joint j's current in the twin, A^2."""
    suite = load_sensors("lab")
    white = np.asarray(suite.current.noise)[j] ** 2 + np.asarray(suite.current.step)[j] ** 2 / 12.0
    added = first_order(n, suite.current_moving[j], suite.current_pole) if moving else 0.0
    return white * np.eye(n) + added


def maps(n: int, j: int, moving: bool) -> np.ndarray:
    """Covariance of what the lab's map leaves of joint j's current, A^2; what a joint came to rest with is known."""
    of = load_current_map().residuals[j]
    if not moving:
        # Friction at rest wanders on from where it is.
        wandered = PERIOD * np.minimum.outer(np.arange(1, n + 1), np.arange(1, n + 1))
        slow = 2.0 * of.rest_slow**2 / of.rest_slow_time * wandered
        return slow + first_order(n, of.rest_fast, np.exp(-PERIOD / of.rest_fast_time)) + 1e-6 * np.eye(n)
    slow = first_order(n, of.slow, np.exp(-PERIOD / of.slow_time))
    return slow + first_order(n, of.fast, np.exp(-PERIOD / of.fast_time)) + 1e-6 * np.eye(n)


def found(
    noise: Callable[[int, int, bool], np.ndarray], torque: np.ndarray, moving: np.ndarray, constant: np.ndarray
) -> list[list[str]]:
    """Rows of the table: shares found by one who knows the direction, and by one who tests all torques."""
    rows = []
    for hourly in HOURLY:
        known, blind = [], []
        for window in WINDOWS:
            n = int(np.ceil(window / PERIOD))
            alpha = hourly * window / 3600.0
            weight = np.empty((6, 2))
            for j in range(6):
                for moves in (False, True):
                    weight[j, int(moves)] = np.linalg.solve(noise(n, j, moves), np.ones(n)).sum()
            squared = ((torque / constant) ** 2 * weight[np.arange(6), moving.astype(int)]).sum(axis=1)
            known.append(norm.sf(norm.isf(alpha) - np.sqrt(squared)).mean())
            blind.append(ncx2.sf(chi2.isf(alpha, 6), 6, squared).mean())
        rows += [[f"{hourly:g}", who, *(f"{x:.2f}" for x in of)] for who, of in (("known", known), ("any", blind))]
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--force", type=float, default=10.0, help="N")
    parser.add_argument("--steps", type=int, default=4000, help="random instants and directions")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    robot = ScenarioRun(load_scenario("free_motion"), seed=options.seed).finish().robot
    rng = np.random.default_rng(options.seed)
    at = rng.integers(0, len(robot), options.steps)
    direction = rng.normal(size=(options.steps, 3))
    force = options.force * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    J = kinematics.jacobian(load_model("plant"), robot["target_q"][at])
    torque = np.einsum("nij,ni->nj", J[:, :3], force)
    moving = np.abs(robot["target_qd"][at]) > MOVING
    constant = load_current_map().torque_constant
    head = ("false alarms an hour", "direction", *(f"within {1e3 * window:.0f} ms" for window in WINDOWS))
    still = ~moving.any(axis=1)
    print(f"{options.steps} steps of {options.force:g} N, {still.mean():.0%} of them while all joints rest.\n")
    for title, noise in (("Noise of the twin's currents", twins), ("Errors of the lab's current map", maps)):
        shares = found(noise, torque[still], moving[still], constant)
        least = min(float(x) for row in shares for x in row[2:])
        print(f"{title}, in motion (at rest the least share is {least:.2f}):\n")
        print(markdown(head, found(noise, torque[~still], moving[~still], constant), words=2) + "\n")


if __name__ == "__main__":
    main()
