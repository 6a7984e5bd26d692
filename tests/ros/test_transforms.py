from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canopen_control.ros.transforms import about, multiply, of_rpy, read_joints, rotate

URDF = """<robot name="r">
  <link name="a"/>
  <joint name="plain" type="fixed"><parent link="a"/><child link="b"/></joint>
  <joint name="wheel" type="continuous"><parent link="b"/><child link="c"/>
    <origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/><axis xyz="0 2 0"/></joint>
  <joint name="lift" type="prismatic"><parent link="b"/><child link="d"/>
    <origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/></joint>
  <joint name="follower" type="revolute"><parent link="c"/><child link="e"/><axis xyz="0 0 1"/>
    <mimic joint="wheel" multiplier="-2" offset="0.5"/></joint>
  <joint name="free" type="floating"><parent link="a"/><child link="f"/></joint>
</robot>"""
angles = st.floats(-math.pi, math.pi)
vectors = st.tuples(*[st.floats(-10, 10)] * 3)


def joints():
    return {each.name: each for each in read_joints(URDF)}


def transform(name, **positions):
    return joints()[name].transform(positions)


def test_a_fixed_joint_is_its_origin_whatever_moves():
    made = transform("plain", wheel=1.0)
    assert (made.parent, made.child, made.translation, made.rotation) == ("a", "b", (0, 0, 0), (0, 0, 0, 1))


def test_a_wheel_turns_about_its_axis_after_its_origin():
    made = transform("wheel", wheel=math.pi / 2)
    assert made.translation == (1.0, 2.0, 3.0)
    # the axis y of the joint is -x of the parent: what pointed along the joint's x points down
    assert rotate(made.rotation, (1.0, 0.0, 0.0)) == pytest.approx((0, 0, -1), abs=1e-9)
    assert rotate(made.rotation, (0.0, 1.0, 0.0)) == pytest.approx((-1, 0, 0), abs=1e-9)


def test_a_lift_shifts_along_its_axis_in_its_own_frame():
    made = transform("lift", lift=0.5)
    assert made.translation == pytest.approx((0.0, 0.5, 1.0))
    assert made.rotation == pytest.approx(of_rpy(0, 0, math.pi / 2))


def test_a_mimic_joint_follows():
    assert transform("follower", wheel=0.25).rotation == pytest.approx((0, 0, 0, 1))
    assert transform("follower", wheel=-0.25).rotation == pytest.approx((0, 0, math.sin(0.5), math.cos(0.5)))


@pytest.mark.parametrize("name", ["wheel", "lift", "follower", "free"])
def test_a_joint_whose_position_is_not_known_has_no_transform(name):
    assert transform(name) is None


def test_roll_pitch_yaw_are_about_fixed_axes_in_that_order():
    turned = rotate(of_rpy(math.pi / 2, 0.0, math.pi / 2), (0.0, 1.0, 0.0))
    assert turned == pytest.approx((0, 0, 1), abs=1e-9), "roll first: y becomes z, which yaw leaves alone"


@settings(deadline=None)
@given(angles, angles, angles, vectors)
def test_a_rotation_keeps_lengths_and_its_quaternion_has_length_one(roll, pitch, yaw, vector):
    rotation = of_rpy(roll, pitch, yaw)
    assert math.hypot(*rotation) == pytest.approx(1.0)
    assert math.hypot(*rotate(rotation, vector)) == pytest.approx(math.hypot(*vector), abs=1e-9)


@settings(deadline=None)
@given(angles, angles, angles, vectors)
def test_roll_pitch_yaw_equal_the_matrix_of_the_urdf_specification(roll, pitch, yaw, vector):
    x, y, z = vector
    y, z = y * math.cos(roll) - z * math.sin(roll), y * math.sin(roll) + z * math.cos(roll)
    x, z = x * math.cos(pitch) + z * math.sin(pitch), -x * math.sin(pitch) + z * math.cos(pitch)
    x, y = x * math.cos(yaw) - y * math.sin(yaw), x * math.sin(yaw) + y * math.cos(yaw)
    assert rotate(of_rpy(roll, pitch, yaw), vector) == pytest.approx((x, y, z), abs=1e-6)


@settings(deadline=None)
@given(angles, angles)
def test_two_turns_about_one_axis_are_their_sum(one, other):
    axis = (0.6, 0.0, 0.8)
    both, sum_ = multiply(about(axis, one), about(axis, other)), about(axis, one + other)
    assert abs(sum(a * b for a, b in zip(both, sum_, strict=True))) == pytest.approx(1.0)


def test_what_is_no_urdf_is_told():
    with pytest.raises(ValueError, match="no XML"):
        read_joints("<robot>")
