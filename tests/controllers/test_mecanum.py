from __future__ import annotations

import pytest
from support.bases import MECANUM, base
from support.control import S

STEP = S // 100
WHEELS = ["front_left", "front_right", "rear_right", "rear_left"]


def drive(twist, steps=100, **params):
    """Command a twist for some steps to wheels that do what they are told; return hardware, manager and base."""
    hardware, control, made = base(MECANUM, **params)
    control.switch(["base"], now=0)
    for step in range(steps):
        control.command("base", twist, step * STEP)
        control.update(step * STEP, 0.01)
        for each in hardware.command_interfaces:
            hardware.set(f"{each.joint}/velocity", each.value)
    return hardware, control, made


def test_its_interfaces_are_upstreams():
    _, _, made = base(MECANUM)
    assert made.command_interface_names() == [f"{each}/velocity" for each in WHEELS]
    assert made.state_interface_names() == [f"{each}/velocity" for each in WHEELS]
    assert [each.name for each in made.reference_interfaces()] == [
        "base/linear/x/velocity",
        "base/linear/y/velocity",
        "base/angular/z/velocity",
    ]


def test_it_drives_sideways():
    hardware, _, made = drive([0.0, 0.4, 0.0])
    assert hardware.values() == pytest.approx([-8.0, 8.0, -8.0, 8.0])
    sample = made.sample(0)
    assert (sample.x, sample.y) == (pytest.approx(0.0), pytest.approx(0.4 * 0.99, rel=0.02))
    assert (sample.linear, sample.lateral, sample.angular) == (pytest.approx(0.0), pytest.approx(0.4), 0.0)
    assert sample.reference == [0.0, 0.4, 0.0]


def test_its_sample_tells_the_wheels_against_the_clock():
    hardware, _, made = drive([0.1, 0.3, 0.2])
    front_left, front_right, rear_right, rear_left = hardware.values()
    assert len({front_left, front_right, rear_right, rear_left}) == 4
    assert made.sample(0).wheels == [front_left, rear_left, rear_right, front_right]


@pytest.mark.parametrize(("axis", "index"), [("linear__x", 0), ("linear__y", 1), ("angular__z", 2)])
def test_each_axis_has_its_limits_and_a_timeout_brakes_along_them(axis, index):
    twist = [0.0, 0.0, 0.0]
    twist[index] = 1.0
    hardware, control, made = drive(twist, 10, **{f"{axis}__max_acceleration": 1.0, f"{axis}__max_velocity": 0.5})
    assert made.limited[index] == pytest.approx(0.1)
    for step in range(10, 60):
        control.command("base", twist, step * STEP)
        control.update(step * STEP, 0.01)
    assert made.limited[index] == pytest.approx(0.5)
    control.update(200 * STEP, 0.01)
    assert made.limited[index] == pytest.approx(0.49)
    for step in range(201, 260):
        control.update(step * STEP, 0.01)
    assert set(hardware.values()) == {0.0}


def test_a_limit_that_freezes_an_axis_is_told():
    _, control, made = base(MECANUM, linear__y__max_jerk=0.0)
    assert made.wheel_base().frozen == ("linear.y",)
    assert any("linear.y.max_jerk: 0 keeps it" in each.text for each in control.events())


def test_what_check_is_told_of_its_wheels():
    _, _, made = base(MECANUM)
    wheels = made.wheel_base()
    assert (wheels.left, wheels.right) == (("front_left", "rear_left"), ("front_right", "rear_right"))
    assert (wheels.radius, wheels.separation, wheels.radius_key) == (0.05, 0.0, "kinematics.wheels_radius")
