import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.view.pose import IDENTITY, about, from_rpy, multiply, rotate

angles = st.floats(-10.0, 10.0)


def test_a_quarter_turn_about_z_takes_x_to_y():
    assert rotate(about((0, 0, 2), math.pi / 2), (1, 0, 0)) == pytest.approx((0, 1, 0))


def test_no_axis_and_no_number_turn_nothing():
    assert about((0, 0, 0), 1.0) == about((0, 0, 1), math.nan) == IDENTITY


def test_roll_pitch_yaw_turn_about_fixed_axes_in_this_order():
    # x up by the pitch, then about z: a vector along x ends at -z whatever the yaw
    assert rotate(from_rpy((0, math.pi / 2, 1.0)), (1, 0, 0)) == pytest.approx((0, 0, -1))
    assert rotate(from_rpy((math.pi / 2, 0, math.pi / 2)), (0, 1, 0)) == pytest.approx((0, 0, 1))


@given(angles, angles, angles)
def test_a_rotation_keeps_lengths_and_its_own_length(roll, pitch, yaw):
    rotation = from_rpy((roll, pitch, yaw))
    assert math.hypot(*rotation) == pytest.approx(1.0)
    assert math.hypot(*rotate(rotation, (1, 2, 3))) == pytest.approx(math.sqrt(14))


@given(angles, angles)
def test_two_turns_about_one_axis_add_up(first, second):
    both = multiply(about((0, 1, 0), first), about((0, 1, 0), second))
    one = about((0, 1, 0), first + second)
    assert rotate(both, (1, 0, 0)) == pytest.approx(rotate(one, (1, 0, 0)), abs=1e-9)
