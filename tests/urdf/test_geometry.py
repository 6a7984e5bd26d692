import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.urdf.geometry import IDENTITY, Pose, about, along, from_rpy, from_yaw, multiply, rotate

angles = st.floats(-10.0, 10.0)
vectors = st.tuples(*[st.floats(-10, 10)] * 3)


def test_no_axis_and_no_number_turn_nothing():
    assert about((0, 0, 0), 1.0) == about((0, 0, 1), math.nan) == IDENTITY


@given(angles, angles)
def test_two_turns_about_one_axis_add_up(first, second):
    both = multiply(about((0, 1, 0), first), about((0, 1, 0), second))
    one = about((0, 1, 0), first + second)
    assert rotate(both, (1, 0, 0)) == pytest.approx(rotate(one, (1, 0, 0)), abs=1e-9)


@given(angles, angles, angles, vectors)
def test_roll_pitch_yaw_equal_the_matrix_of_the_urdf_specification(roll, pitch, yaw, vector):
    x, y, z = vector
    y, z = y * math.cos(roll) - z * math.sin(roll), y * math.sin(roll) + z * math.cos(roll)
    x, z = x * math.cos(pitch) + z * math.sin(pitch), -x * math.sin(pitch) + z * math.cos(pitch)
    x, y = x * math.cos(yaw) - y * math.sin(yaw), x * math.sin(yaw) + y * math.cos(yaw)
    assert rotate(from_rpy((roll, pitch, yaw)), vector) == pytest.approx((x, y, z), abs=1e-6)


def test_along_an_axis_of_any_length():
    assert along((0, 0, 2), 0.4) == pytest.approx((0, 0, 0.4))
    assert along((0, 0, 0), 0.4) == (0, 0, 0)


@given(angles, vectors, vectors, vectors)
def test_a_pose_of_a_pose_places_points_as_one_after_the_other(angle, first, second, point):
    outer, inner = Pose(first, from_yaw(angle)), Pose(second, about((1, 0, 0), angle))
    assert outer.then(inner).of(point) == pytest.approx(outer.of(inner.of(point)), abs=1e-9)
