from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control import vectors
from support.joint_limits import hard
from support.trajectories import QUANTITIES, close, point

from canopen_control.controllers.limiters import PointLimiter
from canopen_control.controllers.trajectory.point import Point
from canopen_control.urdf.joint_element import HardLimits

CASES = vectors("joint_trajectory_point_limiter", "joint_limits.json")


@pytest.mark.parametrize("case", CASES, ids=[item["name"] for item in CASES])
def test_points_are_limited_as_by_ros2_control(case):
    limiter = PointLimiter([hard(item) for item in case["in"]["limits"]])
    for step, expected in zip(case["in"]["steps"], case["expect"]["steps"], strict=True):
        desired = point(step[1])
        assert limiter.enforce(point(step[0]), desired, step[2]) is expected["limited"]
        for key in QUANTITIES:
            assert close(getattr(desired, key), expected["command"].get(key, []), case["tolerance"]), (key, step)


def test_a_joint_that_rests_where_it_is_needs_no_brake():
    limiter, desired = PointLimiter([HardLimits(-1.0, 1.0)]), Point([0.5], [0.0])
    assert limiter.enforce(Point([0.5], [0.0]), desired, 0.01) is False
    assert (desired.positions, desired.velocities) == ([0.5], [0.0])


numbers = st.floats(-5, 5)


@given(st.lists(st.tuples(numbers, numbers, numbers, numbers), min_size=1, max_size=4), st.floats(0.001, 0.1))
def test_no_point_is_beyond_what_the_limits_allow_in_a_period(joints, period):
    limits = [HardLimits(max_velocity=2.0, max_acceleration=4.0)] * len(joints)
    speeds = [max(-2.0, min(2.0, joint[1])) for joint in joints]
    actual = Point([joint[0] for joint in joints], speeds)
    desired = Point([joint[2] for joint in joints], [joint[3] for joint in joints])
    PointLimiter(limits).enforce(actual, desired, period)
    for index, velocity in enumerate(desired.velocities):
        assert abs(velocity) <= 2.0 + 1e-9
        assert abs(velocity - speeds[index]) <= 4.0 * period + 1e-9
        assert math.isfinite(desired.positions[index])


@pytest.mark.parametrize("slope", [math.inf, 5.0])
def test_a_joint_outside_its_range_is_held_until_a_point_leads_into_the_range(slope):
    limiter = PointLimiter([HardLimits(-1.0, 2.0, 3.0, max_acceleration=slope, max_deceleration=slope)])
    actual = Point([2.5], [0.0])
    for value in (2.5, 9.0, 2.5):
        desired = Point([value], [0.0])
        limiter.enforce(actual, desired, 0.01)
        assert desired.positions == [2.5]
    desired = Point([1.0], [0.0])
    limiter.enforce(actual, desired, 0.01)
    assert 2.4 < desired.positions[0] < 2.5
