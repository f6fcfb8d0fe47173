"""Speed of the rigid-body dynamics against Pinocchio and plain numpy, as ratios of times taken in one run.

    python benchmarks/dynamics.py [--samples 100000] [--repeats 15]

Everything runs on one thread. "Pinocchio, C++ loop" is Pinocchio's own batch function with one thread; a program of our
own around pinocchio::rnea, compiled with -O3 -march=native, was 1.15 times as fast as it. "numpy loop" is the
recursive Newton-Euler algorithm as a textbook writes it, one sample after the other.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports]
from numba import njit

from ur5_twin.arm.dynamics import Dynamics, rnea_into
from ur5_twin.arm.parameters import ArmModel, load_model, model_names


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=100_000, help="samples in a batch")
    parser.add_argument("--repeats", type=int, default=15, help="runs of each, the fastest counts")
    parser.add_argument("--model", choices=model_names(), default="plant")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    model = load_model(options.model)
    arm, other = Dynamics(model), pinocchio_model(model)
    data, pool = other.createData(), pin.ModelPool(other, 1)
    rng = np.random.default_rng(options.seed)
    n = options.samples
    q, qd, qdd = (rng.uniform(-size, size, (n, 6)) for size in (np.pi, 3.0, 10.0))
    columns = [np.asfortranarray(x.T) for x in (q, qd, qdd)]
    torques = np.empty((6, n), order="F")
    out = np.empty(6)
    few = range(min(n, 2000))

    def pinocchio_loop() -> None:
        for k in few:
            pin.rnea(other, data, q[k], qd[k], qdd[k])

    def our_loop() -> None:
        for k in few:
            arm.inverse(q[k], qd[k], qdd[k])

    def numpy_loop() -> None:
        for k in few:
            newton_euler(model, q[k], qd[k], qdd[k])

    rows: list[tuple[str, Callable[[], object], int]] = [
        ("inverse dynamics, ours, batch", lambda: arm.inverse(q, qd, qdd), n),
        ("inverse dynamics, ours, rnea_into from compiled code", lambda: calls(arm.packed, q, qd, qdd, out), n),
        ("inverse dynamics, Pinocchio, C++ loop", lambda: pin.rneaInParallel(1, pool, *columns, torques), n),
        ("inverse dynamics, ours, called from Python", our_loop, len(few)),
        ("inverse dynamics, Pinocchio, called from Python", pinocchio_loop, len(few)),
        ("inverse dynamics, numpy loop", numpy_loop, len(few)),
        ("mass matrix, ours, batch", lambda: arm.mass_matrix(q), n),
        ("Coriolis matrix, ours, batch", lambda: arm.coriolis_matrix(q, qd), n),
        ("gravity, ours, batch", lambda: arm.gravity(q), n),
        ("forward dynamics, ours, batch", lambda: arm.forward(q, qd, qdd), n),
        ("forward dynamics, Pinocchio, C++ loop", lambda: pin.abaInParallel(1, pool, *columns, torques), n),
    ]
    times = {name: fastest(run, options.repeats) / count for name, run, count in rows}
    reference = times["inverse dynamics, Pinocchio, C++ loop"]
    pin.rneaInParallel(1, pool, *columns, torques)
    difference = np.abs(torques.T - arm.inverse(q, qd, qdd)).max()
    print(f"model {model.name}, {n} samples, one thread; largest difference to Pinocchio {difference:.1e} Nm")
    print(f"{'':54s}{'us/sample':>10s}{'x Pinocchio C++ RNEA':>22s}")
    for name, seconds in times.items():
        print(f"{name:54s}{seconds * 1e6:10.3f}{seconds / reference:22.2f}")


@njit
def calls(packed, q, qd, qdd, out):
    """As a controller calls it: one sample at a time."""
    for k in range(q.shape[0]):
        rnea_into(packed, q[k], qd[k], qdd[k], out)


def fastest(run: Callable[[], object], repeats: int) -> float:
    run()  # compiles, or reads the compiler's cache
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        best = min(best, time.perf_counter() - start)
    return best


def newton_euler(model: ArmModel, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Inverse dynamics of one sample in the DH frames, numpy only."""
    dh, tau = model.dh, model.rotor_inertia * qdd
    w, wd, a = np.zeros(3), np.zeros(3), np.array([0.0, 0.0, model.gravity])
    links = []
    for i, (mass, center, tensor) in enumerate(zip(*model.bodies(), strict=True)):
        c, s, ca, sa = np.cos(q[i]), np.sin(q[i]), np.cos(dh.alpha[i]), np.sin(dh.alpha[i])
        R = np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0.0, sa, ca]])
        z, p = R[2], np.array([dh.a[i], dh.d[i] * sa, dh.d[i] * ca])
        w, wd, a = R.T @ w, R.T @ wd, R.T @ a
        wd = wd + np.cross(w, z) * qd[i] + z * qdd[i]
        w = w + z * qd[i]
        a = a + np.cross(wd, p) + np.cross(w, np.cross(w, p))
        force = mass * (a + np.cross(wd, center) + np.cross(w, np.cross(w, center)))
        moment = tensor @ wd + np.cross(w, tensor @ w) + np.cross(center + p, force)
        links.append((R, z, p, force, moment))
    f, n = np.zeros(3), np.zeros(3)
    for i in range(5, -1, -1):
        R, z, p, force, moment = links[i]
        n = n + np.cross(p, f) + moment
        f = f + force
        tau[i] += z @ n
        f, n = R @ f, R @ n
    return tau


def pinocchio_model(model: ArmModel) -> pin.Model:
    """The arm as Pinocchio wants it: revolute joints about z, DH twist and offsets in the placement of the next."""
    other, joint, placement = pin.Model(), 0, pin.SE3.Identity()
    for i, (mass, center, tensor) in enumerate(zip(*model.bodies(), strict=True)):
        joint = other.addJoint(joint, pin.JointModelRZ(), placement, f"joint_{i}")
        c, s = np.cos(model.dh.alpha[i]), np.sin(model.dh.alpha[i])
        twist = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        placement = pin.SE3(twist, np.array([model.dh.a[i], 0.0, model.dh.d[i]]))
        other.appendBodyToJoint(joint, pin.Inertia(mass, center, tensor), placement)
    other.armature = model.rotor_inertia.copy()
    other.gravity.linear = np.array([0.0, 0.0, -model.gravity])
    return other


if __name__ == "__main__":
    main()
