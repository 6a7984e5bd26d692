from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.bases import OMNI, base, cases, differences
from support.control import S

from canopen_control.controllers.holonomic import OmniKinematics

NS = 1e9


def step(base: OmniKinematics, before: int, verb: str, *values: Any) -> tuple[dict[str, Any], int]:
    """Do a step of a case; return what is so then, and the time, which the cases count from 0."""
    if verb == "ik":
        base.command(*values)
        return {"wheels": base.wheels}, before
    result: dict[str, Any] = {}
    if verb == "reset":
        base.set_pose(0.0, 0.0, 0.0)
    else:
        now, dt = values[1], (values[1] - before) / NS
        if verb == "open":
            result["updated"] = base.update_open_loop(*values[0], dt)
        else:
            follow = base.update_position if verb == "pos" else base.update_velocity
            result["updated"] = follow(values[0], dt)
        before = now if result["updated"] else before
    velocities = {"vx": base.forward, "vy": base.left, "wz": base.angular}
    return result | velocities | {"x": base.x, "y": base.y, "heading": base.heading}, before


@pytest.mark.parametrize("case", cases("omni_wheel"), ids=lambda case: f"{case['index']} {case['name']}")
def test_it_drives_and_follows_as_upstream_does(case):
    inputs = case["in"]
    base = OmniKinematics(inputs["wheels"], inputs["robot_radius"], inputs["wheel_radius"], inputs["wheel_offset"])
    now = 0
    for (verb, *values), expected in zip(inputs["steps"], case["expect"]["steps"], strict=True):
        result, now = step(base, now, verb, *values)
        assert not differences(result, expected, case["tolerance"]), verb


speeds = st.floats(-2.0, 2.0)


@given(st.integers(3, 9), st.floats(-math.pi, math.pi), speeds, speeds, speeds)
def test_wheels_that_do_what_they_are_reported_drive_the_twist(count, offset, forward, left, angular):
    base = OmniKinematics(count, 0.3, 0.05, offset)
    base.command(forward, left, angular)
    base.update_velocity(base.wheels, 0.02)
    assert (base.forward, base.left, base.angular) == pytest.approx((forward, left, angular), abs=1e-9)


def test_two_wheels_do_not_report_three_velocities():
    with pytest.raises(ValueError, match="2 wheels"):
        OmniKinematics(2, 0.3, 0.05)


def test_the_first_position_is_where_it_starts_from_once_that_is_reported():
    base = OmniKinematics(3, 0.3, 0.05)
    base.begin([5.0, 6.0, 7.0])
    base.update_position([5.0, 6.0, 7.0], 0.02)
    assert (base.x, base.y, base.heading) == (0.0, 0.0, 0.0)


STEP = S // 100


def test_its_interfaces_are_upstreams():
    _, _, created = base(OMNI)
    assert created.command_interface_names() == ["a/velocity", "b/velocity", "c/velocity"]
    assert created.state_interface_names() == ["a/position", "b/position", "c/position"]
    _, _, created = base(OMNI, position_feedback=False)
    assert created.state_interface_names() == ["a/velocity", "b/velocity", "c/velocity"]
    _, _, created = base(OMNI, open_loop=True)
    assert created.state_interface_names() == []


@pytest.mark.parametrize("how", [{}, {"position_feedback": False}, {"open_loop": True}])
def test_where_it_drives_is_where_it_trusts_to_be(how):
    hardware, control, created = base(OMNI, **how)
    for item in hardware.state_interfaces:
        item.value = 40.0 if item.interface == "position" else 0.0  # wherever the wheels stand at first
    control.switch(["base"], now=1000 * S)
    for step in range(201):
        now = 1000 * S + step * STEP
        control.command("base", [0.1, 0.2, 0.0], now)
        control.update(now, 0.01)
        for item in hardware.command_interfaces:
            position = next(one for one in hardware.state_interfaces if one.name == f"{item.joint}/position")
            position.value += item.value * 0.01
            hardware.set(f"{item.joint}/velocity", item.value)
    sample = created.sample(0)
    assert (sample.x, sample.y) == (pytest.approx(0.2, rel=0.01), pytest.approx(0.4, rel=0.01))
    assert (sample.linear, sample.lateral) == (pytest.approx(0.1), pytest.approx(0.2))


def test_its_wheels_stand_on_no_two_sides():
    _, _, created = base(OMNI)
    assert (created.wheel_base().left, created.wheel_base().separation) == ((), 0.0)
