"""The closed loop in compiled code: controller, drives, friction and engine, step by step, with the truth beside it.

One physics step from time t, everything at t but for the engine's qvel, which is half a step old (leapfrog):

1. the servo asks for a current: i = (M a + C qd + g) / k_c + i_ff  (``control.computed_torque``, friction feed-forward
   of ``control.target_current``), with the controller's numbers;
2. the drive turns it into torque: tau_m = k_t i + b, limited, and its ripple, with the plant's numbers;
3. friction takes its share (``arm.friction``), pushes are applied to their bodies;
4. MuJoCo steps. What it found on the way (acceleration, contacts, the bodies' places) belongs to t, and so do the
   contacts' forces: the row of the trace is written from them at no further cost.

The truth's contact wrench is the sum over contacts, not qfrc_constraint, which mixes contacts with joint limits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from ur5_twin.arm.dynamics import Packed, rnea_into
from ur5_twin.arm.friction import PackedFriction, friction_torque
from ur5_twin.control.computed_torque import demand, reference
from ur5_twin.control.target_current import feed_forward
from ur5_twin.twin.engine import (
    CONTACT_FRAME,
    CONTACT_GEOMS,
    CONTACT_POS,
    mj_contact_force,
    mj_step,
)

#: Velocities (rad/s) and accelerations (rad/s^2) beyond this are no motion of an arm but a simulation that diverges.
DIVERGED = 1e5
#: Torque of the joints below which the force that a wrench estimate makes of them is not worth computing, Nm.
_CALM = 5.0
#: Damping of that estimate: joint torques per wrench below which singular directions are left out, m or rad.
_DAMPING = 0.05
#: What the tool is called where links are numbered.
TOOL = 7

#: Why a run ended before its last tick.
DONE, UNSTABLE, TARGET_STEPS, DEVIATION, SPEED, FORCE, CONTACTS_FULL = range(7)


class Servo(NamedTuple):
    """The controller's numbers: its model, gains, torque constants and friction feed-forward, each (6,)."""

    packed: Packed
    kappa0: np.ndarray
    kappa1: np.ndarray
    kappai: np.ndarray
    lag: np.ndarray
    share: np.ndarray
    torque_constant: np.ndarray
    load: np.ndarray
    viscous_driving: np.ndarray
    viscous_backdriven: np.ndarray


class Drives(NamedTuple):
    """The plant's motors and gears, each (6,): Nm/A, Nm, Nm, kg m^2; the ripple's terms as ``arm.drive.Ripple``."""

    torque_constant: np.ndarray
    offset: np.ndarray
    limit: np.ndarray
    rotor: np.ndarray
    friction: PackedFriction
    ripple_order: np.ndarray
    ripple_amplitude: np.ndarray
    ripple_phase: np.ndarray


class State(NamedTuple):
    """What the loop remembers from step to step beside the engine's state, each (6,) unless said otherwise.

    Attributes:
        qd: joint velocities at the end of the last step, rad/s.
        integral: of the position error, rad s.
        deflection: of the friction's springs, rad.
        link_torque: torque that reached the links in the last step, Nm.
        residual: the controller's low-passed external joint torque, Nm.
        largest_step: (2, 6) largest step of each joint's target so far, rad and rad/s.
    """

    qd: np.ndarray
    integral: np.ndarray
    deflection: np.ndarray
    link_torque: np.ndarray
    residual: np.ndarray
    largest_step: np.ndarray


class Guard(NamedTuple):
    """When the run ends early. Infinity switches a limit off.

    Attributes:
        target_step: a step of a joint's target that no arm could follow, rad, beyond what ``fastest`` explains.
        fastest: rad/s, of any joint.
        deviation: of a joint from its target, rad.
        speed: (6,) of a joint, rad/s.
        force: of the controller's estimate, N.
        smoothing: share of each tick's residual in its low-pass.
        set_over: 1 to set the arm over where the target steps instead of moving.
    """

    target_step: float
    fastest: float
    deviation: float
    speed: np.ndarray
    force: float
    smoothing: float
    set_over: int


class Pushes(NamedTuple):
    """Wrenches on bodies; row k of ``wrench`` (rows, n, 6) acts during physics step k of the run.

    Attributes:
        body: (n,) body in MuJoCo.
        point: (n, 3) where, in the body's frame, m.
        turning: (n,) 1 if the wrench is given in the body's axes and turns with it, 0 in base axes.
    """

    body: np.ndarray
    point: np.ndarray
    turning: np.ndarray
    wrench: np.ndarray


class Trace(NamedTuple):
    """The truth at each physics step, (rows, 6) each unless said otherwise; see ``twin.trace``."""

    time: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    motor_torque: np.ndarray
    friction_torque: np.ndarray
    current: np.ndarray
    tau_ext: np.ndarray
    wrench: np.ndarray
    tool_wrench: np.ndarray
    contact_row: np.ndarray
    contact_geoms: np.ndarray
    contact_link: np.ndarray
    contact_point: np.ndarray
    contact_force: np.ndarray


@numba.njit(cache=True, nogil=True, error_model="numpy")
def run(engine, servo, drives, state, guard, pushes, body_link, targets, dt, steps, viscous_scale, start, trace):
    """Run ticks until the targets end or something stops it.

    Args:
        engine: ``engine.Engine``.
        servo, drives, state, guard, pushes, trace: see the classes above; state and trace are written.
        body_link: (nbody,) 0 for what is not the arm, 1 to 6 for its links, 7 for the tool.
        targets: (n + 1, 3, 6): tick k goes from target k to target k + 1.
        dt: (n,) length of each tick, s.
        steps: (n,) physics steps of each tick.
        viscous_scale: (n, 6) of the drives' temperature.
        start: s, time of the first tick.
        trace: rows for all steps of all ticks, and for contacts.

    Returns:
        Ticks done, why it ended (``DONE`` and so on), the joint that it is about, rows of contacts written.
    """
    c = np.empty((6, 6))
    step = np.empty((2, 6))
    a, qd, error, torque, planned, extra, result = (np.empty(6), np.empty(6), np.empty(6), np.empty(6), np.empty(6),
                                                    np.empty(6), np.empty(6))  # fmt: skip
    q, qvel, qacc = engine.qpos, engine.qvel, engine.qacc
    row = 0
    contact = 0
    for k in range(dt.shape[0]):
        h = dt[k] / steps[k]
        engine.timestep[0] = h
        reference(targets[k], targets[k + 1], dt[k], c, step)
        for j in range(6):
            # Over a gap a joint may have moved and stopped unseen. Written so that NaN fails too.
            if not abs(step[0, j]) < guard.target_step + guard.fastest * dt[k]:
                state.largest_step[0, j] = abs(step[0, j])
                return k, TARGET_STEPS, j, contact
            for i in range(2):
                state.largest_step[i, j] = max(state.largest_step[i, j], abs(step[i, j]))
            if guard.set_over == 1:
                q[j] += step[0, j]
                state.qd[j] += step[1, j]
            qvel[j] = state.qd[j] - 0.5 * h * qacc[j]
        # The friction the controller feeds forward belongs to the tick's target, as its target_current does.
        rnea_into(servo.packed, targets[k, 0], targets[k, 1], targets[k, 2], planned)
        for j in range(6):
            extra[j] = feed_forward(
                planned[j], targets[k, 1, j], servo.load[j], servo.viscous_driving[j], servo.viscous_backdriven[j]
            )
        for s in range(steps[k]):
            for j in range(6):
                qd[j] = qvel[j] + 0.5 * h * qacc[j]
                a[j], error[j] = demand(
                    c,
                    s * h,
                    j,
                    q[j],
                    qd[j],
                    servo.kappa0,
                    servo.kappa1,
                    servo.kappai,
                    servo.lag,
                    servo.share,
                    state.integral,
                )
            if s == 0:
                why, joint = _check(engine, guard, state.residual, error, qd, result)
                if why != DONE:
                    return k, why, joint, contact
            # With the velocity that the engine will use, so that equal models cancel to rounding.
            rnea_into(servo.packed, q, qvel, a, torque)
            for j in range(6):
                current = torque[j] / servo.torque_constant[j] + extra[j]
                motor = drives.torque_constant[j] * current + drives.offset[j]
                if abs(motor) > drives.limit[j]:
                    motor = drives.limit[j] if motor > 0.0 else -drives.limit[j]
                    current = (motor - drives.offset[j]) / drives.torque_constant[j]
                else:
                    # While the motor cannot follow the integral rests, or it would have to be unwound afterwards.
                    state.integral[j] += h * error[j]
                ripple = 0.0
                for r in range(drives.ripple_order.shape[0]):
                    angle = drives.ripple_order[r] * q[j] + drives.ripple_phase[r, j]
                    ripple += drives.ripple_amplitude[r, j] * math.cos(angle)
                friction, state.deflection[j] = friction_torque(
                    drives.friction, j, state.deflection[j], h * qvel[j], qd[j], state.link_torque[j],
                    viscous_scale[k, j],
                )  # fmt: skip
                engine.ctrl[j] = motor
                # Not with the motor's torque: the engine limits that.
                engine.applied[j] = -friction - ripple
                trace.q[row, j] = q[j]
                trace.qd[row, j] = qvel[j]
                trace.current[row, j] = current
                trace.motor_torque[row, j] = motor - ripple
                trace.friction_torque[row, j] = friction
                if s == 0:
                    residual = _residual(servo, j, current, qd[j], planned[j])
                    state.residual[j] += guard.smoothing * (residual - state.residual[j])
            if pushes.body.shape[0] > 0:
                _push(engine, pushes, row)
            mj_step(engine.model, engine.data)
            trace.time[row] = start + s * h
            for j in range(6):
                trace.qd[row, j] += 0.5 * h * qacc[j]
                trace.qdd[row, j] = qacc[j]
                state.link_torque[j] = (
                    trace.motor_torque[row, j] - trace.friction_torque[row, j] - drives.rotor[j] * qacc[j]
                )
                trace.tau_ext[row, j] = 0.0
                trace.wrench[row, j] = 0.0
                trace.tool_wrench[row, j] = 0.0
            if pushes.body.shape[0] > 0:
                _truth_of_pushes(engine, pushes, body_link, row, trace)
            n = engine.ncon[0]
            if n > 0:
                if n > engine.contacts.shape[0] or contact + 2 * n > trace.contact_row.shape[0]:
                    return k, CONTACTS_FULL, 0, contact
                contact = _truth_of_contacts(engine, body_link, row, n, s == 0, contact, result, trace)
            row += 1
        start += dt[k]
        for j in range(6):
            state.qd[j] = qvel[j] + 0.5 * h * qacc[j]
            # Written so that NaN fails too.
            if not (abs(qacc[j]) < DIVERGED and abs(state.qd[j]) < DIVERGED):
                return k, UNSTABLE, j, contact
    return dt.shape[0], DONE, 0, contact


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _residual(servo, j, current, qd, planned):
    """Torque that the motor gives beyond the target's and beyond what friction may explain (``control.tcp_force``)."""
    conductance = 1.0 / servo.torque_constant[j]
    driving = (current - servo.viscous_driving[j] * qd) / (conductance + servo.load[j]) - planned
    backdriven = (current - servo.viscous_backdriven[j] * qd) / (conductance - servo.load[j]) - planned
    if driving * backdriven < 0.0:
        return 0.0
    return driving if abs(driving) < abs(backdriven) else backdriven


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _check(engine, guard, residual, error, qd, wrench):
    """Whether the controller stops the arm in this tick, and for which joint."""
    most = 0.0
    for j in range(6):
        if abs(error[j]) > guard.deviation:
            return DEVIATION, j
        if abs(qd[j]) > guard.speed[j]:
            return SPEED, j
        most = max(most, abs(residual[j]))
    if most > _CALM and guard.force < np.inf:
        _wrench_of(engine, residual, wrench)
        if wrench[0] ** 2 + wrench[1] ** 2 + wrench[2] ** 2 > guard.force**2:
            return FORCE, 0
    return DONE, 0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _wrench_of(engine, tau, out):
    """The wrench at the flange that damped least squares makes of joint torques: (J J' + d^2) F = J tau."""
    J = np.empty((6, 6))
    A = np.empty((6, 6))
    for i in range(6):
        x, y, z = engine.axes[i, 0], engine.axes[i, 1], engine.axes[i, 2]
        rx = engine.flange[0] - engine.anchors[i, 0]
        ry = engine.flange[1] - engine.anchors[i, 1]
        rz = engine.flange[2] - engine.anchors[i, 2]
        J[0, i], J[1, i], J[2, i] = y * rz - z * ry, z * rx - x * rz, x * ry - y * rx
        J[3, i], J[4, i], J[5, i] = x, y, z
    for i in range(6):
        for k in range(i + 1):
            total = _DAMPING**2 if i == k else 0.0
            for j in range(6):
                total += J[i, j] * J[k, j]
            for j in range(k):
                total -= A[i, j] * A[k, j]
            A[i, k] = np.sqrt(total) if i == k else total / A[k, k]
        out[i] = 0.0
        for j in range(6):
            out[i] += J[i, j] * tau[j]
        for j in range(i):
            out[i] -= A[i, j] * out[j]
        out[i] /= A[i, i]
    for i in range(5, -1, -1):
        for j in range(i + 1, 6):
            out[i] -= A[j, i] * out[j]
        out[i] /= A[i, i]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _push(engine, pushes, row):
    """Put the pushes of a step on their bodies."""
    for p in range(pushes.body.shape[0]):
        engine.body_wrench[pushes.body[p], :] = 0.0
    for p in range(pushes.body.shape[0]):
        b = pushes.body[p]
        R = engine.body_rotation[b]
        x, y, z = pushes.point[p, 0], pushes.point[p, 1], pushes.point[p, 2]
        w = pushes.wrench[row, p]
        fx, fy, fz, mx, my, mz = w[0], w[1], w[2], w[3], w[4], w[5]
        if pushes.turning[p] == 1:
            fx, fy, fz = (
                R[0] * w[0] + R[1] * w[1] + R[2] * w[2],
                R[3] * w[0] + R[4] * w[1] + R[5] * w[2],
                R[6] * w[0] + R[7] * w[1] + R[8] * w[2],
            )
            mx, my, mz = (
                R[0] * w[3] + R[1] * w[4] + R[2] * w[5],
                R[3] * w[3] + R[4] * w[4] + R[5] * w[5],
                R[6] * w[3] + R[7] * w[4] + R[8] * w[5],
            )
        # The engine wants the wrench about the body's mass centre.
        rx = engine.body_position[b, 0] + R[0] * x + R[1] * y + R[2] * z - engine.body_center[b, 0]
        ry = engine.body_position[b, 1] + R[3] * x + R[4] * y + R[5] * z - engine.body_center[b, 1]
        rz = engine.body_position[b, 2] + R[6] * x + R[7] * y + R[8] * z - engine.body_center[b, 2]
        out = engine.body_wrench[b]
        out[0] += fx
        out[1] += fy
        out[2] += fz
        out[3] += mx + ry * fz - rz * fy
        out[4] += my + rz * fx - rx * fz
        out[5] += mz + rx * fy - ry * fx


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _truth_of_pushes(engine, pushes, body_link, row, trace):
    """Add what the pushes did in the last step: per body once, as it was applied, about where the centre then was."""
    for p in range(pushes.body.shape[0]):
        b = pushes.body[p]
        first = True
        for other in range(p):
            first = first and pushes.body[other] != b
        if first:
            _add(engine, body_link[b], engine.body_center[b], engine.body_wrench[b], row, trace)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add(engine, link, point, w, row, trace):
    """Add a wrench (force, moment about ``point``, world axes) on a link to the truth of a row."""
    fx, fy, fz = w[0], w[1], w[2]
    for j in range(min(link, 6)):
        z, o = engine.axes[j], engine.anchors[j]
        rx, ry, rz = point[0] - o[0], point[1] - o[1], point[2] - o[2]
        trace.tau_ext[row, j] += (
            z[0] * (w[3] + ry * fz - rz * fy) + z[1] * (w[4] + rz * fx - rx * fz) + z[2] * (w[5] + rx * fy - ry * fx)
        )
    if link < 6:
        return
    rx, ry, rz = point[0] - engine.flange[0], point[1] - engine.flange[1], point[2] - engine.flange[2]
    mx, my, mz = w[3] + ry * fz - rz * fy, w[4] + rz * fx - rx * fz, w[5] + rx * fy - ry * fx
    _sum(trace.wrench[row], fx, fy, fz, mx, my, mz)
    if link == TOOL:
        _sum(trace.tool_wrench[row], fx, fy, fz, mx, my, mz)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sum(out, fx, fy, fz, mx, my, mz):
    out[0] += fx
    out[1] += fy
    out[2] += fz
    out[3] += mx
    out[4] += my
    out[5] += mz


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _truth_of_contacts(engine, body_link, row, n, listed, contact, result, trace):
    """Add the contacts of the last step to a row's truth and, if asked, to the list; returns the list's length."""
    w = np.zeros(6)
    for i in range(n):
        mj_contact_force(engine.model, engine.data, i, result.ctypes)
        f = engine.contacts[i]
        point = f[CONTACT_POS : CONTACT_POS + 3]
        for axis in range(3):
            # Force and moment of the first geom on the second, from the contact's frame into the world's.
            w[axis] = (
                f[CONTACT_FRAME + axis] * result[0]
                + f[CONTACT_FRAME + 3 + axis] * result[1]
                + f[CONTACT_FRAME + 6 + axis] * result[2]
            )
            w[3 + axis] = (
                f[CONTACT_FRAME + axis] * result[3]
                + f[CONTACT_FRAME + 3 + axis] * result[4]
                + f[CONTACT_FRAME + 6 + axis] * result[5]
            )
        for side in (1, 0):
            geom = engine.contact_geoms[i, CONTACT_GEOMS + side]
            link = body_link[engine.geom_body[geom]]
            if link > 0:
                _add(engine, link, point, w, row, trace)
                if listed:
                    trace.contact_row[contact] = row
                    trace.contact_link[contact] = link
                    trace.contact_geoms[contact, 0] = geom
                    trace.contact_geoms[contact, 1] = engine.contact_geoms[i, CONTACT_GEOMS + 1 - side]
                    for axis in range(3):
                        trace.contact_point[contact, axis] = point[axis]
                        trace.contact_force[contact, axis] = w[axis]
                    contact += 1
            for axis in range(6):
                w[axis] = -w[axis]
    return contact


@numba.njit(cache=True, nogil=True, error_model="numpy")
def first_torque(engine, servo, drives, state, before, after, dt, h, torque):
    """Write the torque of a first step into the engine, so that the acceleration it begins with can be found."""
    c = np.empty((6, 6))
    a = np.empty(6)
    reference(before, after, dt, c, np.empty((2, 6)))
    for j in range(6):
        a[j], _ = demand(
            c,
            0.0,
            j,
            engine.qpos[j],
            state.qd[j],
            servo.kappa0,
            servo.kappa1,
            servo.kappai,
            servo.lag,
            servo.share,
            state.integral,
        )
    rnea_into(servo.packed, engine.qpos, state.qd, a, torque)
    current = current_of(servo, drives, before, torque)
    engine.timestep[0] = h
    for j in range(6):
        engine.ctrl[j] = drives.torque_constant[j] * current[j] + drives.offset[j]
        engine.applied[j] = 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def current_of(servo, drives, target, torque):
    """(6,) current in A that the drives carry when the controller asks for a torque (6,) at a target (3, 6)."""
    planned, current = np.empty(6), np.empty(6)
    rnea_into(servo.packed, target[0], target[1], target[2], planned)
    for j in range(6):
        extra = feed_forward(
            planned[j], target[1, j], servo.load[j], servo.viscous_driving[j], servo.viscous_backdriven[j]
        )
        current[j] = torque[j] / servo.torque_constant[j] + extra
        most = (drives.limit[j] - drives.offset[j]) / drives.torque_constant[j]
        least = (-drives.limit[j] - drives.offset[j]) / drives.torque_constant[j]
        current[j] = min(max(current[j], least), most)
    return current
