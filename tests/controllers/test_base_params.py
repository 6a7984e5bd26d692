from __future__ import annotations

import math

from canopen_control.controllers.base_params import TwistAxisLimits


def test_limits_are_those_of_the_limiter():
    limits = TwistAxisLimits(max_velocity=1.0, max_deceleration=-2.0).limits()
    assert (limits.max_velocity, limits.max_deceleration) == (1.0, -2.0)
    assert math.isnan(limits.max_jerk)
    assert TwistAxisLimits(max_jerk=0.0).freezes
    assert not TwistAxisLimits().freezes
