from __future__ import annotations

import math

import pytest

from canopen_control.controllers.base_params import AxisLimits
from canopen_control.controllers.mobile_base import LimitedTwist, fill
from canopen_control.errors import RobotConfigError

AXES = ("linear.x", "angular.z")


def test_without_limits_it_is_what_is_wanted():
    twist = LimitedTwist(AXES)
    assert not twist.known
    twist.wanted[:] = [3.0, -2.0]
    twist.limit(0.01)
    assert twist.known
    assert (twist.limited, twist.stands) == ([3.0, -2.0], False)


def test_each_axis_goes_from_where_it_was_and_from_standstill_after_it_was_forgotten():
    twist = LimitedTwist(AXES)
    twist.set_limits("base", [AxisLimits(max_acceleration=1.0), AxisLimits()])
    fill(twist.wanted, 1.0)
    for wanted in (0.1, 0.2):
        twist.limit(0.1)
        twist.step()
        assert twist.limited == [pytest.approx(wanted), 1.0]
    twist.forget()
    assert all(map(math.isnan, twist.wanted))
    fill(twist.wanted, 1.0)
    twist.limit(0.1)
    assert twist.limited[0] == pytest.approx(0.1)


def test_limits_that_exclude_each_other_are_told_with_controller_and_axis_and_change_nothing():
    twist = LimitedTwist(AXES)
    wrong = [AxisLimits(max_velocity=0.5), AxisLimits(max_velocity=1.0, min_velocity=2.0)]
    with pytest.raises(RobotConfigError, match=r"base: angular\.z: .*a minimum is above its maximum"):
        twist.set_limits("base", wrong)
    fill(twist.wanted, 3.0)
    twist.limit(0.1)
    assert twist.limited == [3.0, 3.0]
