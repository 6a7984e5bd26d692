from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.bases import cases, differences

from canopen_control.controllers.steering_kinematics import AckermannKinematics, SteeringKinematics, TricycleKinematics

KINDS = {"bicycle": SteeringKinematics, "tricycle": TricycleKinematics, "ackermann": AckermannKinematics}


def made(given: dict[str, Any]) -> SteeringKinematics:
    track = given.get("wheel_track", 0.0)
    return KINDS[given["type"]](
        given["wheel_radius"],
        given["wheel_base"],
        given.get("wheel_track_traction", track),
        given.get("wheel_track_steering", track),
        given.get("velocity_rolling_window_size", 10),
    )


def step(base: SteeringKinematics, verb: str, *values: Any) -> dict[str, Any]:
    """Do a step of a case and return what is so then."""
    result: dict[str, Any] = {}
    if verb in ("vel", "pos"):
        feedback, dt = values
        follow = base.update_velocity if verb == "vel" else base.update_position
        traction, steering = feedback[: base.traction_count], feedback[base.traction_count :]
        result["updated"] = follow(traction, steering, dt)
    elif verb == "open":
        base.update_open_loop(*values)
    elif verb == "window":
        base.set_window(*values)
    elif verb == "reset":
        base.reset()
    else:
        base.command(*values)
    names = ("x", "y", "heading", "linear", "angular", "traction", "steering")
    return result | {name: getattr(base, name) for name in names}


@pytest.mark.parametrize("case", cases("steering_kinematics"), ids=lambda case: f"{case['index']} {case['name']}")
def test_it_steers_and_follows_as_upstream_does(case):
    base = made(case["in"])
    for (verb, *values), expected in zip(case["in"]["steps"], case["expect"]["steps"], strict=True):
        assert not differences(step(base, verb, *values), expected, case["tolerance"]), verb


@pytest.mark.parametrize("kind", list(KINDS.values()))
@given(linear=st.floats(0.05, 3.0) | st.floats(-3.0, -0.05), curvature=st.floats(-0.4, 0.4))
def test_wheels_that_do_what_they_are_reported_drive_the_twist(kind, linear, curvature):
    base = kind(0.1, 1.2, 0.8, 0.7)
    angular = linear * curvature
    base.command(linear, angular, open_loop=True)
    base.update_velocity(base.traction, base.steering, 0.01)
    assert base.linear == pytest.approx(linear, rel=1e-6)
    # the curve of a steered wheel below 1e-6 rad is none
    assert base.angular == pytest.approx(angular, rel=1e-6, abs=1e-5)


def test_the_first_position_is_where_it_starts_from_once_that_is_reported():
    base = TricycleKinematics(0.1, 1.2, 0.8)
    base.begin([40.0, -7.0])
    base.update_position([40.0, -7.0], [0.2], 0.01)
    assert (base.x, base.y, base.linear) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("kind", [TricycleKinematics, AckermannKinematics])
@given(linear=st.floats(-3.0, 3.0), curvature=st.floats(-4.0, 4.0))
def test_the_fit_agrees_where_the_wheels_agree(kind, linear, curvature):
    base = kind(0.1, 1.2, 0.8, 0.7)
    base.fits = True
    base.command(linear, linear * curvature, open_loop=True)
    base.update_velocity(base.traction, base.steering, 0.01)
    assert base.linear == pytest.approx(linear, rel=1e-6, abs=1e-9)
    assert base.angular == pytest.approx(linear * curvature, rel=1e-6, abs=1e-4)


@given(angle=st.floats(-math.pi / 2, math.pi / 2), right=st.floats(-10.0, 10.0), left=st.floats(-10.0, 10.0))
def test_the_fit_has_no_pole_wherever_the_steering_stands(angle, right, left):
    base = TricycleKinematics(0.1, 1.2, 0.8)
    base.fits = True
    base.update_velocity([right, left], [angle], 0.01)
    assert abs(base.linear) <= 0.1 * 10.0 * 1.5
    assert abs(base.angular) <= 0.1 * 20.0 / 0.8 * 1.5


def test_bounded_wheels_keep_their_ratio():
    base = TricycleKinematics(0.1, 1.2, 0.8)
    base.update_velocity([0.0, 0.0], [1.4], 0.01)
    base.command(0.5, 0.0, open_loop=False)
    before = base.traction[0] / base.traction[1]
    base.bound(0.5, 0.0)
    assert max(map(abs, base.traction)) == pytest.approx(5.0)
    assert base.traction[0] / base.traction[1] == pytest.approx(before)
    base.command(0.5, 0.1, open_loop=True)
    unbounded = list(base.traction)
    base.bound(0.5, 0.1)
    assert base.traction == pytest.approx(unbounded), "the wanted curve itself is not slowed down"


def test_two_traction_wheels_stand_where_only_a_turn_is_requested():
    base = TricycleKinematics(0.1, 1.2, 0.8)
    base.command(0.0, 1.0, open_loop=True)
    assert base.traction == [0.0, 0.0]
    assert base.steering == [math.pi / 2]
