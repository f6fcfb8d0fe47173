"""The MuJoCo model is the arm model: same numbers, same frames, a file any viewer loads."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from ur5_twin.arm import mjcf
from ur5_twin.arm.files import model_path
from ur5_twin.arm.parameters import JOINT_NAMES, ArmModel, load_model, model_names
from ur5_twin.errors import ModelError
from ur5_twin.resources import data_dir

TOOLS = ("none", "ati_gamma", "xsens_mti", "both")
# The file has 15 digits; a product of six transforms adds float noise.
ROUNDING = 1e-13


@pytest.fixture(params=model_names())
def model(request: pytest.FixtureRequest) -> ArmModel:
    return load_model(request.param)


def _names(mj_model: mujoco.MjModel, kind: mujoco.mjtObj, count: int) -> list[str]:
    return [mujoco.mj_id2name(mj_model, kind, i) for i in range(count)]


def _geom_names(mj_model: mujoco.MjModel) -> list[str]:
    return _names(mj_model, mujoco.mjtObj.mjOBJ_GEOM, mj_model.ngeom)


def _tensor(mj_model: mujoco.MjModel, name: str) -> np.ndarray:
    """A body's tensor about its mass centre in the body's axes."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, mj_model.body(name).iquat)
    R = rotation.reshape(3, 3)
    return R @ np.diag(mj_model.body(name).inertia) @ R.T


def _dh_frames(model: ArmModel, q: np.ndarray) -> list[np.ndarray]:
    """Frames 0 to 6 in the base frame, thesis equation 2.19 written out."""
    frames = [np.eye(4)]
    for theta, d, a, alpha in zip(q, model.dh.d, model.dh.a, model.dh.alpha, strict=True):
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        step = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        frames.append(frames[-1] @ np.array(step))
    return frames


def _at(mj_model: mujoco.MjModel, q: np.ndarray, qd: np.ndarray | None = None) -> mujoco.MjData:
    data = mujoco.MjData(mj_model)
    data.qpos[:] = q
    if qd is not None:
        data.qvel[:] = qd
    mujoco.mj_forward(mj_model, data)
    return data


def test_masses_centres_and_tensors(model: ArmModel) -> None:
    mj_model = mjcf.compile(model)
    for name, link in zip(mjcf.BODY_NAMES, model.links, strict=True):
        body = mj_model.body(name)
        assert body.mass == pytest.approx(link.mass, rel=1e-14)
        np.testing.assert_allclose(body.ipos, link.center, atol=ROUNDING)
        # 1e-12 kg m^2 stands for a point: a body that MuJoCo moves needs a tensor.
        expected = link.inertia if link.inertia.any() else 1e-12 * np.eye(3)
        # MuJoCo's eigenvectors are good to 1e-11 or so, and rotating back shows it.
        np.testing.assert_allclose(_tensor(mj_model, name), expected, atol=1e-10 * np.abs(expected).max(), rtol=0)


def test_rotors_gravity_limits(model: ArmModel) -> None:
    mj_model = mjcf.compile(model)
    np.testing.assert_array_equal(mj_model.dof_armature, model.rotor_inertia)
    np.testing.assert_array_equal(mj_model.opt.gravity, [0, 0, -model.gravity])
    assert mj_model.jnt_limited.all()
    np.testing.assert_allclose(mj_model.jnt_range, np.outer(model.limits.q, [-1, 1]), rtol=1e-14)
    torque = np.outer(model.limits.torque, [-1, 1])
    np.testing.assert_array_equal(mj_model.actuator_ctrlrange, torque)
    np.testing.assert_array_equal(mj_model.actuator_forcerange, torque)
    np.testing.assert_array_equal(mj_model.jnt_actfrcrange, torque)
    assert not mj_model.dof_damping.any()
    assert not mj_model.dof_frictionloss.any()


def test_names_and_order(model: ArmModel) -> None:
    mj_model = mjcf.compile(model)
    assert _names(mj_model, mujoco.mjtObj.mjOBJ_BODY, mj_model.nbody) == ["world", "base", *mjcf.BODY_NAMES]
    assert _names(mj_model, mujoco.mjtObj.mjOBJ_JOINT, mj_model.njnt) == list(JOINT_NAMES)
    assert _names(mj_model, mujoco.mjtObj.mjOBJ_ACTUATOR, mj_model.nu) == list(JOINT_NAMES)


def test_frames_are_the_dh_frames(model: ArmModel) -> None:
    mj_model = mjcf.compile(model)
    rng = np.random.default_rng(1)
    for q in (np.zeros(6), *rng.uniform(-2 * np.pi, 2 * np.pi, (20, 6))):
        data = _at(mj_model, q)
        frames = _dh_frames(model, q)
        for site, frame in [(f"dh_{i}", frame) for i, frame in enumerate(frames)] + [("flange", frames[6])]:
            np.testing.assert_allclose(data.site(site).xpos, frame[:3, 3], atol=ROUNDING)
            np.testing.assert_allclose(data.site(site).xmat.reshape(3, 3), frame[:3, :3], atol=ROUNDING)
        for i, name in enumerate(JOINT_NAMES):
            np.testing.assert_allclose(data.joint(name).xaxis, frames[i][:3, 2], atol=ROUNDING)
            np.testing.assert_allclose(data.joint(name).xanchor, frames[i][:3, 3], atol=ROUNDING)


def test_mass_matrix_is_the_sum_over_bodies(model: ArmModel) -> None:
    """M = sum m Jv' Jv + Jw' I Jw + rotors (thesis equation 2.64), with Jacobians of the engine and our tensors."""
    mj_model = mjcf.compile(model)
    data = _at(mj_model, np.random.default_rng(2).uniform(-3, 3, 6))
    expected = np.diag(model.rotor_inertia)
    for name, link in zip(mjcf.BODY_NAMES, model.links, strict=True):
        jv, jw = np.zeros((3, 6)), np.zeros((3, 6))
        mujoco.mj_jacBodyCom(mj_model, data, jv, jw, mj_model.body(name).id)
        R = data.body(name).xmat.reshape(3, 3)
        expected = expected + link.mass * jv.T @ jv + jw.T @ R @ link.inertia @ R.T @ jw
    full = np.zeros((6, 6))
    mujoco.mj_fullM(mj_model, data, full)
    # The stand-in tensor of a point mass adds at most six times 1e-12 to a diagonal of order 1.
    np.testing.assert_allclose(full, expected, atol=1e-11)


@pytest.mark.parametrize(("name", "count"), [("a", 6), ("b", 6), ("c", 17), ("controller", 17), ("plant", 17)])
def test_every_cylinder_of_the_model_is_a_geom(name: str, count: int) -> None:
    model = load_model(name)
    mj_model = mjcf.compile(model)
    cylinders = [geom for geom in _geom_names(mj_model) if "_cyl" in geom]
    assert len(cylinders) == count
    for body, link in zip(mjcf.BODY_NAMES, model.links, strict=True):
        for part in link.cylinders:
            geom = mj_model.geom(f"{body}_{part.name}")
            assert geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER
            np.testing.assert_allclose(geom.size[:2], [part.radius, part.height / 2], rtol=1e-14)
            np.testing.assert_allclose(geom.pos, part.center, atol=ROUNDING)
            rotation = np.zeros(9)
            mujoco.mju_quat2Mat(rotation, geom.quat)
            axis = np.abs(rotation.reshape(3, 3)[:, 2])
            np.testing.assert_allclose(axis, np.eye(3)["xyz".index(part.axis)], atol=1e-15)
            assert geom.contype == 1
            assert geom.group == 1


def test_what_is_drawn_beside_the_cylinders_neither_collides_nor_weighs(model: ArmModel) -> None:
    mj_model = mjcf.compile(model)
    trim = [geom for geom in _geom_names(mj_model) if "_cyl" not in geom and geom != "base"]
    assert trim
    for name in trim:
        geom = mj_model.geom(name)
        assert geom.contype == 0
        assert geom.conaffinity == 0
        assert geom.group == 2
    assert mj_model.body_subtreemass[0] == pytest.approx(sum(link.mass for link in model.links), rel=1e-14)


@pytest.mark.parametrize("tool", TOOLS)
def test_a_tool_is_a_body_of_its_own(tool: str) -> None:
    model = load_model("plant", tool)
    mj_model = mjcf.compile(model)
    assert mj_model.body_subtreemass[0] == pytest.approx(model.bodies()[0].sum(), rel=1e-14)
    if model.tool is None:
        assert mj_model.nbody == 8
        return
    body = mj_model.body("tool")
    assert body.parentid == mj_model.body("wrist_3_link").id
    assert body.jntnum == 0
    np.testing.assert_array_equal(body.pos, np.zeros(3))
    np.testing.assert_allclose(body.ipos, model.tool.center, atol=ROUNDING)
    np.testing.assert_allclose(_tensor(mj_model, "tool"), model.tool.inertia, atol=1e-13)
    for sensor, origin in model.tool.sensors.items():
        site = mj_model.site(sensor)
        assert site.bodyid == body.id
        np.testing.assert_allclose(site.pos, origin, atol=ROUNDING)
    assert len([geom for geom in _geom_names(mj_model) if geom.startswith("tool_")]) == len(model.tool.parts)


@pytest.mark.parametrize("key", list(mjcf.KEYFRAMES))
@pytest.mark.parametrize("tool", ["none", "both"])
def test_the_arm_stays_at_its_keyframes(model: ArmModel, key: str, tool: str) -> None:
    """The keyframe's torques hold it for a second; upright, it stands on the top of the hill."""
    mj_model = mjcf.compile(model.with_tool(load_model("c", tool).tool), scene=True)
    data = mujoco.MjData(mj_model)
    mujoco.mj_resetDataKeyframe(mj_model, data, mj_model.key(key).id)
    mujoco.mj_forward(mj_model, data)
    assert data.ncon == 0
    np.testing.assert_array_equal(data.ctrl, data.actuator_force)  # no motor is at its limit
    mujoco.mj_step(mj_model, data, round(1.0 / mj_model.opt.timestep))
    np.testing.assert_allclose(data.qpos, mjcf.KEYFRAMES[key], atol=1e-3)


def test_neighbours_do_not_touch_and_distant_links_do(model: ArmModel) -> None:
    mj_model = mjcf.compile(model)
    for q in (np.zeros(6), *mjcf.KEYFRAMES.values()):
        assert _at(mj_model, np.array(q)).ncon == 0
    folded = np.array([0.0, -1.0, 3.0, 0.0, 0.0, 0.0])  # the forearm back along the upper arm
    assert _at(mj_model, folded).ncon > 0
    assert _at(mjcf.compile(model, collisions=False), folded).ncon == 0


def test_the_arm_stands_free_in_the_scene_and_can_hit_its_stand() -> None:
    mj_model = mjcf.compile(load_model("plant", "ati_gamma"), scene=True)
    assert _at(mj_model, np.zeros(6)).ncon == 0
    folded = np.array([0.0, 0.6, 2.6, 0.0, 0.0, 0.0])  # down and back, under the plate
    stand = mj_model.body("stand").id
    assert any(stand in mj_model.geom_bodyid[contact.geom] for contact in _at(mj_model, folded).contact)
    np.testing.assert_array_equal(mj_model.body("base").pos, np.zeros(3))
    assert _names(mj_model, mujoco.mjtObj.mjOBJ_CAMERA, mj_model.ncam) == ["front", "side"]


def test_upright_it_is_as_tall_as_the_thesis_says() -> None:
    """About 1.04 m in position 2 (caption of figure 4.1): the top is the housing of wrist 2, which lies level there."""
    model = load_model("c")
    data = _at(mjcf.compile(model), np.array(mjcf.KEYFRAMES["home"]))
    radius = model.links[4].cylinders[0].radius
    assert abs(data.site("dh_5").xmat[8]) < 1e-12
    assert data.site("dh_5").xpos[2] + radius == pytest.approx(1.04, abs=0.005)


def test_free_motion_keeps_its_energy() -> None:
    """No damping and no friction in the mechanics: falling from rest, potential energy becomes motion.

    With 4th order steps of 0.5 ms the balance of some 60 J closes to 1e-6 of it; an inertia or gravity in the wrong
    frame would not show here, a dissipation would.
    """
    mj_model = mjcf.compile(load_model("plant", "ati_gamma"), collisions=False)
    mj_model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    mj_model.opt.timestep = 5e-4
    mj_model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = _at(mj_model, np.array([0.3, -0.8, 0.9, -0.4, 0.7, 0.2]))
    before = data.energy.copy()
    mujoco.mj_step(mj_model, data, 800)
    mujoco.mj_forward(mj_model, data)
    assert data.energy[1] > 10.0  # it moved
    assert data.energy.sum() == pytest.approx(before.sum(), abs=1e-6 * data.energy[1])


@pytest.mark.parametrize("file", list(mjcf.SHIPPED))
def test_shipped_files_are_what_their_sources_make(file: str) -> None:
    name, scene = mjcf.SHIPPED[file]
    text = (data_dir("models") / file).read_text(encoding="utf-8")
    assert text == mjcf.xml_string(load_model(name), scene=scene), "run python -m ur5_twin.arm.mjcf"


@pytest.mark.parametrize("file", list(mjcf.SHIPPED))
def test_shipped_files_load_anywhere(file: str, tmp_path: Path) -> None:
    copy = tmp_path / file
    copy.write_bytes((data_dir("models") / file).read_bytes())
    mj_model = mujoco.MjModel.from_xml_path(str(copy))
    twin = mjcf.compile(load_model(mjcf.SHIPPED[file][0]), scene=mjcf.SHIPPED[file][1])
    for attribute in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_pos", "jnt_axis", "key_ctrl"):
        np.testing.assert_array_equal(getattr(mj_model, attribute), getattr(twin, attribute))
    assert mj_model.nmesh == 0


def test_write_models_writes_every_file(tmp_path: Path) -> None:
    paths = mjcf.write_models(tmp_path)
    assert [path.name for path in paths] == list(mjcf.SHIPPED)
    for path in paths:
        assert path.read_bytes() == (data_dir("models") / path.name).read_bytes()


def test_export(tmp_path: Path) -> None:
    model = load_model("plant", "both")
    target = tmp_path / "new" / "cell.xml"
    mjcf.export(model, target, scene=True)
    text = target.read_text(encoding="utf-8")
    assert "models/ur5_plant.toml" in text
    assert "'both'" in text
    assert mujoco.MjModel.from_xml_path(str(target)).body("tool").mass == pytest.approx(0.51)
    assert list(target.parent.iterdir()) == [target]


def test_export_wants_an_xml_file(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"cannot export to 'arm\.urdf'.*\.xml"):
        mjcf.export(load_model("c"), tmp_path / "arm.urdf")
    assert not any(tmp_path.iterdir())


@pytest.fixture
def edited(tmp_path: Path) -> Callable[[str, str], ArmModel]:
    """Model C with one passage of its file replaced."""

    def edit(old: str, new: str) -> ArmModel:
        text = model_path("ur5_model_c.toml").read_text(encoding="utf-8")
        assert old in text
        path = tmp_path / "mine.toml"
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        return load_model(path)

    return edit


def test_a_model_of_ones_own_with_an_awkward_name(edited: Callable[[str, str], ArmModel]) -> None:
    model = edited('name = "c"', 'name = "my/arm -- 2"')
    mujoco.MjModel.from_xml_string(mjcf.xml_string(model))


def test_a_model_that_mujoco_cannot_take_is_an_error_of_ours(edited: Callable[[str, str], ArmModel]) -> None:
    with pytest.raises(ModelError, match=r"'c' makes no MuJoCo model: .*upper_arm_link_cyl1_1"):
        mjcf.build(edited('name = "cyl1_2"', 'name = "cyl1_1"'))
