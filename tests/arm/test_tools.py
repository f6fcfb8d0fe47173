"""Tools stand on each other, and know what hangs beyond their sensors."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
import pytest

from ur5_twin.arm import files, inertia, mjcf
from ur5_twin.arm.parameters import Sphere, Tool, load_model, load_tool, tool_names
from ur5_twin.errors import ModelError

SINGLE = [name for name in tool_names() if name not in ("none", "both")]
STACKS = [
    "ati_gamma+ball_probe",
    "ati_gamma+peg",
    "ati_gamma+xsens_mti",
    "xsens_mti+ati_gamma",
    "ati_gamma+xsens_mti+ball_probe",
]


def _load(name: str) -> Tool:
    tool = load_tool(name)
    assert tool is not None
    return tool


@pytest.mark.parametrize("name", STACKS)
def test_a_stack_weighs_its_tools_each_on_the_face_of_the_one_below(name: str) -> None:
    layers = [_load(layer) for layer in name.split("+")]
    stack = _load(name)
    heights = np.array([0.0, *itertools.accumulate(layer.height or 0.0 for layer in layers[:-1])])
    masses = np.array([layer.mass for layer in layers])
    centers = np.array([layer.center + np.array([0, 0, height]) for layer, height in zip(layers, heights, strict=True)])
    expected = inertia.combine(masses, centers, np.array([layer.inertia for layer in layers]))
    assert stack.name == name
    assert stack.mass == pytest.approx(expected[0], rel=1e-12)
    np.testing.assert_allclose(stack.center, expected[1], atol=1e-12)
    np.testing.assert_allclose(stack.inertia, expected[2], atol=1e-12)
    for layer, height in zip(layers, heights, strict=True):
        for sensor, origin in layer.sensors.items():
            np.testing.assert_allclose(stack.sensors[sensor], origin + np.array([0, 0, height]), atol=1e-12)
            assert stack.tops[sensor] == pytest.approx(layer.tops[sensor] + height, abs=1e-12)


def test_both_is_a_short_name() -> None:
    short, long = _load("both"), _load("ati_gamma+xsens_mti")
    assert short.name == "both"
    assert short.mass == long.mass
    np.testing.assert_array_equal(short.inertia, long.inertia)
    assert short.tops == long.tops


@pytest.mark.parametrize("name", SINGLE)
def test_the_mounting_face_is_the_top_of_the_parts(name: str) -> None:
    tool = _load(name)
    if tool.height is None:
        return
    spec = files.read_named("tools.toml", files.ToolSpec)[name]
    tops = [part.center_mm[2] + (part.size_mm[2] if part.size_mm else part.height_mm or 0.0) / 2 for part in spec.parts]
    assert tool.height == pytest.approx(max(tops) * 1e-3, abs=1e-12)


def test_what_hangs_beyond_the_force_sensor() -> None:
    probe = _load("ball_probe")
    mass, center, tensor = _load("ati_gamma+ball_probe").distal_to("ati_gamma")
    assert mass == pytest.approx(probe.mass, rel=1e-12)
    np.testing.assert_allclose(center, probe.center + np.array([0, 0, 0.053]), atol=1e-12)
    np.testing.assert_allclose(tensor, probe.inertia, atol=1e-15)
    # Above the accelerometer in the middle of a stack is the probe alone, above the force sensor both.
    stack = _load("ati_gamma+xsens_mti+ball_probe")
    assert stack.distal_to("xsens_mti")[0] == pytest.approx(probe.mass, rel=1e-12)
    assert stack.distal_to("ati_gamma")[0] == pytest.approx(probe.mass + 0.05, rel=1e-12)
    mass, center, tensor = _load("ati_gamma").distal_to("ati_gamma")
    assert mass == 0.0
    assert not center.any()
    assert not tensor.any()
    # The force sensor itself hangs beyond an accelerometer that is under it.
    assert _load("xsens_mti+ati_gamma").distal_to("xsens_mti")[0] == pytest.approx(0.46, rel=1e-12)


@pytest.mark.parametrize("name", [*SINGLE, *STACKS])
def test_a_stack_is_one_body_with_geoms_of_different_names(name: str) -> None:
    model = load_model("plant", name)
    assert model.tool is not None
    mj_model = mjcf.compile(model)
    assert mj_model.body("tool").mass == pytest.approx(model.tool.mass, rel=1e-12)
    for part in model.tool.parts:
        geom = mj_model.geom(f"tool_{part.name}")
        np.testing.assert_allclose(geom.pos, part.center, atol=1e-12)
        if isinstance(part, Sphere):
            assert geom.type == mujoco.mjtGeom.mjGEOM_SPHERE
            assert geom.size[0] == part.radius


def test_a_tools_tensor_counts_its_sphere() -> None:
    ball = next(part for part in _load("ball_probe").parts if isinstance(part, Sphere))
    np.testing.assert_allclose(ball.inertia(), np.eye(3) * 0.4 * 0.0327 * 0.01**2, rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("ati_gamma+bal_probe", r"unknown tool 'bal_probe'; did you mean 'ball_probe'\?.*'\+' mounts one on another"),
        ("ati_gamma+none", "unknown tool 'none'"),
        ("both+xsens_mti", "'both\\+xsens_mti' has 'xsens_mti' twice"),
        ("ball_probe+ati_gamma", "nothing can be mounted on what is below 'ati_gamma'"),
        ("", "unknown tool ''"),
    ],
)
def test_stacks_that_cannot_be(name: str, said: str) -> None:
    with pytest.raises(ModelError, match=said):
        load_tool(name)


def test_a_sensor_that_the_tool_does_not_have() -> None:
    with pytest.raises(ModelError, match=r"tool 'both': unknown sensor 'ati'.*ati_gamma"):
        _load("both").distal_to("ati")
