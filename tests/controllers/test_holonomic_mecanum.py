from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.bases import MECANUM, base, cases, differences
from support.control import S

from canopen_control.controllers.holonomic import MecanumKinematics

WHEELS_OF_KINEMATICS = ("front_left", "front_right", "rear_right", "rear_left")


def step(base: MecanumKinematics, verb: str, *values: Any) -> dict[str, Any]:
    """Do a step of a case and return what is so then."""
    if verb == "ik":
        base.command(*values)
        return dict(zip(WHEELS_OF_KINEMATICS, base.wheels, strict=True))
    front_left, rear_left, rear_right, front_right = values[0]
    updated = base.update([front_left, front_right, rear_right, rear_left], values[1])
    pose = {"x": base.x, "y": base.y, "heading": base.heading}
    return {"updated": updated, "vx": base.forward, "vy": base.left, "wz": base.angular} | pose


@pytest.mark.parametrize("case", cases("mecanum"), ids=lambda case: f"{case['index']} {case['name']}")
def test_it_drives_and_follows_as_upstream_does(case):
    inputs = case["in"]
    reach = inputs["sum_of_robot_center_projection_on_X_Y_axis"]
    base = MecanumKinematics(inputs["wheels_radius"], reach, tuple(inputs["base_frame_offset"]))
    for (verb, *values), expected in zip(inputs["steps"], case["expect"]["steps"], strict=True):
        assert not differences(step(base, verb, *values), expected, case["tolerance"]), verb


speeds = st.floats(-2.0, 2.0)


@given(forward=speeds, left=speeds, angular=speeds)
def test_wheels_that_do_what_they_are_reported_drive_the_twist(forward, left, angular):
    base = MecanumKinematics(0.05, 0.4)
    base.command(forward, left, angular)
    base.update(base.wheels, 0.02)
    assert (base.forward, base.left, base.angular) == pytest.approx((forward, left, angular), abs=1e-9)


def test_a_step_that_is_too_short_changes_nothing():
    base = MecanumKinematics(0.05, 0.4)
    assert base.update([1.0] * 4, 0.99e-4) is False
    assert (base.x, base.forward) == (0.0, 0.0)


STEP = S // 100
WHEELS = ["front_left", "front_right", "rear_right", "rear_left"]


def drive(twist, steps=100, **params):
    """Command a twist for some steps to wheels that follow their commands; return hardware, manager and base."""
    hardware, control, created = base(MECANUM, **params)
    control.switch(["base"], now=0)
    for step in range(steps):
        control.command("base", twist, step * STEP)
        control.update(step * STEP, 0.01)
        for interface in hardware.command_interfaces:
            hardware.set(f"{interface.joint}/velocity", interface.value)
    return hardware, control, created


def test_its_interfaces_are_upstreams():
    _, _, created = base(MECANUM)
    assert created.command_interface_names() == [f"{wheel}/velocity" for wheel in WHEELS]
    assert created.state_interface_names() == [f"{wheel}/velocity" for wheel in WHEELS]
    assert [interface.name for interface in created.reference_interfaces()] == [
        "base/linear/x/velocity",
        "base/linear/y/velocity",
        "base/angular/z/velocity",
    ]


def test_it_drives_sideways():
    hardware, _, created = drive([0.0, 0.4, 0.0])
    assert hardware.values() == pytest.approx([-8.0, 8.0, -8.0, 8.0])
    sample = created.sample(0)
    assert (sample.x, sample.y) == (pytest.approx(0.0), pytest.approx(0.4 * 0.99, rel=0.02))
    assert (sample.linear, sample.lateral, sample.angular) == (pytest.approx(0.0), pytest.approx(0.4), 0.0)
    assert sample.reference == [0.0, 0.4, 0.0]


def test_its_sample_reports_the_wheels_against_the_clock():
    hardware, _, created = drive([0.1, 0.3, 0.2])
    front_left, front_right, rear_right, rear_left = hardware.values()
    assert len({front_left, front_right, rear_right, rear_left}) == 4
    assert created.sample(0).wheels == [front_left, rear_left, rear_right, front_right]


@pytest.mark.parametrize(("axis", "index"), [("linear__x", 0), ("linear__y", 1), ("angular__z", 2)])
def test_each_axis_has_its_limits_and_a_timeout_brakes_along_them(axis, index):
    twist = [0.0, 0.0, 0.0]
    twist[index] = 1.0
    hardware, control, created = drive(twist, 10, **{f"{axis}__max_acceleration": 1.0, f"{axis}__max_velocity": 0.5})
    assert created.limited[index] == pytest.approx(0.1)
    for step in range(10, 60):
        control.command("base", twist, step * STEP)
        control.update(step * STEP, 0.01)
    assert created.limited[index] == pytest.approx(0.5)
    control.update(200 * STEP, 0.01)
    assert created.limited[index] == pytest.approx(0.49)
    for step in range(201, 260):
        control.update(step * STEP, 0.01)
    assert set(hardware.values()) == {0.0}


def test_what_check_is_reported_its_wheels():
    _, _, created = base(MECANUM)
    wheels = created.wheel_base()
    assert (wheels.left, wheels.right) == (("front_left", "rear_left"), ("front_right", "rear_right"))
    assert (wheels.radius, wheels.separation, wheels.radius_key) == (0.05, 0.0, "kinematics.wheels_radius")
