from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.controllers.planar_pose import HolonomicKinematics, PlanarPose, RollingMean, quotient


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_a_shift_straight_on_is_a_drive(way, turn):
    one, other = PlanarPose(), PlanarPose()
    one.drive(way, turn)
    other.shift(way, 0.0, turn)
    assert (one.x, one.y, one.heading) == pytest.approx((other.x, other.y, other.heading), abs=1e-6)


def test_a_shift_to_the_left_goes_by_the_heading():
    pose = PlanarPose()
    pose.set_pose(0.0, 0.0, math.pi / 2)
    pose.shift(0.0, 1.0, 0.0)
    assert (pose.x, pose.y) == pytest.approx((-1.0, 0.0), abs=1e-12)


def test_a_mean_is_of_the_last_values():
    mean = RollingMean(2)
    assert mean.mean == 0.0
    for value in (1.0, 2.0, 4.0):
        mean.add(value)
    assert mean.mean == 3.0
    mean.clear()
    assert mean.mean == 0.0


@pytest.mark.parametrize(
    ("dividend", "divisor", "expected"),
    [(6.0, 2.0, 3.0), (1.0, 0.0, math.inf), (1.0, -0.0, -math.inf), (-1.0, 0.0, -math.inf)],
)
def test_a_quotient_is_that_of_the_standard(dividend, divisor, expected):
    assert quotient(dividend, divisor) == expected


@pytest.mark.parametrize("dividend", [0.0, -0.0, math.nan])
def test_nothing_by_nothing_is_not_a_number(dividend):
    assert math.isnan(quotient(dividend, 0.0))


ROWS = [(1.0, -1.0, -0.5), (1.0, 1.0, 0.5), (1.0, -1.0, 0.5), (1.0, 1.0, -0.5), (0.3, 0.9, -0.2)]


def test_the_odometry_of_wheels_that_do_what_is_commanded_is_the_twist():
    base = HolonomicKinematics(ROWS, 0.05)
    base.command(0.4, -0.2, 1.5)
    assert base.wheels[0] == pytest.approx((0.4 + 0.2 - 0.75) / 0.05)
    base.fit(base.wheels)
    assert (base.forward, base.left, base.angular) == pytest.approx((0.4, -0.2, 1.5))


def test_wheels_that_contradict_each_other_are_fitted_by_least_squares():
    base = HolonomicKinematics(ROWS[:4], 0.1)
    base.fit([1.0, 0.0, 0.0, 0.0])
    assert (base.forward, base.left, base.angular) == pytest.approx((0.025, -0.025, -0.05))
