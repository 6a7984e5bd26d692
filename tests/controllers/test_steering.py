from __future__ import annotations

import math

import pytest
from support.bases import ACKERMANN, BICYCLE, TRICYCLE, base
from support.control import S

STEP = S // 100


@pytest.mark.parametrize("kind", [BICYCLE, TRICYCLE, ACKERMANN])
def test_its_interfaces_are_upstreams(kind):
    _, _, created = base(kind, position_feedback=True)
    traction, steering = created.params.traction_joints_names, created.params.steering_joints_names
    assert created.command_interface_names() == [
        *(f"{item}/velocity" for item in traction),
        *(f"{item}/position" for item in steering),
    ]
    assert created.state_interface_names() == [f"{item}/position" for item in (*traction, *steering)]
    assert [interface.name for interface in created.reference_interfaces()] == [
        "base/linear/velocity",
        "base/angular/velocity",
    ]


def play(kind, seconds, twist, **params):
    """Drive wheels that follow their commands, their steering at 1 rad/s; return the hardware and the base."""
    hardware, control, created = base(kind, **params)
    control.switch(["base"], now=0)
    for step in range(round(seconds * 100)):
        control.command("base", twist, step * STEP)
        control.update(step * STEP, 0.01)
        for item in hardware.command_interfaces:
            state = next(one for one in hardware.state_interfaces if one.name == f"{item.joint}/position")
            if item.interface == "velocity":
                hardware.set(f"{item.joint}/velocity", item.value)
                state.value += item.value * 0.01
            else:
                state.value += max(min(item.value - state.value, 0.01), -0.01)
    return hardware, created


@pytest.mark.parametrize("kind", [BICYCLE, TRICYCLE, ACKERMANN])
@pytest.mark.parametrize("feedback", [False, True])
def test_a_circle_that_is_commanded_is_the_one_that_is_reported(kind, feedback):
    _, created = play(kind, 10.0, [0.5, 0.25], position_feedback=feedback)
    sample = created.sample(0)
    assert (sample.linear, sample.angular) == (pytest.approx(0.5, rel=0.01), pytest.approx(0.25, rel=0.01))
    radius = math.hypot(sample.x, sample.y) / 2.0 / math.sin(sample.heading / 2.0)
    assert radius == pytest.approx(2.0, rel=0.1)  # until the steering was there it went straight


def test_open_loop_trusts_the_twist():
    _, created = play(TRICYCLE, 2.0, [0.5, 0.0], open_loop=True)
    assert created.pose.x == pytest.approx(0.5 * 1.99)


def test_a_twist_of_zeros_that_is_commanded_steers_straight():
    hardware, _ = play(TRICYCLE, 1.0, [0.5, 0.25])
    assert hardware.values()[2] == pytest.approx(math.atan(0.25 * 1.2 / 0.5))
    hardware, _ = play(TRICYCLE, 1.0, [0.0, 0.0])
    assert hardware.values() == [0.0, 0.0, 0.0]


def test_wheels_wait_for_the_steering_where_that_is_requested():
    turn = [0.2, 1.0]
    eager, _ = play(TRICYCLE, 0.02, turn)
    careful, _ = play(TRICYCLE, 0.02, turn, reduce_wheel_speed_until_steering_reached=True)
    assert 0.0 < careful.values()[0] < 0.3 * eager.values()[0]


@pytest.mark.parametrize("across", [math.pi / 2, 1.5707, -1.5, 1.2])
@pytest.mark.parametrize("twist", [[0.5, 0.0], [0.5, 0.25], [-0.2, 0.5]])
def test_with_the_steering_across_no_wheel_turns_faster_than_the_requested_curve_needs(across, twist):
    hardware, control, _ = base(TRICYCLE)
    hardware.set("s/position", across)
    control.switch(["base"], now=0)
    for step in range(3):
        control.command("base", twist, step * STEP)
        control.update(step * STEP, 0.01)
    right, left, steering = hardware.values()
    assert 0.0 < max(abs(right), abs(left)) <= (abs(twist[0]) + 0.4 * abs(twist[1])) / 0.1 + 1e-9
    assert steering == pytest.approx(math.atan(twist[1] * 1.2 / twist[0])), "and it is steered away from there"


@pytest.mark.parametrize("feedback", [False, True])
def test_its_sample_reports_wheels_and_commands(feedback):
    hardware, created = play(TRICYCLE, 1.0, [0.5, 0.0], position_feedback=feedback)
    sample = created.sample(0)
    assert sample.steering == [0.0]
    assert sample.traction_commands == hardware.values()[:2] == [5.0, 5.0]
    assert sample.steering_commands == [0.0]
    reported, silent = sample.traction_velocities, sample.traction_positions
    if feedback:
        reported, silent = silent, reported
    assert silent == []
    assert reported == pytest.approx([4.95, 4.95] if feedback else [5.0, 5.0])


def test_what_check_is_reported_its_wheels():
    _, _, created = base(ACKERMANN)
    wheels = created.wheel_base()
    assert (wheels.left, wheels.right, wheels.separation, wheels.radius) == (("l",), ("r",), 0.8, 0.1)
    assert (wheels.radius_key, wheels.separation_key) == ("traction_wheels_radius", "traction_track_width")
