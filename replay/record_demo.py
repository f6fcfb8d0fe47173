"""Record the demo log in replay/demo: the twin's own arm, in the lab's format.

    python replay/record_demo.py [--out replay/demo] [--seed 1]

The plant (model C's links and rotors) runs under the controller's own model with stiff PD gains through a few movej
moves. Currents follow the controller's current law with the plant's torque and drives 8 % colder than the law's, plus
noise; positions, velocities and currents are quantised as the lab's are. No contact, no friction in the plant, no force
sensor: a log to try the commands on, not one to draw conclusions from.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import numpy as np

from ur5_twin.arm import kinematics
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.gains import Gains
from ur5_twin.control.target_current import driving_share, load_target_current_law
from ur5_twin.control.trajectory import movej, rest
from ur5_twin.recording import write_lab_csv
from ur5_twin.recording.table import Recording, Table
from ur5_twin.twin.closed_loop import ClosedLoop

PERIOD = 0.008
WAYPOINTS = np.array(
    [
        [1.266, -2.135, -1.947, -0.377, -2.542, -0.5],
        [0.6, -1.75, -2.2, -0.6, -1.9, 0.4],
        [-0.2, -1.3, -1.7, -1.3, -1.5, 0.9],
        [0.5, -1.1, -2.1, -0.9, -1.1, 0.0],
        [1.266, -2.135, -1.947, -0.377, -2.542, -0.5],
    ]
)
#: A critically damped servo at 60 rad/s.
SERVO = Gains("stiff", "chosen for the demo log", np.full(6, 3600.0), np.full(6, 120.0))
#: Steps of the lab's encoders (rad) and velocities (rad/s), and noise of its currents (A) at rest and in motion.
Q_STEP, QD_STEP, CURRENT_STEP = 1.2e-5, 3e-4, 2e-3
NOISE_STILL, NOISE_MOVING = 0.01, 0.08
COLD = 1.08


def targets() -> np.ndarray:
    """(n, 3, 6) the reference: the waypoints with half a second of rest at each."""
    parts = [rest(WAYPOINTS[0], seconds=0.5, period=PERIOD)]
    for start, goal in itertools.pairwise(WAYPOINTS):
        parts.append(movej(start, goal, speed=1.0, acceleration=1.4, period=PERIOD)[1:])
        parts.append(rest(goal, seconds=0.5, period=PERIOD))
    return np.concatenate(parts)


def record(seed: int) -> Recording:
    """The demo log."""
    rng = np.random.default_rng(seed)
    reference = targets()
    n = len(reference)
    plant, controller = load_model("plant"), load_model("controller")
    loop = ClosedLoop(controller, plant, SERVO)
    loop.reset(reference[0, 0], reference[0, 1])
    q, qd, moment = (np.empty((n, 6)) for _ in range(3))
    q[0], qd[0], moment[0] = loop.state(reference[0])
    for k in range(1, n):
        loop.advance(reference[k - 1], reference[k], PERIOD)
        q[k], qd[k], moment[k] = loop.state(reference[k])

    target_q, target_qd, target_qdd = reference.swapaxes(0, 1)
    law = load_target_current_law()
    target_moment = Dynamics(controller).inverse(target_q, target_qd, target_qdd)
    driving = driving_share(moment, qd)
    extra = (COLD - 1.0) * (driving * law.viscous_driving + (1.0 - driving) * law.viscous_backdriven) * qd
    noise = rng.normal(size=(n, 6)) * np.where(np.abs(target_qd) > 0, NOISE_MOVING, NOISE_STILL)
    current = law.current(moment, qd) + extra + noise
    target_current = law.current(target_moment, target_qd)
    # The controller reads a wrench into the torque that its current law does not explain.
    unexplained = (current - target_current) * law.torque_constant
    J = kinematics.jacobian(controller, q)
    wrench = np.linalg.solve(J.swapaxes(1, 2) + 1e-6 * np.eye(6), unexplained[..., None])[..., 0]
    columns = {
        "target_q": target_q,
        "target_qd": target_qd,
        "target_qdd": target_qdd,
        "target_moment": target_moment,
        "target_current": target_current,
        "actual_q": np.round(q / Q_STEP) * Q_STEP,
        "actual_qd": np.round(qd / QD_STEP) * QD_STEP,
        "actual_current": np.round(current / CURRENT_STEP) * CURRENT_STEP,
        "actual_TCP_force": wrench,
        "actual_TCP_pose": kinematics.tcp_pose(controller, q),
        "actual_TCP_speed": kinematics.twist(controller, q, qd),
        "actual_tool_accelerometer": np.zeros((n, 3)),
    }
    table = Table("robot", np.arange(n) * PERIOD, columns, host_start=0.0)
    return Recording({"robot": table}, "demo", "twin")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "demo")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    recording = record(options.seed)
    write_lab_csv(recording, options.out)
    print(f"{len(recording.robot)} rows, {recording.robot.time[-1]:.2f} s, written to {options.out}")


if __name__ == "__main__":
    main()
