"""The built-ins that need no robot."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from ur5_twin import spatial
from ur5_twin.errors import ScriptError
from ur5_twin.wire.urscript import Pose, library

CALL = library()
# Rotation vectors of up to 3 rad: at pi the vector may come back with the other sign.
_ROTATIONS = arrays.arrays(float, 3, elements=st.floats(-1.7, 1.7))
_POSES = st.tuples(arrays.arrays(float, 3, elements=st.floats(-2, 2)), _ROTATIONS).map(
    lambda parts: Pose(np.concatenate(parts))
)


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("acos(0.5)", math.pi / 3),
        ("asin(1)", math.pi / 2),
        ("atan(1.)", math.pi / 4),
        ("atan2(1, -1)", 3 * math.pi / 4),
        ("ceil(1.43)", 2),
        ("floor(-1.5)", -2),
        ("d2r(90)", math.pi / 2),
        ("r2d(d2r(30))", 30.0),
        ("log(10., 4.)", math.log10(4.0)),
        ("pow(5., 3)", 125.0),
        ("sqrt(9)", 3.0),
        ("norm(-5.3)", 5.3),
        ("norm(-8)", 8),
        ("norm([3, 4])", 5.0),
        ("norm(p[0, 0, 0, 3, 0, 4])", 5.0),
        ("normalize([0, 5, 0])", [0.0, 1.0, 0.0]),
        ("dot([1, 2], [3, 4])", 11.0),
        ("cross([1, 0, 0], [0, 1, 0])", [0.0, 0.0, 1.0]),
        ("length([1, 3, 3])", 3),
        ('length("here I am")', 9),
        ("get_list_length([])", 0),
        ("size([[1, 2], [3, 4], [5, 6]])", [3, 2]),
        ('size("abc")', 3),
        ("transpose([[1, 2], [3, 4], [5, 6]])", [[1, 3, 5], [2, 4, 6]]),
        ("inv([[0, 1, 0], [0, 0, 1], [1, 0, 0]])", [[0, 0, 1], [1, 0, 0], [0, 1, 0]]),
        ("binary_list_to_integer([True, False, False, True])", 9),
        ("binary_list_to_integer([])", 0),
        ("binary_list_to_integer(integer_to_binary_list(-57))", -57),
        ("make_list(3, 0)", [0, 0, 0]),
        ("point_dist(p[0, 3, 0, 1, 1, 1], p[4, 0, 0, 0, 0, 0])", 5.0),
        ("to_str([True, 1, 0.5])", "[True, 1, 0.5]"),
        ('str_cat("Integer ", 1)', "Integer 1"),
        ("str_cat([True], [1, 0])", "[True][1, 0]"),
        ('str_at("Hello", 1)', "e"),
        ('str_empty("")', True),
        ('str_find("Hello World!", "o", 5)', 7),
        ('str_find("abc", "z")', -1),
        ('str_len("Hello")', 5),
        ('str_sub("0123456789abcdefghij", 5, 3)', "567"),
        ('str_sub("0123456789", 8)', "89"),
        ('str_sub("abcde", 2, 50)', "cde"),
        ('str_sub("abc", 3)', ""),
        ('to_num("10")', 10),
        ('to_num(" +5.")', 5.0),
        ('to_num("-3.0e5")', -3e5),
        ('to_num("0X3A")', 58),
        ('to_num("10e3")', 10000.0),
        ('to_num("99999999999")', 99999999999.0),
        ("inv(p[1, 2, 3, 0, 0, 0])", [-1.0, -2.0, -3.0, 0.0, 0.0, 0.0]),
        ('to_num("-INF")', -math.inf),
    ],
)
def test_built_ins(value: Callable[[str], Any], expression: str, expected: Any) -> None:
    found = value(expression)
    assert found == pytest.approx(expected) if isinstance(expected, float) else found == expected
    if not isinstance(expected, list):
        assert type(found) is type(expected)


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        ("acos(1.1)", "acos of 1.1: not defined there"),
        ("sqrt([1])", "sqrt of [1]: not a number"),
        ("pow(-1, 0.5)", "pow of -1 and 0.5: not defined"),
        ("pow(0, -1)", "pow of 0 and -1: not defined"),
        ("pow(2147483647, 2147483647)", "not defined"),
        ("log(1, 2)", "log of 2 to the base 1: not defined"),
        ('sin(to_num("inf"))', "sin of inf: not defined"),
        ('floor(to_num("inf"))', "floor of inf: not defined"),
        ("normalize([0, 0])", "without length"),
        ("dot([1], [1, 2])", "vectors of 1 and 2"),
        ("cross([1, 2], [1, 2])", "two vectors of three"),
        ("inv([[1, 2], [2, 4]])", "no inverse"),
        ("inv([[1, 2, 3], [2, 4, 5]])", "no inverse"),
        ("inv(5)", "inv of 5: not a matrix"),
        ("binary_list_to_integer([1, 0])", "32 bools"),
        ("integer_to_binary_list(0.5)", "not an integer"),
        ("integer_to_binary_list(0xFFFFFFFF)", "not an integer"),
        ("make_list(-1, 0)", "make_list of -1 items"),
        ("make_list(100000, 0)", "make_list of 100000 items"),
        ("make_list(2000, 'a' + 'b' + make_list(9, 0))", "2000 are the most"),
        ('str_at("Hello", 10)', "place 10 of a string of 5"),
        ('str_at("Hello", -1)', "place -1 of a string of 5"),
        ('str_sub("abcde", -5, 50)', "str_sub from -5"),
        ("str_len(5)", "not a string"),
        ('to_num("123abc")', "not a number"),
        ('to_num("1_000")', "not a number"),
        ('to_num("nan")', "not a number"),
        ('to_num("")', "not a number"),
        ("wrench_trans(p[0, 0, 0, 0, 0, 0], [1, 2])", "not a wrench of six numbers"),
        ("length(5)", "neither a list nor a string"),
    ],
)
def test_what_built_ins_refuse(value: Callable[[str], Any], expression: str, message: str) -> None:
    with pytest.raises(ScriptError) as caught:
        value(expression)
    assert message in str(caught.value)
    assert str(caught.value).startswith("line 1: ")


def test_random_numbers_come_from_the_seed() -> None:
    def draw(seed: int) -> list[float]:
        random = library(seed)["random"]
        return [random() for _ in range(5)]

    assert draw(1) == draw(1) != draw(2)
    assert all(0.0 <= number < 1.0 for number in draw(1))


def test_the_manual_s_examples_of_poses() -> None:
    """What Universal Robots' manual prints beside the functions, to its digits."""
    a, b = Pose([0.2, 0.5, 0.1, 1.57, 0, 0]), Pose([0.2, 0.5, 0.6, 1.57, 0, 0])
    digits = {"abs": 2e-3}
    assert CALL["pose_add"](a, b) == pytest.approx([0.4, 1.0, 0.7, 3.14, 0, 0], **digits)
    assert CALL["pose_sub"](a, b) == pytest.approx([0, 0, -0.5, 0, 0, 0], **digits)
    assert CALL["pose_trans"](a, b) == pytest.approx([0.4, -0.0996, 0.60048, 3.14, 0, 0], abs=1e-5)
    inverse = CALL["pose_inv"](Pose([0.2, 0.5, 0.1, 1.57, 0, 3.14]))
    assert inverse == pytest.approx([0.19324, 0.41794, -0.29662, 1.23993, 0, 2.47985], abs=1e-5)
    assert CALL["rotvec2rpy"]([3.14, 1.57, 0]) == pytest.approx([-2.80856, -0.16202, 0.9], abs=1e-5)
    assert CALL["rpy2rotvec"]([3.14, 1.57, 0]) == pytest.approx([2.22153, 0.00177, -2.21976], abs=1e-5)


@given(_POSES, _POSES)
@settings(max_examples=60, deadline=None)
def test_poses_are_transformations(a: Pose, b: Pose) -> None:
    X_a, X_b = spatial.pose_from_vector(a), spatial.pose_from_vector(b)

    def matrix(pose: Pose) -> np.ndarray:
        return spatial.pose_from_vector(pose)

    # Rotation vectors near pi come back as another vector of the same rotation, so matrices are compared.
    near = {"rtol": 0.0, "atol": 1e-9}
    np.testing.assert_allclose(matrix(CALL["pose_trans"](a, b)), X_a @ X_b, **near)
    np.testing.assert_allclose(matrix(CALL["pose_inv"](a)), np.linalg.inv(X_a), **near)
    np.testing.assert_allclose(matrix(CALL["inv"](a)), np.linalg.inv(X_a), **near)
    np.testing.assert_allclose(matrix(CALL["pose_add"](CALL["pose_sub"](a, b), b)), X_a, **near)
    np.testing.assert_allclose(matrix(CALL["interpolate_pose"](a, b, 0)), X_a, **near)
    np.testing.assert_allclose(matrix(CALL["interpolate_pose"](a, b, 1)), X_b, **near)
    assert CALL["pose_dist"](a, b) == pytest.approx(CALL["pose_dist"](b, a))


@given(_POSES, _POSES, st.floats(0, 1))
@settings(max_examples=60, deadline=None)
def test_interpolation_turns_and_moves_evenly(a: Pose, b: Pose, part: float) -> None:
    between = CALL["interpolate_pose"](a, b, part)
    assert CALL["point_dist"](a, between) == pytest.approx(part * CALL["point_dist"](a, b), abs=1e-9)

    def turn(x: Pose, y: Pose) -> float:
        return float(
            spatial.rotation_angle(spatial.rotation_from_vector(x[3:]).T @ spatial.rotation_from_vector(y[3:]))
        )

    assert turn(a, between) == pytest.approx(part * turn(a, b), abs=1e-6)


@given(_POSES, arrays.arrays(float, 6, elements=st.floats(-50, 50)), arrays.arrays(float, 6, elements=st.floats(-1, 1)))
@settings(max_examples=60, deadline=None)
def test_a_wrench_does_the_same_work_in_any_frame(frame: Pose, wrench: np.ndarray, twist: np.ndarray) -> None:
    moved = CALL["wrench_trans"](frame, wrench.tolist())
    there = spatial.velocity_transform(spatial.pose_from_vector(frame)) @ twist
    assert float(np.dot(moved, there)) == pytest.approx(float(np.dot(wrench, twist)), abs=1e-9)


@given(_ROTATIONS)
@settings(max_examples=60, deadline=None)
def test_roll_pitch_and_yaw_are_the_same_rotation(vector: np.ndarray) -> None:
    back = CALL["rpy2rotvec"](CALL["rotvec2rpy"](vector.tolist()))
    np.testing.assert_allclose(
        spatial.rotation_from_vector(back), spatial.rotation_from_vector(vector), rtol=0.0, atol=1e-9
    )


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_roll_and_yaw_stay_defined_where_they_are_one(pitch: float) -> None:
    vector = CALL["rpy2rotvec"]([0.3, pitch, 0.5])
    back = CALL["rpy2rotvec"](CALL["rotvec2rpy"](vector))
    # Near the singularity the angles are known to the square root of the rounding only.
    np.testing.assert_allclose(
        spatial.rotation_from_vector(back), spatial.rotation_from_vector(vector), rtol=0.0, atol=1e-7
    )


@given(st.integers(-(2**31), 2**31 - 1))
def test_bits_of_integers(number: int) -> None:
    bits = CALL["integer_to_binary_list"](number)
    assert len(bits) == 32
    assert CALL["binary_list_to_integer"](bits) == number
