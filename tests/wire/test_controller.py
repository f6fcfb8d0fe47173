"""The virtual controller: programs move the simulated arm, stops stop it, and equal calls give equal states."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ur5_twin import spatial
from ur5_twin.arm import kinematics
from ur5_twin.errors import WireError
from ur5_twin.scenario import load_scenario
from ur5_twin.twin.cell import Piece
from ur5_twin.wire.controller import BOOTED, VirtualController
from ur5_twin.wire.state import State
from ur5_twin.wire.version import version

CB3 = version("3.x")


@pytest.fixture
def controller() -> VirtualController:
    return VirtualController(load_scenario("free_motion"), CB3, run=False)


def go(
    controller: VirtualController, script: str, seconds: float = 20.0, watch: Callable[[State], None] | None = None
) -> list[str]:
    """Run a script to its end; what it said."""
    controller.messages.clear()
    controller.run_script(script)
    for _ in range(round(seconds / controller.version.period)):
        state = controller.tick()
        if watch is not None:
            watch(state)
        if not controller.playing and not controller.motion.moving:
            break
    assert not controller.playing
    return [message.text for message in controller.messages]


def test_signals_are_those_of_rtde(controller: VirtualController) -> None:
    state = controller.tick()
    assert state.timestamp == pytest.approx(BOOTED + CB3.period)
    for name in ("target_q", "actual_q", "actual_current", "actual_TCP_pose", "actual_TCP_force", "target_TCP_speed"):
        assert np.asarray(state.signals[name]).shape == (6,)
    assert state.signals["robot_mode"] == 7
    assert state.signals["safety_status_bits"] == 1
    assert state.signals["runtime_state"] == 1
    assert not [name for name in state.signals if name.startswith("truth")]


@pytest.mark.parametrize(("written", "slider"), [(0.25, 0.25), (7.0, 1.0), (-np.inf, 0.0), (np.nan, 0.5)])
def test_any_number_may_be_written_to_the_speed_slider(
    controller: VirtualController, written: float, slider: float
) -> None:
    for fraction in (0.5, written):
        controller.write_input("speed_slider_mask", 1)
        controller.write_input("speed_slider_fraction", fraction)
        state = controller.tick()
    assert state.signals["target_speed_fraction"] == slider


@pytest.mark.parametrize("name", ["3.x", "5.x"])
def test_movej_reaches_its_goal_at_either_rate(name: str) -> None:
    controller = VirtualController(load_scenario("free_motion"), version(name), run=False)
    goal = controller.motion.target[0] + np.array([0.2, -0.1, 0.15, 0.1, -0.2, 0.4])
    fastest = []
    go(controller, f"movej({goal.tolist()}, a=2, v=0.8)", watch=lambda s: fastest.append(s.signals["target_qd"]))
    np.testing.assert_allclose(controller.motion.target[0], goal, atol=1e-12)
    # The arm follows to a milliradian or two in joint 6 (docs/cell.md), and the servo is not done yet.
    np.testing.assert_allclose(controller.measured, goal, atol=2e-3)
    assert np.abs(fastest).max() == pytest.approx(0.8, abs=0.02)


def test_movel_is_straight(controller: VirtualController) -> None:
    start = kinematics.forward(controller.model, controller.motion.target[0])[:3, 3]
    places: list[np.ndarray] = []
    go(
        controller,
        # The tool turns on its way, so that the flange goes a bent one.
        "set_tcp(p[0, 0, 0.1, 0, 0, 0])\nmovel(pose_add(get_target_tcp_pose(), p[0.05, 0.1, -0.05, 0.5, 0, 0]))",
        watch=lambda s: places.append(np.asarray(s.signals["target_TCP_pose"])[:3]),
    )
    moved = [place for place in places if np.linalg.norm(place - places[0]) > 1e-3]
    along = (places[-1] - places[0]) / np.linalg.norm(places[-1] - places[0])
    assert np.linalg.norm(places[-1] - places[0]) == pytest.approx(np.sqrt(0.05**2 + 0.1**2 + 0.05**2), abs=2e-4)
    off = [np.linalg.norm(np.cross(place - places[0], along)) for place in moved]
    # An idle controller publishes as target what it measured: the first place is that far off.
    assert max(off) < 1e-4
    assert np.linalg.norm(places[0] - start) == pytest.approx(0.1, abs=1e-3)


def rows_of(controller: VirtualController, script: str) -> np.ndarray:
    """(n, 3, 6) the reference at each tick until the program is over and the arm rests."""
    controller.run_script(script)
    rows = [controller.motion.target]
    for _ in range(4000):
        controller.tick()
        rows.append(controller.motion.target)
        if not controller.playing and not controller.motion.moving:
            return np.array(rows)
    raise AssertionError("it does not end")


def continuous(rows: np.ndarray, period: float) -> None:
    """Each row is where the speeds of the rows lead."""
    mean = 0.5 * (rows[1:, 1] + rows[:-1, 1])
    # 2 to 20 rad/s^2 change within a tick at the ends of ramps, and a scaled plan is a cubic between its rows.
    assert np.abs(np.diff(rows[:, 0], axis=0) / period - mean).max() < 0.02
    assert np.abs(np.diff(rows[:, 1], axis=0)).max() < 20.0 * period


CORNER = """
def corner():
  set_tcp(p[0, 0, 0.1, 0, 0, 0])
  p1 = get_target_tcp_pose()
  p2 = pose_add(p1, p[0, 0.12, 0, 0, 0, 0])
  p3 = pose_add(p2, p[0, 0, -0.12, 0.3, 0, 0])
  FIRST
  SECOND
end
"""
LINES = ("movel(p2, 1.2, 0.2, 0, RADIUS)", "movel(p3, 1.2, 0.2)")


@pytest.mark.parametrize(
    ("first", "second"),
    [
        LINES,
        ("movej(get_inverse_kin(p2), 2, 0.5, 0, RADIUS)", "movej(get_inverse_kin(p3), 2, 0.5)"),
        ("movel(p2, 1.2, 0.2, 0, RADIUS)", "movej(p3, 2, 0.5)"),
        ("movep(p2, 1.2, 0.2, RADIUS)", "movep(p3, 1.2, 0.2)"),
    ],
    ids=["lines", "joints", "line and joints", "movep"],
)
@pytest.mark.parametrize("slider", [1.0, 0.3])
def test_moves_with_a_radius_blend(controller: VirtualController, first: str, second: str, slider: float) -> None:
    controller.motion.slider = controller.motion.scaling = slider
    X_FT = spatial.pose(np.eye(3), [0.0, 0.0, 0.1])
    start = kinematics.forward(controller.model, controller.motion.target[0]) @ X_FT
    corner, end = start[:3, 3] + [0.0, 0.12, 0.0], start[:3, 3] + [0.0, 0.12, -0.12]
    rows = rows_of(controller, CORNER.replace("FIRST", first).replace("SECOND", second).replace("RADIUS", "0.04"))
    continuous(rows, CB3.period)
    tool = (kinematics.forward(controller.model, rows[:, 0]) @ X_FT)[:, :3, 3]
    np.testing.assert_allclose(tool[-1], end, atol=1e-6)
    distance = np.linalg.norm(tool - corner, axis=1)
    nearest = int(np.argmin(distance))
    # It cuts the corner, within the radius, and is never at rest between its ends.
    assert 1e-3 < distance[nearest] < 0.04
    assert np.abs(rows[30:-30, 1]).max(axis=1).min() > 0.02 * slider
    if "movel" in first + second and "movej" not in second:
        # Before and behind the circle it keeps to the lines.
        before, behind = distance[:nearest] > 0.041, distance[nearest:] > 0.041
        line = tool[:nearest][before] - start[:3, 3]
        assert np.abs(line[:, [0, 2]]).max() < 1e-6
        assert np.abs(tool[nearest:][behind][:, :2] - corner[:2]).max() < 1e-6


def test_a_blend_keeps_the_speed_of_a_straight_way(controller: VirtualController) -> None:
    rows = rows_of(
        controller,
        "p1 = get_target_tcp_pose()\nmovel(pose_add(p1, p[0, 0.1, 0, 0, 0, 0]), 1.2, 0.2, 0, 0.03)\n"
        "movel(pose_add(p1, p[0, 0.2, 0, 0, 0, 0]), 1.2, 0.2)",
    )
    place = kinematics.forward(controller.model, rows[:, 0])[:, 1, 3]
    speed = np.diff(place) / CB3.period
    assert speed[30:-30].min() == pytest.approx(0.2, abs=1e-3)
    assert speed.max() == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize(
    ("script", "rests"),
    [
        # Nothing follows, or something else than a move.
        ("movel(p2, 1.2, 0.2, 0, 0.04)", 1),
        ("movel(p2, 1.2, 0.2, 0, 0.04)\n  sleep(2)\n  movel(p3, 1.2, 0.2)", 2),
        # To where it is already, and the same way back.
        ("movel(p2, 1.2, 0.2, 0, 0.04)\n  movel(p2, 1.2, 0.2)", 1),
        ("movel(p2, 1.2, 0.2, 0, 5.0)\n  movel(p1, 1.2, 0.2)", 1),
    ],
)
def test_what_cannot_blend_comes_to_its_goal(controller: VirtualController, script: str, rests: int) -> None:
    text = CORNER.replace("FIRST", script).replace("SECOND", "")
    start = kinematics.forward(controller.model, controller.motion.target[0])[:3, 3]
    rows = rows_of(controller, text)
    continuous(rows, CB3.period)
    still = ~rows[:, 1].any(axis=1)
    begins = np.flatnonzero(still[1:] & ~still[:-1]) + 1
    assert len(begins) == rests
    corner = kinematics.forward(controller.model, rows[begins[0], 0])[:3, 3] - start
    np.testing.assert_allclose(corner, [0.0, 0.0 if "p1, 1.2" in script else 0.12, 0.0], atol=1e-6)


def test_movec_passes_its_point_on_a_circle(controller: VirtualController) -> None:
    X_FT = spatial.pose(np.eye(3), [0.0, 0.0, 0.1])
    X_start = kinematics.forward(controller.model, controller.motion.target[0]) @ X_FT
    rows = rows_of(
        controller,
        "set_tcp(p[0, 0, 0.1, 0, 0, 0])\np1 = get_target_tcp_pose()\n"
        # Half a circle of 60 mm around a point beside the tool; the one between may be given by joints.
        "via = get_inverse_kin(pose_add(p1, p[0, 0.06, 0.06, 0, 0, 0]))\n"
        "movec(via, pose_add(p1, p[0, 0.12, 0, 0, 0, 0.4]), 1, 0.2)",
    )
    continuous(rows, CB3.period)
    X = kinematics.forward(controller.model, rows[:, 0]) @ X_FT
    from_center = X[:, :3, 3] - X_start[:3, 3] - [0.0, 0.06, 0.0]
    np.testing.assert_allclose(np.linalg.norm(from_center, axis=1), 0.06, atol=1e-6)
    np.testing.assert_allclose(from_center[-1], [0.0, 0.06, 0.0], atol=1e-6)
    assert from_center[:, 2].max() == pytest.approx(0.06, abs=1e-5)
    turned = spatial.vector_from_rotation(X_start[:3, :3].T @ X[-1, :3, :3])
    np.testing.assert_allclose(turned, [0.0, 0.0, 0.4], atol=1e-6)


def test_a_circle_goes_on_where_a_line_meets_its_tangent(controller: VirtualController) -> None:
    rows = rows_of(
        controller,
        # A quarter of a level circle of 100 mm, the tool turning with it.
        """
        p1 = get_target_tcp_pose()
        turned = pose_trans(p[0, 0, 0, 0, 0, d2r(90)], p1)
        p2 = p[p1[0] - 0.2, p1[1] + 0.2, p1[2], turned[3], turned[4], turned[5]]
        movel(pose_add(p1, p[0, 0.1, 0, 0, 0, 0]), 1.2, 0.1, 0, 0.03)
        via = pose_add(p1, p[-0.0292893, 0.1707107, 0, 0, 0, 0])
        movec(via, pose_add(p1, p[-0.1, 0.2, 0, 0, 0, 0]), 1.2, 0.1, 0.03, 1)
        movel(p2, 1.2, 0.1)
        """,
    )
    continuous(rows, CB3.period)
    X = kinematics.forward(controller.model, rows[:, 0])
    speed = np.linalg.norm(np.diff(X[:, :3, 3], axis=0), axis=1) / CB3.period
    # A blend cuts the corner: it is that little slower.
    assert speed[30:-30].min() > 0.095
    assert speed.max() < 0.1001
    turned = spatial.vector_from_rotation(X[:, :3, :3] @ X[0, :3, :3].T)
    np.testing.assert_allclose(turned[-1], [0.0, 0.0, np.pi / 2], atol=1e-6)
    from_center = X[:, :2, 3] - X[0, :2, 3] - [-0.1, 0.1]
    on_circle = (turned[:, 2] > 0.4) & (turned[:, 2] < 1.17)
    np.testing.assert_allclose(np.linalg.norm(from_center[on_circle], axis=1), 0.1, atol=1e-6)
    heading = np.arctan2(*from_center[on_circle].T[::-1])
    np.testing.assert_allclose(heading, turned[on_circle, 2], atol=1e-5)


def test_a_move_out_of_reach_ends_a_program_though_it_would_blend(controller: VirtualController) -> None:
    text = CORNER.replace("FIRST", LINES[0]).replace("SECOND", "movel(p[3, 0, 0, 0, 0, 0])").replace("RADIUS", "0.04")
    rows = rows_of(controller, text)
    assert any("reach" in message.text for message in controller.messages)
    continuous(rows, CB3.period)


def test_servoj_goes_after_its_set_point(controller: VirtualController) -> None:
    goal = controller.motion.target[0] + 0.05
    go(controller, f"i = 0\nwhile i < 200:\n servoj({goal.tolist()}, t=0.008, gain=500)\n i = i + 1\nend\nstopj(2)")
    np.testing.assert_allclose(controller.motion.target[0], goal, atol=1e-5)


def test_speedj_has_its_speed_and_ends_with_its_program(controller: VirtualController) -> None:
    speeds: list[np.ndarray] = []
    go(
        controller,
        "speedj([0.3, 0, 0, 0, 0, -0.3], 1.0, 1.0)",
        watch=lambda s: speeds.append(np.asarray(s.signals["target_qd"])),
    )
    np.testing.assert_allclose(np.abs(speeds).max(axis=0), [0.3, 0, 0, 0, 0, 0.3], atol=1e-9)
    steps = np.abs(np.diff([s[0] for s in speeds])) / CB3.period
    assert 3.5 < steps.max() <= 4.0 + 1e-9  # braking at the program's end, in whole ticks
    assert not controller.motion.moving


def test_speedl_moves_the_tool_along(controller: VirtualController) -> None:
    seen: list[np.ndarray] = []
    go(
        controller,
        "speedl([0, 0.05, 0, 0, 0, 0], 0.5, 1)\nstopl(1)",
        watch=lambda s: seen.append(np.asarray(s.signals["target_TCP_speed"])),
    )
    middle = np.array(seen)[60:110]
    np.testing.assert_allclose(middle, np.tile([0, 0.05, 0, 0, 0, 0], (50, 1)), atol=1e-3)


def test_a_killed_motion_brakes_and_another_thread_may_not_interfere(controller: VirtualController) -> None:
    script = """
    def program():
      thread mover():
        speedj([0.3, 0, 0, 0, 0, 0], 1, 100)
      end
      h = run mover()
      sleep(1)
      kill h
      sleep(0.5)
      textmsg(norm(get_target_joint_speeds()))
      h = run mover()
      sleep(0.1)
      stopj(2)
    end
    """
    said = go(controller, script)
    assert said[0] == "0"
    assert "another thread is already controlling the robot" in said[1]
    assert "line 13" in said[1]


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("movej([9, 0, 0, 0, 0, 0])", "shoulder_pan"),
        ("movel(p[3, 0, 0, 0, 0, 0])", "reach"),
        ("movej([1, 2])", "list of 6 numbers"),
        ("p1 = get_target_tcp_pose()\nmovec(p1, pose_add(p1, p[0, 0.1, 0, 0, 0, 0]))", "on one line or one point"),
        ("p1 = get_target_tcp_pose()\nmovec(p1, p1, 1.2, 0.25, 0, 2)", "mode is 2"),
        ("movec(p[0.4, 0.4, 0.4, 0, 0, 0], p[3, 0, 0, 0, 0, 0])", "reach"),
        ("movej()", "missing"),
        ("servoj([0, 0, 0, 0, 0, 0], gain=5)", "gain is 5"),
        ("direct_torque([0, 0, 0, 0, 0, 0])", "direct_torque is not simulated"),
        ("force_mode(p[0,0,0,0,0,0], [0,0,2,0,0,0], [0,0,9,0,0,0], 2, [1,1,1,1,1,1])", "zeros and ones"),
        ("force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,9,0,0,0], 1, [1,1,1,1,1,1])", "only type 2"),
        ("set_payload(-1)", "payload of -1"),
        ("x = get_inverse_kin(p[3, 0, 0, 0, 0, 0])", "no joint position"),
        ("read_input_integer_register(99)", "0 to 47"),
        ("sec s():\n movej([0,0,0,0,0,0])\nend", "secondary program must not move"),
    ],
)
def test_what_programs_ask_wrongly_is_said(controller: VirtualController, script: str, message: str) -> None:
    before = controller.motion.target.copy()
    said = go(controller, script, 1.0)
    controller.tick()
    said = said or [one.text for one in controller.messages]
    assert message in said[0]
    np.testing.assert_array_equal(controller.motion.target, before)


def test_getters_agree(controller: VirtualController) -> None:
    script = """
    q = get_target_joint_positions()
    textmsg(norm(get_inverse_kin(get_forward_kin(q), q) - q) < 0.000001)
    textmsg(pose_dist(get_actual_tcp_pose(), get_forward_kin(get_actual_joint_positions())) < 0.000001)
    textmsg(get_inverse_kin_has_solution(p[3, 0, 0, 0, 0, 0]), is_within_safety_limits(q))
    textmsg(norm(get_actual_joint_positions_history(0) - get_actual_joint_positions()))
    textmsg(get_steptime())
    M = get_mass_matrix()
    textmsg(M[0, 1] == M[1, 0], size(get_jacobian()))
    textmsg(is_steady())
    """
    assert go(controller, script) == ["True", "True", "FalseTrue", "0", "0.008", "True[6, 6]", "True"]


def test_outputs_by_the_names_of_the_first_series(controller: VirtualController) -> None:
    said = go(
        controller,
        "set_digital_out(1, True)\nset_digital_out(9, True)\nset_analog_out(0, 0.5)\n"
        "textmsg(get_digital_out(1), get_standard_digital_out(1))\n"
        "textmsg(get_digital_out(8), get_tool_digital_out(1))\ntextmsg(get_digital_in(3))\nset_digital_out(10, True)",
    )
    assert said[:3] == ["TrueTrue", "FalseTrue", "False"]
    assert "no tool output 2" in said[3]
    assert controller.outputs == 2 + (1 << 17)
    # As python-urx sends it; a list of that name is a list.
    assert go(controller, "digital_out[2]=True\ndigital_out[1]=False") == []
    assert controller.outputs == 4 + (1 << 17)
    assert go(controller, "digital_out = [1, 2]\ndigital_out[0] = 5\ntextmsg(digital_out)") == ["[5, 2]"]
    assert controller.outputs == 4 + (1 << 17)


def test_registers_both_ways(controller: VirtualController) -> None:
    controller.write_input("input_int_register_24", 7)
    controller.write_input("input_double_register_3", 1.5)
    controller.write_input("input_bit_register_70", True)
    controller.write_input("input_bit_registers0_to_31", 5)
    said = go(
        controller,
        "write_output_integer_register(24, read_input_integer_register(24) + 1)\n"
        "write_output_float_register(3, 2 * read_input_float_register(3))\n"
        "write_output_boolean_register(2, read_input_boolean_register(70) and read_input_boolean_register(2))\n"
        "set_standard_digital_out(1, True)\nset_tool_digital_out(0, True)\nsync()\nsync()",
    )
    assert said == []
    signals = controller.state.signals
    assert signals["output_int_register_24"] == 8
    assert signals["output_double_register_3"] == 3.0
    assert signals["output_bit_registers0_to_31"] == 4
    assert signals["input_bit_registers0_to_31"] == 5
    assert signals["actual_digital_output_bits"] == 2 + (1 << 16)
    with pytest.raises(WireError, match="no register"):
        controller.write_input("input_int_register_99", 1)


def test_what_it_is_told_it_carries_shows_in_target_moment(controller: VirtualController) -> None:
    before = np.asarray(controller.state.signals["target_moment"])
    go(controller, "set_payload(2.0, [0, 0, 0.05])\nsync()\nsync()")
    after = np.asarray(controller.state.signals["target_moment"])
    J = kinematics.point_jacobian(controller.model, controller.measured, 6, np.array([0, 0, 0.05]))
    held = 0.0 if controller.model.tool is None else controller.model.tool.mass
    assert controller.state.signals["payload"] == 2.0
    assert held < 0.5
    np.testing.assert_allclose(
        (after - before)[1:3], (J[:3].T @ np.array([0, 0, (2.0 - held) * 9.82]))[1:3], rtol=0.05, atol=0.1
    )


def test_the_slider_and_a_pause_slow_a_move_down(controller: VirtualController) -> None:
    goal = (controller.motion.target[0] + 0.3).tolist()
    controller.write_input("speed_slider_mask", 1)
    controller.write_input("speed_slider_fraction", 0.5)
    fast: list[np.ndarray] = []
    go(
        controller,
        f"sleep(1)\nmovej({goal}, a=3, v=0.6)",
        watch=lambda s: fast.append(np.asarray(s.signals["target_qd"])),
    )
    assert np.abs(fast).max() == pytest.approx(0.3, abs=0.01)
    assert controller.state.signals["target_speed_fraction"] == 0.5
    np.testing.assert_allclose(controller.motion.target[0], goal, atol=1e-12)
    controller.run_script(f"movej({(np.array(goal) - 0.3).tolist()}, a=3, v=0.6)")
    for _ in range(40):
        controller.tick()
    controller.pause()
    for _ in range(100):
        controller.tick()
    assert controller.state.signals["runtime_state"] == 4
    assert not np.asarray(controller.state.signals["target_qd"]).any()
    controller.play()
    for _ in range(400):
        controller.tick()
    np.testing.assert_allclose(controller.motion.target[0], np.array(goal) - 0.3, atol=1e-12)


def test_force_mode_presses_with_what_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = VirtualController(load_scenario("press_plate"), CB3, run=False)
    pressed: list[float] = []
    observe = controller._telemetry.observe

    def observed(piece: Piece) -> dict[str, dict[str, np.ndarray]]:
        reported = observe(piece)
        pressed.append(reported["robot"]["truth_wrench"][-1, 2])
        return reported

    monkeypatch.setattr(controller._telemetry, "observe", observed)
    places: list[np.ndarray] = []
    said = go(
        controller,
        """
        movel(pose_add(get_target_tcp_pose(), p[0, 0, -0.045, 0, 0, 0]), v=0.1)
        force_mode(p[0, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, -40, 0, 0, 0], 2, [1, 1, 0.02, 1, 1, 1])
        sleep(3)
        end_force_mode()
        """,
        watch=lambda s: places.append(np.asarray(s.signals["target_TCP_pose"])),
    )
    assert said == []
    # The last second of force mode. Its belief is blind to friction: 40 N asked for, the plate feels 37 to 40.
    assert np.mean(pressed[-150:-25]) == pytest.approx(40.0, abs=6.0)
    assert max(pressed) < 55.0
    np.testing.assert_allclose(places[-30][:2], places[0][:2], atol=1e-3)


def test_a_collision_stops_and_can_be_unlocked() -> None:
    controller = VirtualController(load_scenario("collide_100"), CB3)
    while controller.cell.stop_tick is None:
        assert controller.tick().tick < 5000
    assert controller.state.signals["safety_mode"] == 3 or controller.tick().signals["safety_mode"] == 3
    assert not controller.playing
    assert "protective stop" in controller.messages[-1].text
    controller.run_script("movej([0, 0, 0, 0, 0, 0])")
    assert "unlock" in controller.messages[-1].text
    with pytest.raises(WireError, match="brakes"):
        controller.unlock_protective_stop()
    for _ in range(100):
        controller.tick()
    controller.unlock_protective_stop()
    back = controller.scenario.q_start.tolist()
    # It still leans on what it hit, held by its gears' friction: guided by hand it lets go, and moves away.
    script = f"freedrive_mode()\nsleep(1)\nend_freedrive_mode()\nmovej({back}, a=0.5, v=0.3)"
    assert go(controller, script) == []
    assert controller.tick().signals["safety_mode"] == 1
    np.testing.assert_allclose(controller.measured, back, atol=2e-3)


def test_the_scenarios_own_motion_plays_and_plays_again() -> None:
    controller = VirtualController(load_scenario("push_moving"), CB3)
    assert controller.tick().signals["runtime_state"] == 2
    for _ in range(400):
        controller.tick()
    controller.stop()
    for _ in range(100):
        controller.tick()
    with pytest.raises(WireError, match="from where the scenario's motion begins"):
        controller.play()


def test_a_watchdog_stops_a_program_whose_client_is_gone(controller: VirtualController) -> None:
    controller.run_script('rtde_set_watchdog("input_int_register_0", 10, "stop")\nwhile True:\n sync()\nend')
    for k in range(50):
        if k < 25:
            controller.write_input("input_int_register_0", k)
        controller.tick()
    assert not controller.playing
    assert "input_int_register_0" in controller.messages[-1].text


def test_each_of_several_programs_has_a_tick(controller: VirtualController) -> None:
    """Those of one burst do not replace one another before they began."""
    for k in range(3):
        controller.post(lambda k=k: controller.run_script(f"write_output_integer_register({k}, {k + 5})"))
    seen = []
    for _ in range(3):
        controller.tick()
        seen.append([controller.registers.read("output", "int", k) for k in range(3)])
    assert seen == [[5, 0, 0], [5, 6, 0], [5, 6, 7]]


def test_as_many_inputs_are_watched_as_make_sense(controller: VirtualController) -> None:
    controller.run_script('i = 0\nwhile True:\n i = i + 1\n rtde_set_watchdog(to_str(i), 1, "ignore")\nend')
    controller.tick()
    assert "more than 50 inputs are watched" in controller.messages[-1].text


def test_posted_actions_are_done_in_order_and_bounded(controller: VirtualController) -> None:
    done: list[int] = []
    futures = [controller.post(lambda k=k: done.append(k)) for k in range(10)]
    failing = controller.post(lambda: 1 / 0)
    controller.tick()
    assert done == list(range(10))
    assert all(future.done() for future in futures)
    assert isinstance(failing.exception(), ZeroDivisionError)
    for _ in range(1000):
        controller.post(lambda: None)
    with pytest.raises(WireError, match="wait for the controller"):
        controller.post(lambda: None)


@pytest.mark.parametrize(
    "script",
    [
        f"movej({[0.1, -1.5, -1, -1, 1, 0]}, v=0.0000001)",
        f"movej({[0.1, -1.5, -1, -1, 1, 0]}, t=10000000)",
        "movel(pose_add(get_target_tcp_pose(), p[0, 0, -0.01, 0, 0, 0]), v=0.0000001)",
        "movel(pose_add(get_target_tcp_pose(), p[0, 0, -0.01, 0, 0, 0]), t=10000000)",
        "speedj([0.5, 0, 0, 0, 0, 0], 1, 0.5)\nstopj(0.0000001)",
        "speedl([1e300, 0, 0, 1e300, 0, 0], 1e300, 0.5)",
        "sleep(1e305)",
    ],
)
def test_programs_that_ask_for_too_much_cost_nothing(controller: VirtualController, script: str) -> None:
    """However slow a motion is, its rows take no memory, and what cannot be ends at most the program."""
    controller.run_script(script)
    tracemalloc.start()
    for _ in range(100):
        controller.tick()
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 3e6
    assert controller.failure is None


@pytest.mark.parametrize(
    "script",
    [
        f"movej({[0.1, -1.5, -1, -1, 1, 0]}, a=1e-300)",
        "set_tcp(p[1e300, 0, 0, 0, 0, 0])",
        "set_tcp(p[0, 0, 0, 1e300, 0, 0])",
        "set_payload(1e308)",
        "set_payload(1, [1000, 0, 0])",
        "set_target_payload(1, [0, 0, 0], [-1, -1, -1, 9, 9, 9])",
    ],
)
def test_what_no_arm_can_is_refused(controller: VirtualController, script: str) -> None:
    (said,) = go(controller, script, 1.0)
    assert said.startswith("script: line 1")
    for _ in range(20):
        controller.tick()
    assert controller.failure is None
    assert controller.cell.stop_reason is None


def test_a_long_move_slowly_is_the_same_move(controller: VirtualController) -> None:
    """At a slider that no tick divides, a line's rows come from two chunks at a time: still a line."""
    controller.write_input("speed_slider_mask", 1)
    controller.write_input("speed_slider_fraction", 0.37)
    poses: list[np.ndarray] = []
    go(
        controller,
        "sleep(1)\nmovel(pose_add(get_target_tcp_pose(), p[0, 0, -0.05, 0, 0, 0]), v=0.2)",
        watch=lambda s: poses.append(np.asarray(s.signals["target_TCP_pose"])[:3]),
    )
    end = np.array(poses[-1])
    assert poses[0][2] - end[2] == pytest.approx(0.05, abs=2e-4)
    assert np.abs(np.array(poses)[:, :2] - end[:2]).max() < 2e-4


def test_a_line_that_comes_too_near_to_a_singularity_ends_its_program(controller: VirtualController) -> None:
    # Across the shoulder's axis: no inverse kinematics follows it.
    script = "p1 = get_target_tcp_pose()\nmovel(p[-p1[0], -p1[1], p1[2], p1[3], p1[4], p1[5]])"
    (said,) = go(controller, script)
    assert "line 2: movel" in said
    assert controller.cell.stop_reason is None


def test_a_simulation_that_cannot_go_on_begins_anew(
    controller: VirtualController, monkeypatch: pytest.MonkeyPatch
) -> None:
    go(controller, f"movej({(controller.motion.target[0] + 0.1).tolist()})")
    with monkeypatch.context() as broken:
        broken.setattr(controller.cell, "advance", lambda rows: 1 / 0)
        state = controller.tick()
    assert state.signals["safety_mode"] == 9
    assert "ZeroDivisionError" in controller.messages[-1].text
    assert controller.tick() is state
    with pytest.raises(WireError, match="cannot go on"):
        controller.unlock_protective_stop()
    controller.restart_safety()
    controller.brake_release()
    after = controller.tick()
    assert after.timestamp == pytest.approx(state.timestamp + CB3.period)
    assert after.tick == state.tick + 1
    assert after.signals["safety_mode"] == 1
    np.testing.assert_allclose(controller.measured, controller.scenario.q_start, atol=1e-3)


def test_power_and_brakes(controller: VirtualController) -> None:
    controller.power_off()
    assert controller.tick().signals["robot_mode"] == 3
    controller.run_script("movej([0, 0, 0, 0, 0, 0])")
    assert "not powered on" in controller.messages[-1].text
    controller.power_on()
    assert controller.tick().signals["robot_mode"] == 5
    controller.brake_release()
    assert controller.tick().signals["robot_mode"] == 7


def test_equal_calls_give_equal_states() -> None:
    def run() -> list[State]:
        controller = VirtualController(load_scenario("press_plate"), CB3, seed=3)
        states = [controller.tick() for _ in range(120)]
        controller.run_script("speedl([0.02, 0, 0, 0, 0, 0], 0.5, 0.3)\nstopl(2)")
        return states + [controller.tick() for _ in range(60)]

    for a, b in zip(run(), run(), strict=True):
        assert a.signals.keys() == b.signals.keys()
        for name in a.signals:
            np.testing.assert_array_equal(a.signals[name], b.signals[name])


_MOVES = st.one_of(
    st.tuples(st.just("movej"), st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6), st.floats(0.1, 3)),
    st.tuples(st.just("speedj"), st.lists(st.floats(-4, 4), min_size=6, max_size=6), st.floats(0.1, 20)),
    st.tuples(st.just("speedl"), st.lists(st.floats(-2, 2), min_size=6, max_size=6), st.floats(0.1, 20)),
    st.tuples(st.just("servoj"), st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6), st.floats(100, 2000)),
    st.tuples(st.just("stopj"), st.just([]), st.floats(0.5, 20)),
)
_LIMITED = VirtualController(load_scenario("free_motion"), CB3, run=False).model.limits


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(_MOVES, st.integers(1, 80), st.floats(0.1, 1.0)), min_size=1, max_size=6))
def test_the_reference_keeps_within_the_joints_limits(steps: list) -> None:
    """Whatever follows upon whatever, at any speed of the slider: no jump, no limit passed."""
    from ur5_twin.control.commands import MoveJ
    from ur5_twin.errors import TwinError
    from ur5_twin.wire.motion import Motion

    scenario = load_scenario("free_motion")
    motion = Motion(scenario.controller_model(), scenario.q_start, CB3.period)
    before = motion.target
    for (kind, numbers, rate), ticks, slider in steps:
        motion.slider = slider
        try:
            if kind == "movej":
                motion.along(MoveJ(tuple(scenario.q_start + numbers), a=rate, v=0.5), np.eye(4))
            elif kind == "servoj":
                motion.servoj(scenario.q_start + numbers, 0.1, rate)
            elif kind == "stopj":
                motion.stop(rate)
            elif kind == "speedj":
                motion.speedj(np.array(numbers), rate)
            else:
                motion.speedl(np.array(numbers), rate, np.zeros(3))
        except TwinError:
            continue
        for _ in range(ticks):
            row = motion.step()
            assert (np.abs(row[0]) <= _LIMITED.q + 1e-9).all()
            assert (np.abs(row[0] - before[0]) <= 1.05 * _LIMITED.qd * CB3.period + 1e-9).all()
            assert (np.abs(row[1]) <= _LIMITED.qd * (1 + 1e-9)).all()
            before = row
