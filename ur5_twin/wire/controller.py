"""The robot's computer: one tick after the other it runs programs, moves the cell, and says what it publishes."""

from __future__ import annotations

import gc
import queue
from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from ur5_twin import spatial
from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.control.program import plan
from ur5_twin.errors import ScriptError, SimulationError, WireError
from ur5_twin.scenario import Scenario, load_scenario
from ur5_twin.scenario.program import program_of
from ur5_twin.sensing import load_sensors
from ur5_twin.twin.cell import Cell
from ur5_twin.twin.setup import carrying, setup_of
from ur5_twin.twin.telemetry import Telemetry
from ur5_twin.wire import modes
from ur5_twin.wire.builtins import robot_functions
from ur5_twin.wire.builtins.sockets import Sockets
from ur5_twin.wire.messages import Message
from ur5_twin.wire.modes import JointMode, RobotMode, RuntimeState, SafetyMode
from ur5_twin.wire.motion import Motion
from ur5_twin.wire.registers import Registers
from ur5_twin.wire.state import State, Value
from ur5_twin.wire.urscript import Interpreter, library, limits, parse
from ur5_twin.wire.version import Version

T = TypeVar("T")
#: The controller's clock when the cell begins, s. Clients wait for a robot that was switched on 40 s ago or less.
BOOTED = 100.0
#: Actions that wait for a tick, messages that are kept, ticks of measured positions that programs may ask for.
_ACTIONS, _MESSAGES, _HISTORY = 1000, 200, 500
#: What a payload can be: twice what a UR5 lifts, kg; its centre within this of the flange, m.
_HEAVIEST, _FARTHEST = 10.0, 1.0
#: An arm that is this near to the program's start can play it, rad.
_AT_START = 1e-3
#: Columns of the robot's table that are no signals of RTDE: the truth, and the time under another name.
_PRIVATE = ("truth_", "time", "safety_mode")
#: Inputs that programs may watch at once.
_DOGS = 50
#: Digital outputs: eight standard, eight configurable, two of the tool.
_OUTPUTS = {"standard": 0, "configurable": 8, "tool": 16}


@dataclass
class _Watchdog:
    """A program's demand that clients write an input so often, or what becomes of it."""

    name: str
    ticks: int
    action: str
    since: int


class VirtualController:
    """A controller with its cell.

    One thread calls ``tick`` and whatever else is not said to be for any thread. The same scenario, seed and calls give
    the same states.

    Args:
        scenario: what the cell is and what moves in it; the cell goes on after its end.
        version: of the software.
        seed: of the sensors' noise; the scenario's if not given.
        run: play the scenario's own motion from the first tick on.

    Attributes:
        state: the newest; it is replaced, never changed.
        failure: why the simulation cannot go on; None if it can.
        messages: the newest ones.
        motion: the reference.
        registers: what programs and clients leave for one another.
        popup: the text of an open popup; None if there is none.
        operational_mode: ``NONE``, ``MANUAL`` or ``AUTOMATIC``.
        reaches_out: whether programs may connect to other machines.

    Raises:
        TwinError: the scenario asks for what cannot be.
    """

    def __init__(self, scenario: Scenario, version: Version, *, seed: int | None = None, run: bool = True) -> None:
        self.scenario, self.version = scenario, version
        self.setup = replace(setup_of(scenario), period=version.period)
        self.model: ArmModel = self.setup.controller
        self._planned = plan(self.model, scenario.q_start, program_of(scenario), period=version.period).rows
        self.cell = Cell(self.setup)
        self._ticks_before = 0
        self._suite = load_sensors(scenario.sensors.preset, late_packages=False)
        self._rng = np.random.default_rng(scenario.seed if seed is None else seed)
        self._telemetry = self._devices()
        self.motion = Motion(self.model, scenario.q_start, version.period)
        self.registers = Registers()
        self.messages: deque[Message] = deque(maxlen=_MESSAGES)
        self.failure: str | None = None
        self.popup: str | None = None
        self.operational_mode = "NONE"
        self.reaches_out = False
        self.robot_mode = RobotMode.RUNNING
        #: Pose of the tool centre point in the flange, as a vector, m and rad; payload in kg, its centre in m, flange.
        self.tcp_offset = np.zeros(6)
        self._forget_payload()
        self.measured = np.array(scenario.q_start, dtype=float)
        self.history: deque[np.ndarray] = deque(maxlen=_HISTORY)
        self.outputs = 0
        self._inputs: dict[str, Value] = {}
        self._written: dict[str, int] = {}
        self._watchdogs: list[_Watchdog] = []
        self._actions: queue.Queue[tuple[Callable[[], Any], Future[Any]]] = queue.Queue(_ACTIONS)
        self._program: Interpreter | None = None
        self._secondary: list[Interpreter] = []
        self._playing = False
        self._numbered = 0
        self._was_stopped = self._loaded = False
        self._sockets = Sockets(self)
        self._functions = {**library(), **robot_functions(self, self._sockets)}
        if run and len(self._planned) > 1:
            self._play_planned()
        self.state = State(0, BOOTED, {}, False)
        self.tick()

    def _devices(self) -> Telemetry:
        return Telemetry(self.setup, self.cell.geoms, self._suite, self._rng, keep=False)

    def _forget_payload(self) -> None:
        """Believe in the scenario's own tool again."""
        tool = self.model.tool
        self.payload = 0.0 if tool is None else float(tool.mass)
        self.payload_cog = np.zeros(3) if tool is None else np.asarray(tool.center, dtype=float)
        self.payload_inertia = np.zeros(6) if tool is None else _six_of(tool.inertia)

    # For any thread

    def post(self, action: Callable[[], T]) -> Future[T]:
        """Have something done at the beginning of the next tick.

        Raises:
            WireError: too much waits already.
        """
        future: Future[T] = Future()
        try:
            self._actions.put_nowait((action, future))
        except queue.Full:
            raise WireError(f"{_ACTIONS} requests wait for the controller already: is it ticking?") from None
        return future

    # The tick

    @property
    def time(self) -> float:
        """The controller's clock, s."""
        return BOOTED + self.ticks * self.version.period

    @property
    def ticks(self) -> int:
        """Ticks since it was made."""
        return self._ticks_before + self.cell.tick

    @property
    def playing(self) -> bool:
        """Whether a program runs, or the scenario's own motion."""
        return self._program is not None or self._playing

    def tick(self) -> State:
        """Go on by one tick. Nothing that clients and programs do makes this raise."""
        self._loaded = False
        # One program a tick: reading it takes a while, and a client may send many.
        while not self._loaded:
            try:
                action, future = self._actions.get_nowait()
            except queue.Empty:
                break
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(action())
                except Exception as error:  # the client's, whatever it is: it hears of it
                    future.set_exception(error)
        if self.failure is not None:
            return self.state
        try:
            row = self._reference()
            self._advance(row)
        except Exception as error:  # whatever it is, the ports go on and say so
            self._fail(f"{type(error).__name__}: {error}")
        return self.state

    def _reference(self) -> np.ndarray:
        """The next target row (3, 6), by what programs and clients want."""
        try:
            self._heed_inputs()
            self._run_programs()
            row = self.motion.step() if self.cell.stop_tick is None else self.motion.target
        except Exception as error:  # a program's, that nothing foresaw: it ends, the arm brakes
            self.say("error", f"the program ends: {type(error).__name__}: {error}")
            self._end_programs()
            self.motion.stop()
            row = self.motion.step()
        if self._playing and self.motion.move is not self._own_move:
            self._playing = False
        return row

    def _advance(self, row: np.ndarray) -> None:
        pieces = self.cell.advance(row[None])
        if pieces:
            reported = self._telemetry.observe(pieces[-1])
            self.measured = reported["robot"]["actual_q"][-1]
            self.history.appendleft(self.measured)
            self.state = self._published(reported)
        if self.cell.failure is not None:
            self._fail(self.cell.failure)
        elif self.cell.stop_tick is not None and not self._was_stopped:
            self._was_stopped = True
            self.say("error", str(self.cell.stop_reason))
            self._end_programs()

    def _fail(self, why: str) -> None:
        self.failure = why
        self._end_programs()
        self.say("error", f"the simulation cannot go on: {why}")
        signals = {**self.state.signals, **self._modes(), "runtime_state": int(RuntimeState.STOPPED)}
        self.state = replace(self.state, signals=signals, moving=False)

    def _run_programs(self) -> None:
        if self._program is not None and not self.motion.paused:
            self._program.step()
            if not self._program.running:
                self._report(self._program)
                self._program = None
                self._watchdogs.clear()
                self._sockets.close_all()
                self._release_arm()
        for program in self._secondary:
            program.step()
            if not program.running:
                self._report(program)
        self._secondary = [program for program in self._secondary if program.running]

    def _report(self, program: Interpreter) -> None:
        if program.error is not None:
            self.say("error", f"{program.program.name or 'script'}: {program.error}")

    def _release_arm(self) -> None:
        """A program that is over leaves no motion behind, but for a move that is about to arrive."""
        if self.motion.move is not None and not self.motion.arriving:
            self.motion.stop()

    # What it publishes

    def _published(self, reported: dict[str, dict[str, np.ndarray]]) -> State:
        robot = reported["robot"]
        last = {name: values[-1] for name, values in robot.items() if not name.startswith(_PRIVATE)}
        tick = self.ticks - 1
        stamp = BOOTED + tick * self.version.period
        signals: dict[str, Value] = {**self.registers.signals, **last, **self._modes()}
        signals["timestamp"] = stamp
        if self.tcp_offset.any():
            signals["actual_TCP_pose"] = self._tool_pose(last["actual_q"])
            signals["actual_TCP_speed"] = self._tool_twist(last["actual_q"], last["actual_qd"])
            signals["target_TCP_pose"] = self._tool_pose(last["target_q"])
            signals["target_TCP_speed"] = self._tool_twist(last["target_q"], last["target_qd"])
        else:
            signals["target_TCP_pose"] = kinematics.tcp_pose(self.model, last["target_q"])
            signals["target_TCP_speed"] = kinematics.twist(self.model, last["target_q"], last["target_qd"])
        joint = JointMode.RUNNING if self.robot_mode == RobotMode.RUNNING else JointMode.IDLE
        if self.robot_mode == RobotMode.POWER_OFF:
            joint = JointMode.POWER_OFF
        signals |= {
            "joint_mode": np.full(6, int(joint)),
            "speed_scaling": self.motion.scaling,
            "target_speed_fraction": self.motion.slider,
            "tcp_force_scalar": float(np.linalg.norm(last["actual_TCP_force"][:3])),
            "tcp_offset": self.tcp_offset,
            "payload": self.payload,
            "payload_cog": self.payload_cog,
            "payload_inertia": self.payload_inertia,
            "actual_digital_output_bits": self.outputs,
            "script_control_line": 0 if self._program is None else self._program.line,
        }
        ft = reported.get("ft")
        if ft is not None and len(ft["ft_wrench"]):
            self._raw_wrench = ft["ft_wrench"][-1]
        if self._raw_wrench is not None:
            signals["ft_raw_wrench"] = self._raw_wrench
        readings = {device: reported[device] for device in ("ft", "imu") if device in reported}
        if self._ticks_before:
            gone = self._ticks_before * self.version.period
            readings = {device: {**rows, "time": rows["time"] + gone} for device, rows in readings.items()}
        return State(tick, stamp, signals, bool(last["target_qd"].any()), readings)

    _raw_wrench: np.ndarray | None = None

    def _modes(self) -> dict[str, Value]:
        safety, bits = SafetyMode.NORMAL, modes.NORMAL_MODE
        if self.failure is not None:
            safety, bits = SafetyMode.FAULT, modes.FAULT
        elif self.cell.stop_tick is not None:
            safety, bits = SafetyMode.PROTECTIVE_STOP, modes.PROTECTIVE_STOPPED
        runtime = RuntimeState.STOPPED
        if self.playing:
            runtime = RuntimeState.PAUSED if self.motion.paused else RuntimeState.PLAYING
        status = modes.POWER_ON if self.robot_mode != RobotMode.POWER_OFF else 0
        return {
            "robot_mode": int(self.robot_mode),
            "safety_mode": int(safety),
            "safety_status": int(safety),
            "safety_status_bits": bits,
            "robot_status_bits": status | (modes.PROGRAM_RUNNING if self.playing else 0),
            "runtime_state": int(runtime),
        }

    def say(self, kind: str, text: str) -> None:
        """Show a message: ``text``, ``popup`` or ``error``."""
        self._numbered += 1
        if kind == "popup":
            self.popup = text
        self.messages.append(Message(kind, text, self.time, self._numbered))

    # The tool centre point

    @property
    def X_FT(self) -> np.ndarray:
        """(4, 4) pose of the tool centre point in the flange."""
        return spatial.pose_from_vector(self.tcp_offset)

    def _tool_pose(self, q: np.ndarray) -> np.ndarray:
        return spatial.vector_from_pose(kinematics.forward(self.model, q) @ self.X_FT, exact=True)

    def _tool_twist(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return kinematics.point_jacobian(self.model, q, 6, self.tcp_offset[:3]) @ qd

    def tool_arm(self, p_FT: np.ndarray) -> np.ndarray:
        """(3,) m, base axes: from the flange, where it was measured, to a point (3,) of it."""
        return kinematics.forward(self.model, self.measured)[:3, :3] @ p_FT

    def carry(self, mass: float, center: np.ndarray, tensor: np.ndarray) -> None:
        """What set_payload does: the controller believes in that at the flange, whatever hangs there.

        Raises:
            ScriptError: nothing that a UR5 could carry.
        """
        if not 0.0 <= mass <= _HEAVIEST:
            raise ScriptError(f"a payload of {mass:g} kg: 0 to {_HEAVIEST:g} kg can be")
        if np.abs(center).max() > _FARTHEST:
            raise ScriptError(f"a payload whose centre is more than {_FARTHEST:g} m from the flange")
        least, *_, most = np.linalg.eigvalsh(tensor)
        if not -1e-9 <= least <= most <= _HEAVIEST * _FARTHEST**2:
            raise ScriptError(f"a payload whose moments of inertia are {least:g} to {most:g} kg m^2")
        self.payload, self.payload_cog, self.payload_inertia = mass, center, _six_of(tensor)
        bare = self.model.with_tool(None)
        self.cell.tell(carrying(bare, mass, center, tensor))

    # Programs

    def run_script(self, text: str) -> None:
        """Run a program or a single line; one that runs already ends, its motion braking.

        A ``sec`` program runs beside it. What is wrong with any is said in ``messages``.
        """
        self._loaded = True
        try:
            with _no_garbage_search():
                program = parse(text)
                interpreter = Interpreter(program, self._functions)
        except ScriptError as error:
            self.say("error", str(error))
            return
        if program.secondary:
            if len(self._secondary) < limits.SECONDARY:
                self._secondary.append(interpreter)
            return
        if why := self._cannot_run():
            self.say("error", f"{program.name or 'script'}: {why}")
            return
        self._end_programs()
        self._program = interpreter

    def _cannot_run(self) -> str | None:
        if self.failure is not None:
            return f"the simulation cannot go on: {self.failure}"
        if self.cell.stop_tick is not None:
            return f"{self.cell.stop_reason}; unlock it first"
        if self.robot_mode != RobotMode.RUNNING:
            return "the robot is not powered on with its brakes released"
        return None

    def _end_programs(self) -> None:
        if self._program is not None:
            self._program.kill_all()
            self._program = None
        self._playing = False
        self._watchdogs.clear()
        self._sockets.close_all()
        self.motion.paused = False
        self._release_arm()

    @property
    def thread(self) -> int | None:
        """Handle of the program's thread whose turn it is."""
        return None if self._program is None else self._program.thread

    # Inputs

    def write_input(self, name: str, value: Value) -> None:
        """Take what a client writes, by RTDE's name; it counts from this tick on.

        Raises:
            WireError: there is no such register.
        """
        self._written[name] = self.ticks
        if not self.registers.write_named(name, value):  # type: ignore[arg-type]
            self._inputs[name] = value

    def watch(self, name: str, frequency: float, action: str) -> None:
        """rtde_set_watchdog: an input that must be written so often, Hz, or the program is paused or stopped."""
        if action.lower() not in ("ignore", "pause", "stop"):
            raise ScriptError(f"rtde_set_watchdog: '{action}'; it knows ignore, pause and stop")
        self._watchdogs = [dog for dog in self._watchdogs if dog.name != name]
        if frequency > 0.0:
            if len(self._watchdogs) >= _DOGS:
                raise ScriptError(f"rtde_set_watchdog: more than {_DOGS} inputs are watched")
            ticks = max(1, round(1.0 / frequency / self.version.period))
            self._watchdogs.append(_Watchdog(name, ticks, action.lower(), self.ticks))

    def _heed_inputs(self) -> None:
        fraction = self._inputs.get("speed_slider_fraction", np.nan)
        # What is no number leaves the slider where it is: no motion could go on with it.
        if self._inputs.pop("speed_slider_mask", 0) and not np.isnan(fraction):
            self.motion.slider = float(np.clip(fraction, 0.0, 1.0))
        for which, first in _OUTPUTS.items():
            mask = int(self._inputs.pop(f"{which}_digital_output_mask", 0))  # type: ignore[arg-type]
            bits = int(self._inputs.get(f"{which}_digital_output", 0))  # type: ignore[arg-type]
            self.outputs = (self.outputs & ~(mask << first)) | ((bits & mask) << first)
        for dog in self._watchdogs:
            if self.ticks - max(dog.since, self._written.get(dog.name, 0)) > dog.ticks and self.playing:
                if dog.action == "stop":
                    self.say("error", f"{dog.name} was not written as often as rtde_set_watchdog asks for")
                    self._end_programs()
                    return
                self.motion.paused = dog.action == "pause"

    # What an operator does

    def play(self) -> None:
        """Go on after a pause, or play the scenario's own motion, at whose start the arm must be.

        Raises:
            WireError: it cannot run, or the arm is elsewhere.
        """
        if why := self._cannot_run():
            raise WireError(why)
        if self.playing:
            self.motion.paused = False
            return
        away = float(np.abs(self.motion.target[0] - self._planned[0, 0]).max())
        if away > _AT_START:
            raise WireError(f"the arm is {away:.3g} rad from where the scenario's motion begins; move it there first")
        self._play_planned()

    def _play_planned(self) -> None:
        self._own_move = self.motion.rows(self._planned)
        self._playing = True

    _own_move: Any = None

    def pause(self) -> None:
        """Slow down to rest, and wait there.

        Raises:
            WireError: nothing runs.
        """
        if not self.playing:
            raise WireError("no program runs")
        self.motion.paused = True

    def stop(self) -> None:
        """End what runs; the arm brakes."""
        self._end_programs()

    def power_off(self) -> None:
        """The brakes hold; programs end."""
        self._end_programs()
        self.robot_mode = RobotMode.POWER_OFF

    def power_on(self) -> None:
        """Power, with the brakes on."""
        if self.robot_mode == RobotMode.POWER_OFF:
            self.robot_mode = RobotMode.IDLE

    def brake_release(self) -> None:
        """Power, and ready to move."""
        self.robot_mode = RobotMode.RUNNING

    def unlock_protective_stop(self) -> None:
        """After a protective stop: ready to move from where the arm stands.

        Raises:
            WireError: the arm still brakes, or the simulation cannot go on.
        """
        if self.failure is not None:
            raise WireError(f"the simulation cannot go on: {self.failure}")
        try:
            self.cell.release()
        except SimulationError as error:
            raise WireError(str(error)) from None
        self._was_stopped = False
        self.motion.rest_at(self.cell.target[0])

    def restart_safety(self) -> None:
        """As ``unlock_protective_stop``; the robot is powered off afterwards, as the real one.

        A simulation that could not go on begins anew: the arm at the scenario's start, the scenario's time at zero. The
        controller's clock goes on.

        Raises:
            WireError: the arm still brakes.
        """
        if self.failure is None:
            self.unlock_protective_stop()
        else:
            self._ticks_before = self.ticks
            self.cell.reset()
            self._telemetry = self._devices()
            self._forget_payload()
            self.failure, self._was_stopped = None, False
            self.motion.rest_at(self.scenario.q_start)
        self.power_off()

    def close_popup(self) -> None:
        """Close the popup, if there is one."""
        self.popup = None

    def protective_stop(self, why: str) -> None:
        """A stop that a program asks for."""
        self.cell.stop(why)

    def measured_positions(self) -> Generator[np.ndarray, None, None]:
        """(6,) rad, the newest measured ones at each tick: for hand guiding."""
        while True:
            yield self.measured.copy()


def _six_of(tensor: np.ndarray) -> np.ndarray:
    """[Ixx, Iyy, Izz, Ixy, Ixz, Iyz] of a tensor (3, 3)."""
    tensor = np.asarray(tensor, dtype=float)
    return np.array([*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]])


@contextmanager
def _no_garbage_search() -> Generator[None, None, None]:
    """What is made within stays: looking for garbage in it again and again takes most of a large program's time."""
    searches = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if searches:
            gc.enable()


def warm_up(version: Version) -> None:
    """Have all compiled that a tick and a program need, so that no client waits for it; seconds the first time.

    What lives by then is left out of the search for garbage: all of it takes tens of milliseconds, many ticks.
    """
    controller = VirtualController(load_scenario("press_plate"), version, run=False)
    q = controller.motion.target[0].tolist()
    controller.run_script(
        f"movej({[q[0] + 0.01, *q[1:]]})\nmovel(pose_add(get_target_tcp_pose(), p[0, 0, 0.002, 0, 0, 0]))\n"
        f"speedl([0, 0, 0.01, 0, 0, 0], 1, 0.05)\nservoj({q}, t=0.05)\nx = get_inverse_kin(get_forward_kin())\n"
        "x = get_mass_matrix()\nx = get_coriolis_and_centrifugal_torques()\nstopj(2)"
    )
    while controller.playing:
        controller.tick()
    gc.collect()
    gc.freeze()
