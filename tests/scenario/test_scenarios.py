"""Scenario files: what ships works, and what is wrong is named by its key."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from ur5_twin.arm import kinematics, mjcf, singularities
from ur5_twin.arm.parameters import load_model
from ur5_twin.errors import ScenarioError
from ur5_twin.resources import data_dir
from ur5_twin.scenario import LogPush, MoveJ, MoveL, Push, Scenario, ServoJ, Wait, Waypoints, load_scenario
from ur5_twin.scenario import scenario_names as names

HEAD = 'title = "A test"\ndescription = "For a test."\n'
DOWN = "[start]\nposition_mm = [450, -150, 400]\nrotation_rad = [3.141592653589793, 0, 0]\n"


@pytest.fixture
def made(tmp_path: Path) -> Callable[[str], Scenario]:
    def make(text: str, head: str = HEAD) -> Scenario:
        path = tmp_path / "mine.toml"
        path.write_text(head + text, encoding="utf-8")
        return load_scenario(path)

    return make


# ---------------------------------------------------------------- what ships


def test_what_ships() -> None:
    expected = {"press_plate", "slide_plate", "collide_005", "collide_025", "collide_100", "push_moving", "free_motion"}
    expected |= {f"push_{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")}
    expected |= {"forearm_contact", "elbow_contact", "payload_pickup", "peg_in_hole", "empty_cell"}
    expected |= {f"singularity_{name}" for name in ("shoulder", "elbow", "wrist")}
    assert set(names()) == expected
    table = (data_dir("scenarios") / "README.md").read_text(encoding="utf-8")
    for name in names():
        assert f"| `{name}` |" in table


@pytest.mark.parametrize("name", names())
def test_a_shipped_scenario_starts_in_free_air(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.title
    assert scenario.description.endswith(".")
    mj_model = mjcf.compile(scenario.plant_model(), scene=True, obstacles=scenario.obstacles)
    data = mujoco.MjData(mj_model)
    data.qpos[:] = scenario.q_start
    mujoco.mj_forward(mj_model, data)
    assert data.ncon == 0


@pytest.mark.parametrize(
    ("name", "obstacle", "part"),
    [
        ("press_plate", "plate", "tool_probe_ball"),
        ("slide_plate", "plate", "tool_probe_ball"),
        ("collide_005", "box", "tool_probe_ball"),
        ("collide_025", "box", "tool_probe_ball"),
        ("collide_100", "box", "tool_probe_ball"),
        ("peg_in_hole", "right", "tool_peg_body"),
        ("forearm_contact", "bar", "forearm_link_cyl2"),
        ("elbow_contact", "post", "upper_arm_link_cyl1_2"),
    ],
)
def test_a_motion_meets_its_obstacle_where_it_is_meant_to(name: str, obstacle: str, part: str) -> None:
    """On the way through the targets, were there no obstacle, this part gets there first, and not by half a step."""
    scenario = load_scenario(name)
    model = scenario.plant_model()
    mj_model = mjcf.compile(model, scene=True, obstacles=scenario.obstacles)
    data = mujoco.MjData(mj_model)
    for q in _way(scenario):
        data.qpos[:] = q
        mujoco.mj_forward(mj_model, data)
        if data.ncon:
            break
    touching = {mj_model.geom(geom).name for contact in data.contact for geom in contact.geom}
    assert touching == {f"obstacle_{obstacle}", part}


@pytest.mark.parametrize("name", [name for name in names() if not load_scenario(name).obstacles])
def test_where_nothing_is_nothing_is_touched(name: str) -> None:
    """Not the arm itself either."""
    scenario = load_scenario(name)
    mj_model = mjcf.compile(scenario.plant_model(), scene=True)
    data = mujoco.MjData(mj_model)
    for q in _way(scenario):
        data.qpos[:] = q
        mujoco.mj_forward(mj_model, data)
        assert data.ncon == 0


@pytest.mark.parametrize("name", ["shoulder", "elbow", "wrist"])
def test_singular_scenarios_come_near_their_family_only(name: str) -> None:
    scenario = load_scenario(f"singularity_{name}")
    there = scenario.motions[1]
    assert isinstance(there, MoveJ)
    distances = singularities.distances(scenario.plant_model(), there.q)
    # 11 mm or 3.1 degrees of the one, ten times that from the others.
    near = {"shoulder": 0.011, "elbow": 0.054, "wrist": 0.054}
    for family, limit in near.items():
        distance = abs(float(getattr(distances, family)))
        assert distance < limit if family == name else distance > 4 * limit


def _way(scenario: Scenario) -> np.ndarray:
    """Joint positions on the way through the targets, 1 mm or 1 degree apart or less, as far as files do not say."""
    from ur5_twin.arm import inverse_kinematics

    model, q = scenario.plant_model(), scenario.q_start
    rows = [q]
    for motion in scenario.motions:
        if isinstance(motion, MoveJ):
            steps = int(np.abs(motion.q - q).max() / np.radians(1.0)) + 1
            rows += [q + (motion.q - q) * (k + 1) / steps for k in range(steps)]
        elif isinstance(motion, MoveL):
            X = kinematics.forward(model, q)
            way = motion.X_BF[:3, 3] - X[:3, 3]
            steps = int(np.linalg.norm(way) / 1e-3) + 1
            for k in range(steps):
                X_k = motion.X_BF.copy()
                X_k[:3, 3] = X[:3, 3] + way * (k + 1) / steps
                rows.append(inverse_kinematics.nearest(model, X_k, rows[-1]))
        q = rows[-1]
    return np.array(rows)


# ---------------------------------------------------------------- what files say


def test_a_file_of_two_lines_is_a_scenario(made: Callable[..., Scenario]) -> None:
    scenario = made("")
    assert (scenario.arm.controller, scenario.arm.plant, scenario.arm.gains) == ("controller", "plant", "servo")
    assert scenario.motions == scenario.obstacles == scenario.pushes == scenario.payloads == ()
    assert scenario.duration is None
    assert scenario.limits.force == np.inf
    assert scenario.temperature.warm_for == np.inf
    assert scenario.sensors.preset == "lab"
    np.testing.assert_array_equal(scenario.plant_model().rotor_inertia, load_model("plant").rotor_inertia)


def test_units_become_si(made: Callable[..., Scenario], tmp_path: Path) -> None:
    (tmp_path / "stream.csv").write_text("0,0,0,0,0,0,0\n", encoding="utf-8")
    scenario = made(
        'duration_s = 30\n[arm]\ntool = "ati_gamma"\n[start]\nq_deg = [0, -90, 90, 0, 90, 0]\n'
        '[[motion]]\ntype = "movej"\nq_rad = [0, -1, 1, 0, 1, 0]\nspeed_rad_s = 0.5\nblend_mm = 20\n'
        '[[motion]]\ntype = "movel"\nby_mm = [10, 0, -20]\nspeed_m_s = 0.1\n'
        '[[motion]]\ntype = "wait"\nduration_s = 2\n'
        '[[motion]]\ntype = "servoj"\nfile = "stream.csv"\n'
        '[[motion]]\ntype = "waypoints"\nfile = "stream.csv"\nspace = "task_space"\nwait_s = 1\n'
        '[[obstacle]]\nname = "post"\nshape = "cylinder"\nposition_mm = [500, 0, 100]\nradius_mm = 20\n'
        "height_mm = 300\nstiffness_n_m = 1e4\n"
        '[[push]]\nbody = "forearm_link"\npoint_mm = [100, 0, 0]\nframe = "body"\nprofile = "ramp"\nat_s = 1\n'
        "duration_s = 4\nrise_s = 1\nforce_n = [0, 0, 20]\n"
        "[[payload]]\nat_s = 3\nmass_kg = 1.5\ncenter_mm = [0, 0, 50]\ninertia_kg_m2 = [0.01, 0.01, 0.005]\n"
        "[temperature]\nwarm_for_s = 60\n[limits]\nforce_n = 150\n"
        '[sensors]\npreset = "ideal"\nlate_packages = true\n'
    )
    np.testing.assert_allclose(scenario.q_start, np.radians([0, -90, 90, 0, 90, 0]))
    move_j, move_l, wait, servo_j, waypoints = scenario.motions
    assert isinstance(move_j, MoveJ)
    assert (move_j.speed, move_j.acceleration, move_j.blend) == (0.5, 1.4, 0.02)
    assert isinstance(move_l, MoveL)
    expected = kinematics.forward(load_model("plant"), move_j.q)
    expected[:3, 3] += [0.01, 0, -0.02]
    np.testing.assert_allclose(move_l.X_BF, expected, atol=1e-12)
    assert wait == Wait(2.0)
    assert servo_j == ServoJ(tmp_path / "stream.csv", 0.1, 300.0)
    assert waypoints == Waypoints(tmp_path / "stream.csv", "task_space", 1.0)
    np.testing.assert_allclose(scenario.obstacles[0].size, [0.02, 0.3])
    push = scenario.pushes[0]
    assert isinstance(push, Push)
    assert (push.body, push.turning, push.end) == ("forearm_link", True, 5.0)
    np.testing.assert_allclose(push.point, [0.1, 0, 0])
    np.testing.assert_allclose(scenario.payloads[0].center, [0, 0, 0.05])
    assert scenario.payloads[0].declared_at is None
    assert scenario.temperature.warm_for == 60.0
    assert scenario.limits.force == 150.0
    assert scenario.sensors.late_packages
    assert scenario.last_event() == 5.0


def test_profiles_of_pushes(made: Callable[..., Scenario]) -> None:
    times = "at_s = 2\nduration_s = 4\nforce_n = [0, 0, 10]\nmoment_nm = [1, 0, 0]\n"
    pushes = made(
        f'[[push]]\nprofile = "half_sine"\n{times}'
        f'[[push]]\nprofile = "ramp"\nrise_s = 1\n{times}'
        f'[[push]]\nprofile = "step"\n{times}'
    ).pushes
    t = np.array([1.9, 2.5, 3.0, 4.0, 5.5, 6.1])
    expected = (
        [0.0, np.sin(np.pi / 8), np.sin(np.pi / 4), 1.0, np.sin(np.pi / 8), 0.0],
        [0.0, 0.5, 1.0, 1.0, 0.5, 0.0],
        [0.0, 1.0, 1.0, 1.0, 1.0, 0.0],
    )
    for push, share in zip(pushes, expected, strict=True):
        assert isinstance(push, Push)
        np.testing.assert_allclose(push.wrench(t)[:, 2], 10 * np.array(share), atol=1e-12)
        np.testing.assert_allclose(push.wrench(t)[:, 3], np.array(share), atol=1e-12)
        assert push.wrench(3.0).shape == (6,)
        # Without a tool the flange is the frame of the last link.
        assert push.body == "wrist_3_link"


def test_a_log_as_a_push(made: Callable[..., Scenario], tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    text = '[[push]]\nprofile = "log"\nlog = "run"\nat_s = 1\nfirst_s = 2\nlast_s = 9\nscale = 0.5\n'
    (push,) = made(text).pushes
    assert isinstance(push, LogPush)
    assert (push.path, push.first, push.last, push.scale) == (tmp_path / "run", 2.0, 9.0, 0.5)
    with pytest.raises(ScenarioError, match=r"push\[0\]\.last_s: must be later than first_s"):
        made(text.replace("last_s = 9", "last_s = 1"))


def test_a_pose_is_reached_near_the_start_and_moves_add_up(made: Callable[..., Scenario]) -> None:
    scenario = made(
        DOWN + '[[motion]]\ntype = "movel"\nby_mm = [0, 0, -50]\n'
        '[[motion]]\ntype = "movel"\nby_mm = [0, 0, 30]\nframe = "flange"\n'
        '[[motion]]\ntype = "movel"\nposition_mm = [400, -150, 350]\n'
        '[[motion]]\ntype = "movel"\nturn_by_rad = [0, 0, 0.5]\n'
    )
    X = kinematics.forward(load_model("plant"), scenario.q_start)
    np.testing.assert_allclose(X[:3, 3], [0.45, -0.15, 0.4], atol=1e-9)
    first, second, third, fourth = (motion.X_BF for motion in scenario.motions if isinstance(motion, MoveL))
    np.testing.assert_allclose(first[:3, 3], [0.45, -0.15, 0.35], atol=1e-9)
    np.testing.assert_allclose(second[:3, 3], [0.45, -0.15, 0.32], atol=1e-9)  # the flange looks down
    np.testing.assert_allclose(third[:3, :3], X[:3, :3], atol=1e-9)
    turn = np.array([[np.cos(0.5), -np.sin(0.5), 0], [np.sin(0.5), np.cos(0.5), 0], [0, 0, 1]])
    np.testing.assert_allclose(fourth[:3, :3], turn @ X[:3, :3], atol=1e-9)


def test_a_mismatch_changes_the_plant_and_not_the_controller(made: Callable[..., Scenario]) -> None:
    scenario = made(
        '[arm]\ntool = "ati_gamma"\ndeclared_payload = "none"\n'
        "[mismatch]\nlink_mass_scale = [1, 1.1, 1, 1, 1, 1]\nrotor_scale = [1, 1, 1, 0.9, 1, 1]\n"
        "link_center_shift_mm = [[0,0,0],[0,0,0],[5,0,0],[0,0,0],[0,0,0],[0,0,0]]\ngravity_scale = 0.99\n"
    )
    plant, known = scenario.plant_model(), load_model("plant")
    assert plant.links[1].mass == pytest.approx(1.1 * known.links[1].mass, rel=1e-12)
    np.testing.assert_allclose(plant.links[1].inertia, 1.1 * known.links[1].inertia)
    np.testing.assert_allclose(plant.links[2].center - known.links[2].center, [0.005, 0, 0], atol=1e-12)
    assert plant.rotor_inertia[3] == pytest.approx(0.9 * known.rotor_inertia[3], rel=1e-12)
    assert plant.gravity == pytest.approx(0.99 * known.gravity, rel=1e-12)
    assert plant.tool is not None
    assert scenario.controller_model().tool is None
    assert scenario.controller_model().gravity == load_model("controller").gravity


# ---------------------------------------------------------------- what is wrong

_BOX = '[[obstacle]]\nname = "b"\nshape = "box"\nposition_mm = [1, 1, 1]\nsize_mm = [1, 1, 1]\nstiffness_n_m = 1e4\n'
_PUSH = '[[push]]\nprofile = "step"\nat_s = 1\nduration_s = 1\nforce_n = [1, 0, 0]\n'
_WAIT = '[[motion]]\ntype = "wait"\nduration_s = 1\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("seeds = 1\n", r"mine\.toml: unknown key seeds; did you mean 'seed'\? \(known there: .*title"),
        (
            "[arm]\ntols = 'x'\n",
            r"unknown key arm\.tols.*known there: controller, declared_payload, gains, plant, tool\)",
        ),
        (_PUSH + _PUSH + "forse_n = [1, 0, 0]\n", r"unknown key push\[1\]\.forse_n; did you mean 'force_n'\?.*profile"),
        (_WAIT + "speed_m_s = 1\n", r"unknown key motion\[0\]\.speed_m_s \(known there: duration_s, type\)"),
        ("[[motion]]\ntype = 'jump'\n", r"motion\[0\]\.type: .*'jump'.*known: movej, movel, wait, servoj, waypoints"),
        ("[[motion]]\nduration_s = 1\n", r"motion\[0\]\.type is missing"),
        ("[[motion]]\ntype = 'wait'\n", r"motion\[0\]\.duration_s is missing"),
        ("[[motion]]\ntype = 'wait'\nduration_s = -1\n", r"motion\[0\]\.duration_s: .*> 0"),
        (_PUSH.replace("[1, 0, 0]", "[1, 0]"), r"push\[0\]\.force_n: .*length 3"),
        (_PUSH.replace("[1, 0, 0]", "[1, 0, nan]"), r"push\[0\]\.force_n\[2\] is no number"),
        (_PUSH.replace("[1, 0, 0]", "[0, 0, 0]"), r"push\[0\]\.force_n: or moment_nm must be other than zero"),
        (_PUSH + "body = 'elbow'\n", r"push\[0\]\.body: .*'elbow'"),
        ("duration_s = 1\n" + _PUSH, r"push\[0\]\.at_s: 1 s is not before the end at 1 s"),
        (_PUSH.replace('"step"', '"ramp"\nrise_s = 0.6'), r"push\[0\]\.rise_s: rise and fall must fit"),
        (_BOX.replace("1e4", "0"), r"obstacle\[0\]\.stiffness_n_m: .*> 0"),
        (_BOX.replace("1e4", "-1e4"), r"obstacle\[0\]\.stiffness_n_m: .*> 0"),
        (_BOX.replace("1e4", "1e6"), r"obstacle\[0\]\.stiffness_n_m: .*<= 500000"),
        (_BOX + "damping_n_s_m = 1e4\n", r"obstacle\[0\]\.damping_n_s_m: .*<= 500"),
        (_BOX + "radius_mm = 5\n", r"unknown key obstacle\[0\]\.radius_mm"),
        (_BOX + _BOX, r"obstacle\[1\]\.name: there is another obstacle 'b'"),
        ("[arm]\ntool = 'gripper'\n", r"arm\.tool: unknown tool 'gripper'"),
        ("[arm]\nplant = 'd'\n", r"arm\.plant: unknown model 'd'"),
        ("[arm]\ngains = 'soft'\n", r"arm\.gains: unknown gain set 'soft'"),
        ("[start]\nq_deg = [0, 0, 0, 0, 0, 400]\n", r"start\.q_deg\[5\]: 6\.981 rad is beyond"),
        ("[start]\nq_deg = [0,0,0,0,0,0]\nq_rad = [0,0,0,0,0,0]\n", r"start: give one of .*not q_rad and q_deg"),
        ("[start]\nposition_mm = [2000, 0, 0]\nrotation_rad = [0, 0, 0]\n", r"start\.position_mm: .*cannot reach"),
        ("[start]\nposition_mm = [500, 0, 0]\n", r"start\.rotation_rad: is missing"),
        ("[[motion]]\ntype = 'movej'\n", r"motion\[0\]: a movej needs"),
        ("[[motion]]\ntype = 'movej'\nq_rad = [0,0,0,0,0,0]\nspeed_rad_s = 50\n", r"motion\[0\]\.speed_rad_s: .*limit"),
        ("[[motion]]\ntype = 'movel'\n", r"motion\[0\]: a movel needs"),
        ("[[motion]]\ntype = 'movel'\nby_mm = [0, 0, 2000]\n", r"motion\[0\]\.by_mm: .*cannot reach"),
        ("[[motion]]\ntype = 'waypoints'\nfile = 'no.csv'\n", r"motion\[0\]\.file: there is no .*no\.csv"),
        ("[[payload]]\nat_s = 2\nmass_kg = -1\n", r"payload\[0\]\.mass_kg: .*>= 0"),
        ("[[payload]]\nat_s = 2\nmass_kg = 1\n[[payload]]\nat_s = 1\nmass_kg = 0\n", r"payload\[1\]\.at_s: .*order"),
        ("[[payload]]\nat_s = 2\nmass_kg = 1\ninertia_kg_m2 = [1, 1, 3]\n", r"payload\[0\]\.inertia_kg_m2"),
        ("[mismatch]\nrotor_scale = [1, 1, 1, 1, 1, 0]\n", r"mismatch\.rotor_scale\[5\]: .*> 0"),
        ("[sensors]\npreset = 'best'\n", r"sensors\.preset: .*'best'"),
    ],
)
def test_errors_name_the_key(made: Callable[..., Scenario], text: str, said: str) -> None:
    with pytest.raises(ScenarioError, match=said) as caught:
        made(text)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("mine.toml: ")


def test_files_that_are_none(made: Callable[..., Scenario], tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"mine\.toml: description is missing"):
        made("", head='title = "A test"\n')
    with pytest.raises(ScenarioError, match=r"mine\.toml: title: must not be empty"):
        made("", head='title = " "\ndescription = "For a test."\n')
    with pytest.raises(ScenarioError, match=r"mine\.toml is not valid TOML"):
        made("[[motion")
    with pytest.raises(ScenarioError, match=r"cannot read .*nowhere\.toml"):
        load_scenario(tmp_path / "nowhere.toml")
    with pytest.raises(ScenarioError, match="unknown scenario 'pres_plate'; did you mean 'press_plate'"):
        load_scenario("pres_plate")
