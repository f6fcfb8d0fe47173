"""What a cell's devices report: RTDE's signals, the sensors' tables, and the truth beside them, piece by piece."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ur5_twin.arm import kinematics
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.mjcf import BODY_NAMES
from ur5_twin.arm.mjcf.obstacles import geom_name
from ur5_twin.arm.parameters import FT_SENSOR
from ur5_twin.control.tcp_force import TcpForce
from ur5_twin.recording.table import Recording, Table
from ur5_twin.sensing import Load, Measuring, SensorSuite, Signals
from ur5_twin.twin.cell import NOTHING, Payload, Piece, Setup, loaded

#: Values of RTDE's safety_mode.
NORMAL, PROTECTIVE_STOP = 1.0, 3.0
#: Values of contact_obstacle that are no obstacle's number.
A_PUSH, THE_ARM = -1.0, -2.0
#: What contact_link counts: 1 to 6 the links, 7 the tool.
LINKS = (*BODY_NAMES, "tool")
#: The contacts of a piece without any.
_NO_CONTACTS = {
    "time": np.empty(0),
    "contact_link": np.empty((0, 1)),
    "contact_obstacle": np.empty((0, 1)),
    "contact_point": np.empty((0, 3)),
    "contact_force": np.empty((0, 3)),
}


class Telemetry:
    """The devices of a cell, fed with the pieces of its run in order.

    Args:
        setup: what the cell is made of.
        geoms: names of the cell's geoms (``Cell.geoms``).
        suite: the sensors.
        rng: of their noise.
        keep: keep what was reported, for ``recording``; a cell that runs for days does not.
    """

    def __init__(
        self, setup: Setup, geoms: Sequence[str], suite: SensorSuite, rng: np.random.Generator, *, keep: bool = True
    ) -> None:
        self._setup, self._keep = setup, keep
        self._measuring = Measuring(suite, setup.plant, rng, period=setup.period)
        self._force = TcpForce(setup.controller, period=setup.period)
        self._dynamics = Dynamics(setup.controller)
        names = {geom_name(obstacle): float(i) for i, obstacle in enumerate(setup.obstacles)}
        self._obstacle_of = np.array([names.get(geom, THE_ARM) for geom in geoms])
        self._last_q: np.ndarray | None = None
        self._loaded = (NOTHING, self._load_with(NOTHING))
        self._rows: dict[str, list[dict[str, np.ndarray]]] = {"robot": [], "ft": [], "imu": [], "contact": []}

    def observe(self, piece: Piece) -> dict[str, dict[str, np.ndarray]]:
        """Take in the next piece of the run.

        Returns:
            What each device reported during it: device -> column -> rows, ``time`` among the columns.
        """
        trace, every = piece.trace, piece.steps
        signals = Signals(trace.time, trace.q, trace.qd, trace.qdd, trace.current, trace.tool_wrench)
        measured = self._measuring.robot(signals, piece.first_tick, every)
        robot = measured | self._controller_signals(piece, measured)
        robot |= {
            "truth_q": trace.q[::every],
            "truth_qd": trace.qd[::every],
            "truth_qdd": trace.qdd[::every],
            "truth_wrench": trace.wrench[::every],
            "truth_tau_ext": trace.tau_ext[::every],
            "truth_friction": trace.friction_torque[::every],
            "truth_moment": trace.motor_torque[::every],
            "safety_mode": np.where(piece.stopped, PROTECTIVE_STOP, NORMAL)[:, None],
        }
        if self._setup.payloads:
            robot["truth_payload_mass"] = np.full((len(piece.targets), 1), piece.payload.mass)
        reported = {"robot": robot, **self._measuring.sensors(signals, self._load(piece))}
        reported["contact"] = self._contacts(piece)
        for device, rows in reported.items() if self._keep else ():
            self._rows[device].append(rows)
        return reported

    def recording(self, source: str) -> Recording:
        """Everything kept so far; what has reported nothing has no table."""
        tables = {}
        for device, pieces in self._rows.items():
            columns = {
                name: np.concatenate([piece[name] for piece in pieces]) for name in (pieces[0] if pieces else ())
            }
            time = columns.pop("time", np.empty(0))
            if not len(time):
                continue
            # Contacts are the truth, on the robot's own clock.
            clock = "robot" if device == "contact" else device
            tables[device] = Table(device, time, columns, self._measuring.host_start[clock])
        return Recording(tables, source, "twin")

    def _controller_signals(self, piece: Piece, measured: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What the controller computes: its targets as it publishes them, their torque and current, its poses."""
        target_q, target_qd, target_qdd = (piece.targets[:, i].copy() for i in range(3))
        q = measured["actual_q"]
        # An idle controller publishes as target what it measured the tick before (docs/servo.md).
        idle = ~piece.targets[:, 1:].any(axis=(1, 2))
        before = np.concatenate([q[:1] if self._last_q is None else self._last_q[None], q[:-1]])
        target_q[idle] = before[idle]
        self._last_q = q[-1].copy()
        if self._dynamics.model is not piece.controller:
            self._dynamics = Dynamics(piece.controller)
        moment = self._dynamics.inverse(target_q, target_qd, target_qdd)
        current = self._setup.law.current(moment, target_qd)
        return {
            "target_q": target_q,
            "target_qd": target_qd,
            "target_qdd": target_qdd,
            "target_moment": moment,
            "target_current": current,
            "actual_TCP_pose": kinematics.tcp_pose(piece.controller, q),
            "actual_TCP_speed": kinematics.twist(piece.controller, q, measured["actual_qd"]),
            "actual_TCP_force": self._force(
                q, measured["actual_qd"], measured["actual_current"], target_qd, moment, current
            ),
        }

    def _load(self, piece: Piece) -> Load:
        """What hangs beyond the force sensor during a piece."""
        if self._loaded[0] is not piece.payload:
            self._loaded = (piece.payload, self._load_with(piece.payload))
        return self._loaded[1]

    def _load_with(self, payload: Payload) -> Load:
        tool = self._setup.plant.tool
        beyond = (0.0, np.zeros(3), np.zeros((3, 3)))
        if tool is not None and FT_SENSOR in tool.sensors:
            beyond = tool.distal_to(FT_SENSOR)
        return Load(*loaded(beyond, payload))

    def _contacts(self, piece: Piece) -> dict[str, np.ndarray]:
        """One row per contact and push that acts at a tick."""
        trace, every = piece.trace, piece.steps
        time = piece.time
        pushing = [push for push in self._setup.pushes if push.acts_within(time[0], time[-1] + piece.period)]
        if not pushing and not len(trace.contact_row):
            return dict(_NO_CONTACTS)
        found = {
            "time": [trace.time[trace.contact_row]],
            "contact_link": [trace.contact_link.astype(float)],
            "contact_obstacle": [self._obstacle_of[trace.contact_geoms[:, 1]]],
            "contact_point": [trace.contact_point],
            "contact_force": [trace.contact_force],
        }
        frames = kinematics.link_frames(self._setup.plant, trace.q[::every]) if pushing else None
        for push in pushing:
            wrench = push.wrench(time)
            acts = wrench.any(axis=1)
            link = LINKS.index(push.body) + 1
            assert frames is not None
            X = frames[acts, min(link, 6)]
            force = wrench[acts, :3]
            found["time"].append(time[acts])
            found["contact_link"].append(np.full(acts.sum(), float(link)))
            found["contact_obstacle"].append(np.full(acts.sum(), A_PUSH))
            found["contact_point"].append(X[:, :3, :3] @ push.point + X[:, :3, 3])
            found["contact_force"].append(np.einsum("nij,nj->ni", X[:, :3, :3], force) if push.turning else force)
        joined = {name: np.concatenate(values) for name, values in found.items()}
        order = np.argsort(joined["time"], kind="stable")
        return {
            name: values[order] if values.ndim == 2 or name == "time" else values[order, None]
            for name, values in joined.items()
        }
