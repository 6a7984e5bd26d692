from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.bases import cases, differences

from canopen_control.controllers.mecanum import MecanumKinematics

WHEELS = ("front_left", "front_right", "rear_right", "rear_left")


def step(base: MecanumKinematics, verb: str, *values: Any) -> dict[str, Any]:
    """Do a step of a case and return what is so then."""
    if verb == "ik":
        base.command(*values)
        return dict(zip(WHEELS, base.wheels, strict=True))
    updated = base.update(*values[0], values[1])
    pose = {"x": base.x, "y": base.y, "heading": base.heading}
    return {"updated": updated, "vx": base.forward, "vy": base.left, "wz": base.angular} | pose


@pytest.mark.parametrize("case", cases("mecanum"), ids=lambda case: f"{case['index']} {case['name']}")
def test_it_drives_and_follows_as_upstream_does(case):
    given = case["in"]
    reach = given["sum_of_robot_center_projection_on_X_Y_axis"]
    base = MecanumKinematics(given["wheels_radius"], reach, tuple(given["base_frame_offset"]))
    for (verb, *values), wanted in zip(given["steps"], case["expect"]["steps"], strict=True):
        assert not differences(step(base, verb, *values), wanted, case["tolerance"]), verb


speeds = st.floats(-2.0, 2.0)


@given(forward=speeds, left=speeds, angular=speeds)
def test_wheels_that_do_what_they_are_told_drive_the_twist(forward, left, angular):
    base = MecanumKinematics(0.05, 0.4)
    base.command(forward, left, angular)
    front_left, front_right, rear_right, rear_left = base.wheels
    base.update(front_left, rear_left, rear_right, front_right, 0.02)
    assert (base.forward, base.left, base.angular) == pytest.approx((forward, left, angular), abs=1e-9)


def test_a_step_that_is_too_short_changes_nothing():
    base = MecanumKinematics(0.05, 0.4)
    assert base.update(1.0, 1.0, 1.0, 1.0, 0.99e-4) is False
    assert (base.x, base.forward) == (0.0, 0.0)
