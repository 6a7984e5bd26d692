"""Common behaviour of all bases with parameters in `PARAMS`; the diff drive has its own tests."""

from __future__ import annotations

import math
import sys
from types import SimpleNamespace

import pytest
from support.bases import MECANUM, OMNI, PARAMS, TRICYCLE, base
from support.control import FORWARD, S, add

from canopen_control.controllers.base import ControllerState
from canopen_control.controllers.base_params import BaseParams, TwistAxisLimits
from canopen_control.controllers.mobile_base import LimitedTwist, MobileBase, OdometryPublication, fill
from canopen_control.controllers.planar_pose import PlanarPose
from canopen_control.controllers.types import TYPES, make_controller
from canopen_control.errors import ControlError, RobotConfigError
from canopen_control.hardware.interfaces import ReturnType
from canopen_control.rpc.messages.parameters import ParameterValue

MS = 1_000_000


def test_after_a_pause_there_is_not_a_burst():
    odometry_publication = OdometryPublication(2)
    odometry_publication.set_rate(100.0)
    assert [odometry_publication.is_due(at * MS) for at in (0, 1000, 1001, 1002, 1011)] == [
        True,
        True,
        True,
        False,
        True,
    ]


def test_it_stays_what_it_was_until_the_next_one():
    reported, pose = OdometryPublication(2), PlanarPose()
    assert reported.sample(1.0, BaseParams(), limited=False) is None
    reported.is_due(1)
    pose.set_pose(1.0, 2.0, 3.0)
    reported.store(pose, (0.1, 0.2, 0.3), [0.4, 0.5])
    pose.set_pose(9.0, 9.0, 9.0)
    sample = reported.sample(1.0, BaseParams(odom_frame_id="map"), limited=True)
    assert (sample.x, sample.y, sample.heading, sample.frame_id) == (1.0, 2.0, 3.0, "map")
    assert (sample.linear, sample.lateral, sample.angular, sample.limited) == (0.1, 0.2, 0.3, (0.4, 0.5))


AXES = ("linear.x", "angular.z")


def test_each_axis_goes_from_where_it_was_and_from_standstill_after_it_was_forgotten():
    twist = LimitedTwist(AXES)
    twist.set_limits("base", [TwistAxisLimits(max_acceleration=1.0), TwistAxisLimits()])
    fill(twist.desired, 1.0)
    for value in (0.1, 0.2):
        twist.limit(0.1)
        twist.step()
        assert twist.limited == [pytest.approx(value), 1.0]
    twist.forget()
    assert all(map(math.isnan, twist.desired))
    fill(twist.desired, 1.0)
    twist.limit(0.1)
    assert twist.limited[0] == pytest.approx(0.1)


def test_standstill_rests_after_three_steps_until_something_is_requested_or_the_limits_change():
    twist = LimitedTwist(AXES)
    limits = [TwistAxisLimits(max_acceleration=1.0), TwistAxisLimits()]
    twist.set_limits("base", limits)
    fill(twist.desired, 1.0)
    twist.limit(0.1)
    twist.step()
    fill(twist.desired, 0.0)
    rests = []
    for _ in range(5):
        rests.append(twist.is_standstill)
        twist.limit(0.1)
        twist.step()
    assert rests == [False, False, False, True, True]
    twist.desired[0] = 1.0
    assert not twist.is_standstill
    fill(twist.desired, 0.0)
    assert twist.is_standstill
    twist.set_limits("base", limits)
    assert not twist.is_standstill


def test_limits_that_exclude_each_other_are_reported_with_controller_and_axis_and_change_nothing():
    twist = LimitedTwist(AXES)
    wrong = [TwistAxisLimits(max_velocity=0.5), TwistAxisLimits(max_velocity=1.0, min_velocity=2.0)]
    with pytest.raises(RobotConfigError, match=r"base: angular\.z: .*a minimum is above its maximum"):
        twist.set_limits("base", wrong)
    fill(twist.desired, 3.0)
    twist.limit(0.1)
    assert twist.limited == [3.0, 3.0]


class Rudder(MobileBase):
    def compute_commands(self, twist):
        self.targets[:] = twist

    def velocities(self):
        return 0.0, 0.0, 0.0


class Boat(Rudder):
    def advance(self, dt):
        pass


@pytest.mark.parametrize("kind", [MobileBase, Rudder])
def test_a_base_without_a_method_that_moves_it_is_refused_when_it_is_loaded(kind, monkeypatch):
    monkeypatch.setitem(TYPES, "me/Boat", f"boats:{kind.__name__}")
    simple_namespace = SimpleNamespace(
        MobileBase=lambda *names: MobileBase(*names, PlanarPose()), Rudder=lambda *names: Rudder(*names, PlanarPose())
    )
    monkeypatch.setitem(sys.modules, "boats", simple_namespace)
    missing = "compute_commands" if kind is MobileBase else "advance or follow"
    with pytest.raises(
        ControlError, match=f"type 'me/Boat' cannot be loaded: {kind.__name__} does not define {missing}"
    ):
        make_controller("boat", "me/Boat")


def test_in_open_loop_a_base_follows_its_twist():
    boat = Boat("boat", "me/Boat", PlanarPose())
    boat.set_up(BaseParams(), 0.5, 2, open_loop=True)
    boat.limited[:] = [2.0, 0.0]
    assert boat.follow(S)
    assert boat.follow(2 * S)
    assert (boat.pose.x, boat.pose.y, boat.pose.heading) == (2.0, 0.0, 0.0)


STEP = S // 100
each_base = pytest.mark.parametrize("kind", list(PARAMS))
SOME = {True: [0.3, 0.2, 0.1], False: [0.3, 0.1]}


def active(kind, **params):
    hardware, control, created = base(kind, **params)
    control.switch(["base"], now=0)
    control.events()
    return hardware, control, created


def twist(made):
    return SOME["linear.y" in made.twist_axes]


def velocities(hardware):
    return [item.value for item in hardware.command_interfaces if item.interface == "velocity"]


def angles(hardware):
    return [item.value for item in hardware.command_interfaces if item.interface == "position"]


@each_base
def test_before_the_first_twist_wheels_stand_and_odometry_is_reported(kind):
    hardware, control, created = active(kind)
    control.update(STEP, 0.01)
    assert set(velocities(hardware)) == {0.0}
    assert all(map(math.isnan, angles(hardware)))
    sample = created.sample(0)
    assert (sample.x, sample.linear, sample.lateral, sample.time) == (0.0, 0.0, 0.0, 0.01)
    assert type(sample) is created.sample_type


@each_base
def test_a_twist_that_is_not_renewed_ends_and_positions_stay(kind):
    hardware, control, created = active(kind)
    control.command("base", twist(created), 0)
    control.update(STEP, 0.01)
    assert any(velocities(hardware))
    steered = angles(hardware)
    assert all(steered)
    control.update(51 * STEP, 0.01)
    assert set(velocities(hardware)) == {0.0}
    assert angles(hardware) == steered
    assert [event.text for event in control.events() if event.kind == "command_timeout"] == [
        "base: no twist for 0.51 s, it brakes until the next one"
    ]


@pytest.mark.parametrize("kind", [TRICYCLE, MECANUM, OMNI])
def test_a_timeout_of_0_limits_a_twist_to_one_update(kind):
    key = "cmd_vel_timeout" if kind == OMNI else "reference_timeout"
    hardware, control, created = base(kind, **{key: 0.0})
    texts = [event.text for event in control.events()]
    assert f"base: {key} is 0, so a twist is used for one update only; give a time in s" in texts
    control.switch(["base"], now=0)
    control.command("base", twist(created), 3600 * S, 1)  # however old
    control.update(3600 * S, 0.01)
    assert any(velocities(hardware))
    control.update(3600 * S + STEP, 0.01)
    assert set(velocities(hardware)) == {0.0}
    control.command("base", twist(created), 3600 * S + STEP)
    control.update(3600 * S + 2 * STEP, 0.01)
    assert any(velocities(hardware))


@each_base
def test_what_is_not_a_twist_is_refused_with_the_axis(kind):
    hardware, control, created = active(kind)
    good = twist(created)
    control.command("base", good, 0)
    for index, axis in enumerate(created.twist_axes):
        for bad in (math.nan, math.inf):
            with pytest.raises(ControlError, match=f"finite numbers, got {bad} for {axis}"):
                control.command("base", [*good[:index], bad, *good[index + 1 :]], 40 * STEP)
    with pytest.raises(ControlError, match=f"expects {len(good)} values"):
        control.command("base", [*good, 0.0], 40 * STEP)
    control.update(51 * STEP, 0.01)  # none of them has put the timeout off
    assert set(velocities(hardware)) == {0.0}
    assert created.rejected == 2 * len(good) + 1


@each_base
def test_a_twist_as_old_as_the_timeout_is_refused(kind):
    _, control, created = active(kind)
    with pytest.raises(ControlError, match=r"0\.500 s old"):
        control.command("base", twist(created), 10 * S, 10 * S - S // 2)


@each_base
def test_it_stops_where_it_is_deactivated_and_its_twist_does_not_return(kind):
    hardware, control, created = active(kind)
    control.command("base", twist(created), 0)
    control.update(STEP, 0.01)
    steered = angles(hardware)
    control.switch(deactivate=["base"], now=2 * STEP)
    assert set(velocities(hardware)) == {0.0}
    assert angles(hardware) == steered
    control.switch(["base"], now=3 * STEP)
    control.update(4 * STEP, 0.01)
    assert set(velocities(hardware)) == {0.0}
    assert created.state is ControllerState.ACTIVE


@each_base
def test_a_drive_that_is_lost_ends_the_twist_and_is_waited_for(kind):
    hardware, control, created = active(kind)
    control.command("base", twist(created), 0)
    control.update(STEP, 0.01)
    for interface in hardware.command_interfaces:
        interface.enabled = False
    for interface in hardware.state_interfaces:
        interface.value = math.nan
    for step in range(2, 6):
        control.update(step * STEP, 0.01)
    assert created.state is ControllerState.ACTIVE
    assert set(velocities(hardware)) == {0.0}
    assert all(map(math.isnan, angles(hardware))), "the hardware holds where the joint is"
    with pytest.raises(ControlError, match="not enabled"):
        control.command("base", twist(created), 6 * STEP)
    for interface in hardware.command_interfaces:
        interface.enabled = True
    for interface in hardware.state_interfaces:
        interface.value = 7.0  # wherever the wheels have got to: no way
    before = (created.pose.x, created.pose.y, created.pose.heading)
    control.update(7 * STEP, 0.01)
    assert (created.pose.x, created.pose.y, created.pose.heading) == before
    assert set(velocities(hardware)) == {0.0}, "nothing moves without a newer command"
    for interface in hardware.state_interfaces:
        interface.value = 0.0
    control.command("base", twist(created), 7 * STEP)
    control.update(8 * STEP, 0.01)
    assert any(velocities(hardware))


@each_base
def test_drives_that_run_without_feedback_are_an_error(kind):
    hardware, control, created = active(kind)
    control.command("base", twist(created), 0)
    hardware.state_interfaces[0].value = hardware.state_interfaces[1].value = math.nan
    assert created.update(STEP, 0.01) is ReturnType.ERROR
    assert "has no finite value" in control.events()[-1].text


@each_base
def test_another_controller_drives_it_by_its_references(kind):
    hardware, control, created = base(kind)
    names = [interface.name.removesuffix("/velocity") for interface in created.reference_interfaces()]
    for index, joint in enumerate(names):
        add(control, f"axis{index}", FORWARD, joints=[joint], interface_name="velocity")
    others = [f"axis{index}" for index in range(len(names))]
    control.switch([*others, "base"], now=0)
    control.update(STEP, 0.01)
    assert set(velocities(hardware)) == {0.0}
    with pytest.raises(ControlError, match="is commanded by axis0"):
        control.command("base", twist(created), 0)
    for other, value in zip(others, twist(created), strict=True):
        control.command(other, [value], STEP)
    control.update(2 * STEP, 0.01)
    assert any(velocities(hardware))
    control.switch(deactivate=others, now=2 * STEP)
    control.update(3 * STEP, 0.01)
    assert set(velocities(hardware)) == {0.0}


@each_base
def test_a_wheel_that_cannot_turn_so_fast_refuses_the_twist(kind):
    hardware, control, created = active(kind)
    control.command("base", twist(created), 0)
    control.update(STEP, 0.01)
    hardware.command_interfaces[0].highest = 1.0
    hardware.command_interfaces[0].lowest = -1.0
    with pytest.raises(ControlError, match="cannot send"):
        control.command("base", [5.0 * item for item in twist(created)], STEP)
    assert set(velocities(hardware)) == {0.0}


@each_base
def test_the_pose_can_be_set(kind):
    _, control, created = active(kind)
    created.set_odometry(1.0, 2.0, 0.5)
    control.update(STEP, 0.01)
    sample = created.sample(0)
    assert (sample.x, sample.y, sample.heading) == (1.0, 2.0, 0.5)


@each_base
def test_it_reports_that_it_is_a_base(kind):
    _, control, created = base(kind)
    reading = control.list()[0]
    assert reading.is_base
    assert reading.twist_axes == created.twist_axes
    assert reading.drives_sideways is ("linear.y" in created.twist_axes)
    assert created.wheel_base().base_frame == "base_link"


@each_base
def test_a_timeout_that_is_set_acts_in_the_next_update_and_one_that_is_wrong_never(kind):
    hardware, control, created = active(kind)
    key = created.timeout_key
    control.set_parameters("base", [ParameterValue(name=key, kind="double", value=2.0)])
    control.command("base", twist(created), 0)
    control.update(STEP, 0.01)
    control.update(101 * STEP, 1.0)
    assert any(velocities(hardware)), "1 s is not too old"
    with pytest.raises(RobotConfigError, match=rf"{key}: -1\.0 is out of range"):
        control.set_parameters("base", [ParameterValue(name=key, kind="double", value=-1.0)])
    assert created.command_timeout.limit_ns == 2 * S
    assert {parameter.name: parameter for parameter in control.parameters("base")}[key].value == 2.0


def test_a_jerk_limit_of_zero_that_is_set_is_refused_since_a_moving_base_would_never_brake():
    hardware, control, created = active(MECANUM)
    jerk = ParameterValue(name="linear.x.max_jerk", kind="double", value=0.0)
    with pytest.raises(RobotConfigError, match="base: with a max_jerk of 0 a base that moves would never brake"):
        control.set_parameters("base", [jerk])
    control.command("base", twist(created), 0)
    control.update(STEP, 0.01)
    assert any(velocities(hardware))
