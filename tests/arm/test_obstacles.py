"""Contact with obstacles is a spring, a damper and Coulomb friction in N/m, N s/m and mu; payloads weigh as they do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ur5_twin.arm import inertia, kinematics, mjcf
from ur5_twin.arm.dynamics import Dynamics
from ur5_twin.arm.mjcf.obstacles import MAX_DAMPING, MAX_STIFFNESS, SKIN_MASS, Obstacle, geom_name, set_payload
from ur5_twin.arm.parameters import ArmModel, load_model, load_tool
from ur5_twin.errors import ModelError

PROBE = "ati_gamma+ball_probe"
BALL = np.array([0.0, 0.0, 0.141])  # centre in the flange frame: 53 mm of the sensor and 88 mm of the probe
RADIUS = 0.010
POSES = (
    np.array([0.3, -1.2, 1.6, -1.9, -1.5, 0.4]),
    np.array([2.2, -0.9, -1.7, 0.6, 1.1, -2.0]),
    np.array([-1.0, -2.0, -1.2, -1.4, 0.7, 1.0]),
)
# Of each rotor's inertia: joints that creep to their place within a second and do not swing about it.
DRAG = 40.0


@dataclass
class Press:
    """The arm without weight, its joints dragging, pushed at a point of a body."""

    mj_model: mujoco.MjModel
    data: mujoco.MjData
    body: str
    point: np.ndarray

    @classmethod
    def at(cls, model: ArmModel, q: np.ndarray, obstacles: list[Obstacle], body: str, point: np.ndarray) -> Press:
        mj_model = mjcf.compile(model, obstacles=obstacles)
        data = mujoco.MjData(mj_model)
        data.qpos[:] = q
        mujoco.mj_forward(mj_model, data)
        return cls(mj_model, data, body, point)

    def jacobian(self) -> np.ndarray:
        jacobian = np.zeros((3, 6))
        body = self.data.body(self.body)
        place = body.xpos + body.xmat.reshape(3, 3) @ self.point
        mujoco.mj_jac(self.mj_model, self.data, jacobian, None, place, self.mj_model.body(self.body).id)
        return jacobian

    def run(self, steps: int, force: Callable[[int], np.ndarray], drag: float = DRAG) -> None:
        for step in range(steps):
            mujoco.mj_step1(self.mj_model, self.data)
            rubbing = drag * self.mj_model.dof_armature * self.data.qvel
            self.data.qfrc_applied[:] = self.data.qfrc_bias - rubbing + self.jacobian().T @ force(step)
            mujoco.mj_step2(self.mj_model, self.data)
        mujoco.mj_forward(self.mj_model, self.data)

    def contact(self) -> tuple[float, np.ndarray]:
        """Penetration in m and force (normal, two tangents) in N of the only contact."""
        assert self.data.ncon == 1
        wrench = np.zeros(6)
        mujoco.mj_contactForce(self.mj_model, self.data, 0, wrench)
        return -self.data.contact[0].dist, wrench[:3]


def _plate_at_the_ball(
    q: np.ndarray, gap: float = 0.0, tilt: float = 0.25, **surface: float
) -> tuple[Obstacle, np.ndarray]:
    """A plate that the ball touches from along the tool, tilted a little, and its normal."""
    X = kinematics.forward(load_model("plant"), q)
    normal = X[:3, :3] @ Rotation.from_rotvec([tilt, -tilt, 0.0]).apply([0.0, 0.0, -1.0])
    middle = X[:3, 3] + X[:3, :3] @ BALL - normal * (RADIUS + gap)
    rotation = Rotation.align_vectors([normal], [[0.0, 0.0, 1.0]])[0].as_rotvec()
    values = {"stiffness": 1e4, "damping": 50.0, "friction": 0.5} | surface
    return Obstacle("plate", "plate", middle, rotation, np.array([0.1, 0.1, 0.02]), **values), normal


@pytest.mark.parametrize("stiffness", [1e3, 1e4, 1e5, MAX_STIFFNESS])
@pytest.mark.parametrize("pose", range(len(POSES)))
def test_a_static_force_goes_in_by_force_over_stiffness(stiffness: float, pose: int) -> None:
    plate, normal = _plate_at_the_ball(POSES[pose], stiffness=stiffness, friction=1.0)
    press = Press.at(load_model("plant", PROBE), POSES[pose], [plate], "tool", BALL)
    load = min(20.0, 2e-3 * stiffness)
    press.run(4000, lambda step: -normal * load * min(1.0, step / 200))
    depth, force = press.contact()
    # What is left of the motion after 3 s is some uN; measured 1.00000.
    assert force[0] == pytest.approx(load, rel=0.01)
    assert force[0] / depth == pytest.approx(stiffness, rel=0.002)


@pytest.mark.parametrize(
    ("body", "part", "q"),
    [
        ("upper_arm_link", "cyl2", np.array([0.0, -0.6, 1.0, -0.9, 1.2, 0.3])),
        ("forearm_link", "cyl2", np.array([0.0, -1.2, 1.1, -0.9, 1.2, 0.3])),
        ("wrist_2_link", None, np.array([0.5, -1.2, 1.1, -0.9, 1.2, 0.3])),
    ],
)
def test_links_meet_the_same_surface_as_tools(body: str, part: str | None, q: np.ndarray) -> None:
    """A ball under the middle of one of the link's cylinders, pressed through the middle of that cylinder."""
    model = load_model("plant", PROBE)
    i = mjcf.BODY_NAMES.index(body)
    cylinder = next((c for c in model.links[i].cylinders if c.name == part), model.links[i].cylinders[0])
    X = kinematics.link_frames(model, q)[i + 1]
    along = X[:3, "xyz".index(cylinder.axis)]
    down = np.cross(along, np.cross([0.0, 0.0, -1.0], along))
    down /= np.linalg.norm(down)
    place = X[:3, 3] + X[:3, :3] @ cylinder.center + down * (cylinder.radius + 0.03)
    ball = Obstacle("ball", "sphere", place, np.zeros(3), np.array([0.03]), 2e4, 100.0, 0.5)
    press = Press.at(model, q, [ball], body, cylinder.center)
    press.run(4000, lambda step: down * 20.0 * min(1.0, step / 200))
    depth, force = press.contact()
    assert (
        press.mj_model.geom(press.data.contact[0].geom1).bodyid
        != press.mj_model.geom(press.data.contact[0].geom2).bodyid
    )
    assert force[0] == pytest.approx(20.0, rel=0.01)
    assert force[0] / depth == pytest.approx(2e4, rel=0.01)


def _impact(damping: float, stiffness: float, speed: float, q: np.ndarray) -> tuple[np.ndarray, float, Press]:
    """Rows (penetration, its rate, its second derivative, normal force) of a free arm's impact, and its mass there."""
    plate, normal = _plate_at_the_ball(q, gap=1e-4, stiffness=stiffness, damping=damping, friction=0.0)
    press = Press.at(load_model("plant", PROBE), q, [plate], "tool", BALL)
    full = np.zeros((6, 6))
    mujoco.mj_fullM(press.mj_model, press.data, full)
    along = normal @ press.jacobian()
    # The velocity that a blow along the normal gives: the whole arm meets the plate as one mass.
    mass = 1.0 / (along @ np.linalg.solve(full, along))
    press.data.qvel[:] = -speed * mass * np.linalg.solve(full, along)
    rows = []
    for _ in range(400):
        press.run(1, lambda _: np.zeros(3), drag=0.0)
        if press.data.ncon:
            depth, force = press.contact()
            jacobian = normal @ press.jacobian()
            rows.append([depth, -jacobian @ press.data.qvel, -jacobian @ press.data.qacc, force[0]])
        elif rows:
            break
    return np.array(rows), mass, press


@pytest.mark.parametrize(("stiffness", "damping"), [(5e3, 0.0), (2e4, 100.0), (1e5, MAX_DAMPING)])
def test_impacts_are_those_of_a_spring_and_a_damper(stiffness: float, damping: float) -> None:
    """f = k r + b r' + m_v r'', fitted to every step of an impact at 0.1 m/s."""
    rows, mass, _ = _impact(damping, stiffness, 0.1, POSES[0])
    pushing = rows[rows[:, 3] > 0]
    k, b, m = np.linalg.lstsq(pushing[:, :3], pushing[:, 3], rcond=None)[0]
    # The engine keeps this law at every step, so the fit is as good as float noise lets it be; measured 1e-7.
    assert k == pytest.approx(stiffness, rel=1e-4)
    assert b == pytest.approx(damping, rel=1e-4, abs=0.01)
    assert m == pytest.approx(SKIN_MASS, rel=0.05)
    assert mass > 100 * SKIN_MASS


@pytest.mark.parametrize("friction", [0.2, 0.8])
def test_sliding_begins_at_mu_times_the_normal_force(friction: float) -> None:
    q = POSES[0]
    plate, normal = _plate_at_the_ball(q, stiffness=5e4, friction=friction, tilt=0.0)
    press = Press.at(load_model("plant", PROBE), q, [plate], "tool", BALL)
    aside = np.cross(normal, [1.0, 0.0, 0.0])
    aside /= np.linalg.norm(aside)
    press.run(1500, lambda step: -normal * 20.0 * min(1.0, step / 200))

    def slide(share: float) -> tuple[float, float]:
        """Speed at the end of 0.4 s, m/s, and tangential over normal force."""
        push = -normal * 20.0 + aside * share * friction * 20.0
        press.run(200, lambda _: push)
        force = press.contact()[1]
        return aside @ press.jacobian() @ press.data.qvel, float(np.hypot(*force[1:]) / force[0])

    speed, ratio = slide(0.95)
    assert abs(speed) < 5e-4  # what creeps under 16 N: 0.2 mm/s
    assert ratio < friction
    speed, ratio = slide(1.1)
    assert speed > 5e-4
    # Sliding is on the cone's edge; the solver's tolerance.
    assert ratio == pytest.approx(friction, rel=1e-3)


def test_a_smooth_surface_holds_nothing_aside() -> None:
    plate, normal = _plate_at_the_ball(POSES[0], friction=0.0)
    press = Press.at(load_model("plant", PROBE), POSES[0], [plate], "tool", BALL)
    press.run(500, lambda _: -normal * 20.0)
    assert press.data.contact[0].dim == 1


@pytest.mark.parametrize("tool", ["ati_gamma", "ati_gamma+xsens_mti", "peg"])
def test_a_flat_end_on_a_plate_is_one_contact_and_as_stiff(tool: str) -> None:
    """Faces in full contact would give up to eight points, each with the full stiffness, if MuJoCo looked for all."""
    model = load_model("plant", tool)
    q = POSES[0]
    X = kinematics.forward(model, q)
    height = max(part.center[2] + (part.radius if tool == "peg" else 0.0) for part in model.tool.parts)
    if tool != "peg":
        height = model.tool.height
    normal = -X[:3, 2]
    place = X[:3, 3] + X[:3, 2] * height
    rotation = Rotation.align_vectors([normal], [[0.0, 0.0, 1.0]])[0].as_rotvec()
    plate = Obstacle("plate", "plate", place, rotation, np.array([0.2, 0.2, 0.02]), 2e4, 200.0, 0.5)
    press = Press.at(model, q, [plate], "tool", np.array([0.0, 0.0, height]))
    press.run(3000, lambda step: -normal * 20.0 * min(1.0, step / 200))
    depth, force = press.contact()
    # The touching point of two faces is any of them, and they tilt against each other: some N go on turning the arm.
    assert force[0] == pytest.approx(20.0, rel=0.1)
    assert force[0] / depth == pytest.approx(2e4, rel=0.01)


def test_stiffness_does_not_depend_on_what_the_arm_carries() -> None:
    plate, _ = _plate_at_the_ball(POSES[0])
    for tool in ("ball_probe", PROBE):
        mj_model = mjcf.compile(load_model("plant", tool), obstacles=[plate], payload=True)
        before = mj_model.pair_solref.copy(), mj_model.body_invweight0.copy()
        set_payload(mj_model, mujoco.MjData(mj_model), 2.0, np.array([0.0, 0.0, 0.1]), np.zeros((3, 3)))
        np.testing.assert_array_equal(mj_model.pair_solref, before[0])
        np.testing.assert_array_equal(mj_model.body_invweight0, before[1])


def test_where_plates_and_walls_have_their_faces() -> None:
    size = np.array([0.2, 0.4, 0.6])
    turned = np.array([0.0, 0.0, np.pi / 2])
    corners = {
        shape: Obstacle("o", shape, np.array([1.0, 2.0, 3.0]), turned, size, 1e4, 10.0, 0.5).center()
        for shape in ("box", "plate", "wall")
    }
    np.testing.assert_allclose(corners["box"], [1, 2, 3], atol=1e-12)
    np.testing.assert_allclose(corners["plate"], [1, 2, 2.7], atol=1e-12)
    np.testing.assert_allclose(corners["wall"], [1, 1.9, 3], atol=1e-12)  # turned, its face looks along +y


def test_the_arm_itself_and_the_lab_are_as_they_were() -> None:
    """Obstacles add geoms and pairs; the arm's own numbers, what it excludes and what the lab has do not change."""
    model = load_model("plant", "ati_gamma")
    far = Obstacle("far", "box", np.array([3.0, 0.0, 0.0]), np.zeros(3), np.full(3, 0.1), 1e4, 10.0, 0.5)
    for scene in (False, True):
        bare, with_it = mjcf.compile(model, scene=scene), mjcf.compile(model, scene=scene, obstacles=[far])
        assert with_it.ngeom == bare.ngeom + 1
        assert bare.npair == 0
        assert with_it.npair == 17 + 2
        np.testing.assert_array_equal(with_it.body_mass, bare.body_mass)
        np.testing.assert_array_equal(with_it.exclude_signature, bare.exclude_signature)
        geom = with_it.geom(geom_name(far))
        assert geom.contype == geom.conaffinity == 0
        folded = np.array([0.0, 0.6, 2.6, 0.0, 0.0, 0.0])
        touched = []
        for mj_model in (bare, with_it):
            data = mujoco.MjData(mj_model)
            data.qpos[:] = folded
            mujoco.mj_forward(mj_model, data)
            touched.append({tuple(sorted(mj_model.geom(g).name for g in contact.geom)) for contact in data.contact})
        assert touched[0] == touched[1]


def _payload_model(model: ArmModel, mass: float, center: np.ndarray, tensor: np.ndarray) -> ArmModel:
    """The same arm with the payload as part of its tool."""
    tool = model.tool
    if tool is None:
        tool = load_tool("ball_probe")
        assert tool is not None
        return model.with_tool(replace(tool, mass=mass, center=center, inertia=tensor))
    both = inertia.combine(
        np.array([tool.mass, mass]), np.array([tool.center, center]), np.array([tool.inertia, tensor])
    )
    return model.with_tool(replace(tool, mass=both[0], center=both[1], inertia=both[2]))


@pytest.mark.parametrize("tool", ["none", "ati_gamma"])
def test_a_payload_weighs_and_resists_like_a_tool(tool: str) -> None:
    model = load_model("plant", tool)
    mj_model = mjcf.compile(model, payload=True)
    data = mujoco.MjData(mj_model)
    rng = np.random.default_rng(5)
    q, qd = rng.uniform(-2, 2, 6), rng.uniform(-1, 1, 6)
    data.qpos[:], data.qvel[:] = q, qd
    turn = Rotation.from_rotvec([0.4, -0.2, 0.9]).as_matrix()
    tensor = turn @ inertia.box(2.5, np.array([0.1, 0.2, 0.3])) @ turn.T
    center = np.array([0.02, -0.03, 0.12])
    for mass, dynamics in (
        (0.0, Dynamics(model)),
        (2.5, Dynamics(_payload_model(model, 2.5, center, tensor))),
        (0.0, Dynamics(model)),
    ):
        set_payload(mj_model, data, mass, center, tensor if mass else np.zeros((3, 3)))
        np.testing.assert_array_equal(data.qpos, q)
        mujoco.mj_forward(mj_model, data)
        full = np.zeros((6, 6))
        mujoco.mj_fullM(mj_model, data, full)
        # Two algorithms on numbers of order 10 to 100.
        np.testing.assert_allclose(data.qfrc_bias, dynamics.bias(q, qd), atol=1e-9)
        np.testing.assert_allclose(full, dynamics.mass_matrix(q), atol=1e-9)


def test_a_payload_needs_its_body_and_a_possible_tensor() -> None:
    bare = mjcf.compile(load_model("plant"))
    with pytest.raises(ModelError, match="compile it with payload=True"):
        set_payload(bare, mujoco.MjData(bare), 1.0, np.zeros(3), np.zeros((3, 3)))
    mj_model = mjcf.compile(load_model("plant"), payload=True)
    data = mujoco.MjData(mj_model)
    with pytest.raises(ModelError, match="mass"):
        set_payload(mj_model, data, -1.0, np.zeros(3), np.zeros((3, 3)))
    with pytest.raises(ModelError, match="principal moments"):
        set_payload(mj_model, data, 1.0, np.zeros(3), np.diag([1.0, 1.0, 3.0]))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"stiffness": 0.0}, "stiffness must be above 0"),
        ({"stiffness": -1e4}, "stiffness must be above 0"),
        ({"stiffness": 2 * MAX_STIFFNESS}, "stiffness .* at most 500000 N/m"),
        ({"stiffness": float("nan")}, "stiffness"),
        ({"damping": -1.0}, "damping must be between"),
        ({"damping": 2 * MAX_DAMPING}, "damping must be between"),
        ({"friction": -0.1}, "friction must be between"),
        ({"size": np.array([0.1, 0.1])}, "size of a box has 3 numbers, not 2"),
        ({"size": np.array([0.1, 0.0, 0.1])}, "size must be positive"),
        ({"position": np.array([0.0, np.inf, 0.0])}, "position must be finite"),
        ({"shape": "cone"}, "shape 'cone' is none of plate, wall, box, sphere, cylinder"),
        ({"name": "my box"}, "name must be"),
    ],
)
def test_impossible_obstacles(change: dict[str, object], said: str) -> None:
    good = Obstacle("box", "box", np.zeros(3), np.zeros(3), np.full(3, 0.1), 1e4, 10.0, 0.5)
    with pytest.raises(ModelError, match=said):
        replace(good, **change)


def test_two_obstacles_of_one_name() -> None:
    box = Obstacle("box", "box", np.ones(3), np.zeros(3), np.full(3, 0.1), 1e4, 10.0, 0.5)
    with pytest.raises(ModelError, match="two obstacles are named 'box'"):
        mjcf.build(load_model("plant"), obstacles=[box, box])
