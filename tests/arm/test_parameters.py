"""The shipped numbers against what the thesis prints, and what a wrong file is answered with."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ur5_twin.arm import describe, inertia
from ur5_twin.arm.files import model_path
from ur5_twin.arm.parameters import ArmModel, load_model, load_tool, model_names, tool_names
from ur5_twin.errors import ModelError

# Equation 5.7: diagonals of models A and B, kg m^2; no products of inertia.
EQUATION_5_7 = [
    [0.0084, 0.0064, 0.0084],
    [0.0078, 0.2100, 0.2100],
    [0.0016, 0.0462, 0.0462],
    [0.0016, 0.0016, 0.0009],
    [0.0016, 0.0016, 0.0009],
    [0.0001, 0.0001, 0.0001],
]
# Equation 5.8: diagonals of model C; link 3 has the product I_xz = 0.0034.
EQUATION_5_8 = [
    [0.0067, 0.0064, 0.0067],
    [0.0149, 0.3564, 0.3553],
    [0.0025, 0.0551, 0.0546],
    [0.0012, 0.0012, 0.0009],
    [0.0012, 0.0012, 0.0009],
    [0.0001, 0.0001, 0.0001],
]
# The equations print four decimals.
PRINTED = 0.5e-4 + 1e-12


def _tensors(diagonals: list[list[float]]) -> np.ndarray:
    return np.array([np.diag(diagonal) for diagonal in diagonals])


@pytest.mark.parametrize("name", ["a", "b"])
def test_tensors_of_models_a_and_b_are_equation_5_7(name: str) -> None:
    _, _, tensors = load_model(name).bodies()
    np.testing.assert_allclose(tensors, _tensors(EQUATION_5_7), atol=PRINTED, rtol=0)


def test_tensors_of_model_c_are_equation_5_8() -> None:
    expected = _tensors(EQUATION_5_8)
    expected[2, 0, 2] = expected[2, 2, 0] = 0.0034
    _, _, tensors = load_model("c").bodies()
    np.testing.assert_allclose(tensors, expected, atol=PRINTED, rtol=0)


def test_plant_has_the_links_of_model_c_and_rotors() -> None:
    plant, c = load_model("plant"), load_model("c")
    for mine, theirs in zip(plant.bodies(), c.bodies(), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert (plant.rotor_inertia > 0).all()
    assert not c.rotor_inertia.any()


def test_controller_model_is_point_masses_at_the_manufacturers_centres_but_link_6() -> None:
    masses, centers, tensors = load_model("controller").bodies()
    np.testing.assert_array_equal(masses, load_model("c").bodies()[0])
    np.testing.assert_array_equal(centers[:5], load_model("c").bodies()[1][:5])
    np.testing.assert_array_equal(centers[5], np.zeros(3))
    assert not tensors.any()


@pytest.mark.parametrize("name", model_names())
def test_masses_are_table_4_2(name: str) -> None:
    masses, _, _ = load_model(name).bodies()
    np.testing.assert_array_equal(masses, [3.7, 8.393, 2.275, 1.219, 1.219, 0.1879])


def test_mass_centres_are_table_5_4() -> None:
    table = {
        "a": [[0, 0, 0], [212.5, 0, 135], [206.25, 0, 17.5], [0, 0, -2.5], [0, 0, -2.5], [0, 0, -17.5]],
        "b": [[0, -25.61, 0], [212.5, 0, 113.36], [119.93, 0, 26.5], [0, 0, 16.34], [0, 0, 16.34], [0, 0, -17.5]],
        "c": [
            [0, -25.61, 1.93],
            [212.5, 0, 113.36],
            [119.93, 0, 26.5],
            [0, -1.8, 16.34],
            [0, 1.8, 16.34],
            [0, 0, -1.159],
        ],
    }
    for name, centers_mm in table.items():
        _, centers, _ = load_model(name).bodies()
        np.testing.assert_allclose(centers * 1e3, centers_mm, atol=1e-9)  # rounding of mm to m


def test_cylinders_of_model_c_meet_the_manufacturers_centres_but_for_links_2_and_3() -> None:
    """The text calls them equal; link 2's lie 0.93 mm lower in z and link 3's 0.17 mm in x."""
    offsets = np.array([link.cylinder_center() - link.center for link in load_model("c").links]) * 1e3
    np.testing.assert_allclose(offsets[1], [0, 0, -0.93], atol=0.005)
    np.testing.assert_allclose(offsets[2], [-0.17, 0, 0], atol=0.005)
    # The others agree to the 0.01 mm that table C.4 prints.
    np.testing.assert_allclose(offsets[[0, 3, 4, 5]], 0, atol=0.01)


def test_link_6_weighs_two_numbers() -> None:
    """Table 4.2 has 0.1879 kg, tables C.1 and C.3 0.188 kg; every other link's cylinders add up to its mass."""
    for name in "abc":
        *others, last = load_model(name).links
        assert last.mass == 0.1879
        assert sum(part.mass for part in last.cylinders) == 0.188
        for link in others:
            assert sum(part.mass for part in link.cylinders) == pytest.approx(link.mass, abs=1e-12)


@pytest.mark.parametrize(("name", "count"), [("a", 6), ("b", 6), ("c", 17), ("controller", 17), ("plant", 17)])
def test_number_of_cylinders(name: str, count: int) -> None:
    assert sum(len(link.cylinders) for link in load_model(name).links) == count


@pytest.mark.parametrize(
    ("name", "mass"),
    [("ati_gamma", 0.46), ("xsens_mti", 0.05), ("both", 0.51)],  # thesis sections 4.2 and 4.3
)
def test_tool_masses(name: str, mass: float) -> None:
    tool = load_tool(name)
    assert tool is not None
    assert tool.mass == pytest.approx(mass, abs=1e-12)


def test_tool_tensor_is_its_parts_about_the_common_centre() -> None:
    tool = load_tool("both")
    assert tool is not None
    by_hand = np.zeros((3, 3))
    for part in tool.parts:
        x, y, z = part.center - tool.center
        squares = np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
        products = np.array([[0, x * y, x * z], [x * y, 0, y * z], [x * z, y * z, 0]])
        by_hand += part.inertia() + part.mass * (squares - products)
    np.testing.assert_allclose(tool.inertia, by_hand, rtol=1e-12, atol=1e-18)  # float noise
    assert set(tool.sensors) == {"ati_gamma", "xsens_mti"}


def test_with_both_the_accelerometer_stands_on_the_force_sensor() -> None:
    both, alone = load_tool("both"), load_tool("xsens_mti")
    assert both is not None
    assert alone is not None
    # Adapter 20 mm and sensor 33 mm high (section 4.2).
    np.testing.assert_allclose(both.sensors["xsens_mti"] - alone.sensors["xsens_mti"], [0, 0, 0.053], atol=1e-12)


def test_a_tool_is_part_of_the_model() -> None:
    bare, loaded = load_model("c"), load_model("c", "both")
    assert loaded.bodies()[0].sum() - bare.bodies()[0].sum() == pytest.approx(0.51, abs=1e-12)
    assert bare.with_tool(loaded.tool).tool is loaded.tool
    assert loaded.with_tool(None).tool is None
    assert load_model("c", "none").tool is None


def test_a_long_cylinder_is_a_rod_and_a_flat_one_a_disc() -> None:
    """Equation 2.48 in its two limits."""
    np.testing.assert_allclose(np.diag(inertia.cylinder(2.0, 1e-6, 3.0, "x")), [0, 1.5, 1.5], atol=1e-9)
    np.testing.assert_allclose(np.diag(inertia.cylinder(2.0, 3.0, 1e-6, "y")), [4.5, 9.0, 4.5], atol=1e-9)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_two_halves_make_a_cylinder(axis: str) -> None:
    """Equations 2.45, 2.46 and 2.56: cutting a cylinder across its axis does not change its tensor."""
    whole = inertia.cylinder(2.0, 0.05, 0.4, axis)
    half = inertia.cylinder(1.0, 0.05, 0.2, axis)
    step = 0.1 * np.eye(3)["xyz".index(axis)]
    mass, center, tensor = inertia.combine(np.ones(2), np.array([step, -step]), np.array([half, half]))
    assert mass == 2.0
    np.testing.assert_array_equal(center, np.zeros(3))
    np.testing.assert_allclose(tensor, whole, rtol=1e-13, atol=1e-18)  # float noise


def test_tensors_belong_to_real_bodies() -> None:
    """Principal moments are positive, and none exceeds the sum of the other two."""
    for name in ("a", "b", "c", "plant"):
        for tensor in load_model(name, "both").bodies()[2]:
            low, middle, high = np.linalg.eigvalsh(tensor)
            assert low > 0
            assert high <= (low + middle) * (1 + 1e-12)


@pytest.fixture
def edited(tmp_path: Path) -> Callable[[str, str], Path]:
    """Copies model C with one passage replaced."""

    def edit(old: str, new: str) -> Path:
        text = model_path("ur5_model_c.toml").read_text(encoding="utf-8")
        assert old in text
        path = tmp_path / "mine.toml"
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        return path

    return edit


def test_a_file_of_ones_own(edited: Callable[[str, str], Path]) -> None:
    model = load_model(edited("mass_kg = 8.393", "mass_kg = 8.5"))
    assert isinstance(model, ArmModel)
    assert model.links[1].mass == 8.5


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("value_m_s2", "value_ms2", "value_ms2.*known keys: .*value_m_s2"),
        ("mass_kg = 3.7", "mass_kg = -3.7", "mine.toml.*> 0.0.*mass_kg"),
        ("mass_kg = 3.7", 'mass_kg = "heavy"', "mine.toml.*float.*str.*mass_kg"),
        ("mass_kg = 3.7\n", "", "mine.toml.*mass_kg"),
        ("radius_mm = 58.9", "radius_mm = 0.0", "mine.toml.*> 0.0.*radius_mm"),
        ('axis = "y"', 'axis = "w"', "mine.toml.*'w'.*axis"),
        ("center_mm = [0.0, -25.61, 1.93]", "center_mm = [0.0, -25.61]", "mine.toml.*center_mm"),
        ("value_m_s2 = 9.81", "value_m_s2 = -9.81", "mine.toml.*>= 0.0.*value_m_s2"),
        ('name = "c"', 'name = "c', "mine.toml is not valid TOML"),
        ("[[links]]", "[[extra]]", "extra"),
    ],
)
def test_a_wrong_file_is_named_with_what_is_wrong(
    edited: Callable[[str, str], Path], old: str, new: str, message: str
) -> None:
    path = edited(old, new)
    with pytest.raises(ModelError, match=re.compile(message, re.DOTALL)):
        load_model(path)


def test_a_wrong_number_of_links(edited: Callable[[str, str], Path]) -> None:
    path = edited("[[links]]", "[[links]]")
    text = path.read_text(encoding="utf-8")
    path.write_text(text[: text.rindex("[[links]]")], encoding="utf-8")
    with pytest.raises(ModelError, match=r"mine\.toml: 5 links, a UR5 has 6"):
        load_model(path)


def test_links_and_links_from_together(tmp_path: Path) -> None:
    shutil.copy(model_path("ur5_model_c.toml"), tmp_path)
    text = model_path("ur5_model_c.toml").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    path.write_text('links_from = "ur5_model_c.toml"\n' + text, encoding="utf-8")
    with pytest.raises(ModelError, match="either 'links' or 'links_from'"):
        load_model(path)


def test_unknown_names_say_what_is_known(tmp_path: Path) -> None:
    known = "did you mean 'plant'? (known: a, b, c, controller, plant)"
    with pytest.raises(ModelError, match=f"unknown model 'plnt'; {re.escape(known)}"):
        load_model("plnt")
    with pytest.raises(ModelError, match=r"unknown tool 'ati'.*ati_gamma"):
        load_model("c", "ati")
    with pytest.raises(ModelError, match=r"cannot read .*nowhere\.toml"):
        load_model(tmp_path / "nowhere.toml")


def test_names() -> None:
    assert model_names() == ("a", "b", "c", "controller", "plant")
    assert set(tool_names()) == {"none", "ati_gamma", "xsens_mti", "ball_probe", "peg", "both"}
    assert load_model("C").name == "c"


def test_the_description_has_every_number_and_its_source() -> None:
    text = describe.render_markdown(load_model("c", "both"))
    for number in ("-392.25", "113.36", "0.356359", "0.1879", "294.7", "62.5"):
        assert number in text
    for source in ("thesis table 5.2(b)", "thesis table 4.1", "table 4.2", "tables C.3, C.4", "thesis equation 5.10"):
        assert source in text
    assert "link 2: the cylinders' common centre is 0.93 mm from the link's, by (0.00, 0.00, -0.93) mm" in text
    assert "link 3: the cylinders' common centre is 0.17 mm" in text
    assert "link 6: the cylinders weigh 0.188 kg, the link 0.1879 kg" in text


@pytest.mark.parametrize("name", model_names())
def test_the_tables_of_a_model_are_whole(name: str) -> None:
    model = load_model(name)
    tables = describe.tables(model)
    assert [table.title for table in tables] == ["Joints", "Links", "Cylinders"]
    assert [len(table.rows) for table in tables[:2]] == [6, 6]
    assert len(tables[2].rows) == sum(len(link.cylinders) for link in model.links)
    for table in tables:
        assert {len(row) for row in table.rows} == {len(table.columns)}
