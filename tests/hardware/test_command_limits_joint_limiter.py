from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.joint_limits import hard, limiter_cases, quantities, replay

from canopen_control.hardware.command_limits import EFF, JERK, NOTHING, POS, VEL, JointLimiter
from canopen_control.urdf.joint_element import HardLimits

CASES = limiter_cases("saturation")


@pytest.mark.parametrize("case", CASES, ids=[each["name"] for each in CASES])
def test_commands_are_limited_as_by_ros2_control(case):
    replay(JointLimiter(hard(case["in"]["limits"])), case)


def test_nothing_is_changed_without_time():
    limiter, desired = JointLimiter(HardLimits(max_velocity=1.0)), quantities({"velocity": 5.0})
    assert limiter.enforce(list(NOTHING), desired, 0.0) is False
    assert desired[VEL] == 5.0


def test_without_limits_everything_passes():
    limiter, desired = JointLimiter(HardLimits()), [1e9, -1e9, 1e9, -1e9, 1e9]
    assert limiter.enforce(list(NOTHING), desired, 0.01) is False
    assert desired == [1e9, -1e9, 1e9, -1e9, 1e9]


values = st.floats(-50, 50) | st.just(math.nan)


@given(st.lists(st.tuples(st.floats(-1.0, 2.0), values, st.lists(values, min_size=5, max_size=5)), max_size=12))
def test_no_limit_is_exceeded_and_what_is_not_given_stays_so(steps):
    limits = HardLimits(-1.0, 2.0, 3.0, 4.0, max_jerk=7.0)
    limiter, before = JointLimiter(limits), math.nan
    for position, velocity, wanted in steps:
        desired = list(wanted)
        limited = limiter.enforce([position, velocity, math.nan, math.nan, math.nan], desired, 0.01)
        assert [math.isnan(each) for each in desired] == [math.isnan(each) for each in wanted]
        assert limited == any(a != b for a, b in zip(desired, wanted, strict=True) if not math.isnan(b))
        for found, most in ((desired[VEL], 3.0), (desired[EFF], 4.0), (desired[JERK], 7.0)):
            assert not abs(found) > most + 1e-9
        if not math.isnan(desired[POS]):
            assert -1.0 <= desired[POS] <= 2.0
            assert not abs(desired[POS] - before) > 3.0 * 0.01 + 1e-9
            before = desired[POS]
