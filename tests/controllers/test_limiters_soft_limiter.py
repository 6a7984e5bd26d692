from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.joint_limits import expect_as_recorded, hard, limiter_cases, quantities

from canopen_control.controllers.limiters import POS, VEL, SoftLimiter
from canopen_control.urdf.joint_element import HardLimits, SoftLimits

CASES = limiter_cases("soft")
KEYS = {"min_position": "lower", "max_position": "upper"}


def soft(values: dict[str, float]) -> SoftLimits:
    """Return the soft limits of a case; a gain that it does not give is none."""
    inputs = {"k_position": math.nan, "k_velocity": math.nan} | {
        KEYS.get(key, key): each for key, each in values.items()
    }
    return SoftLimits(**inputs)


@pytest.mark.parametrize("case", CASES, ids=[item["name"] for item in CASES])
def test_commands_are_limited_as_by_ros2_control(case):
    expect_as_recorded(SoftLimiter(hard(case["in"]["limits"]), soft(case["in"]["soft"])), case)


def test_a_joint_slows_down_before_its_soft_limit_and_never_passes_it():
    limiter = SoftLimiter(HardLimits(-1.0, 1.0, 2.0), SoftLimits(-0.8, 0.8, 10.0, 5.0))
    here, steps = 0.0, []
    for _ in range(300):
        desired = quantities({"position": 1.0})
        limiter.enforce(quantities({"position": here}), desired, 0.01)
        steps.append(desired[POS] - here)
        here = desired[POS]
    assert max(steps) == pytest.approx(0.02)
    assert 0.799 < here <= 0.8
    assert max(after - before for before, after in itertools.pairwise(steps)) < 1e-9


def test_a_safety_controller_without_ends_limits_no_position():
    limiter, desired = SoftLimiter(HardLimits(-1.0, 1.0, 2.0), SoftLimits()), quantities({"position": 0.95})
    assert limiter.enforce(quantities({"position": 0.94}), desired, 0.1) is False


@given(st.floats(-0.9, 0.9), st.floats(-9, 9))
def test_a_velocity_towards_a_soft_limit_shrinks_with_the_distance(position, wanted):
    limiter, desired = SoftLimiter(HardLimits(-1.0, 1.0, 2.0), SoftLimits(-0.8, 0.8, 4.0, 0.0)), quantities({})
    desired[VEL] = wanted
    limiter.enforce(quantities({"position": position}), desired, 0.01)
    assert desired[VEL] <= max(4.0 * (0.8 - position), 0.0) + 1e-9
    assert desired[VEL] >= min(4.0 * (-0.8 - position), 0.0) - 1e-9
