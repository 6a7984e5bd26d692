from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control import Hardware, S, add, manager

from canopen_control.controllers.tricycle import DrivenWheelPose
from canopen_control.errors import ConfigError

STEP = S // 100
GIVEN = {"traction_joint_name": "t", "steering_joint_name": "s", "wheelbase": 1.2, "wheel_radius": 0.1}
NO_LIMIT = {"steering.max_position": 1.6}


class Robot:
    """A tricycle whose drives follow their commands at once."""

    def __init__(self, **params):
        self.hardware = Hardware("t/velocity", "s/position", states=("t/velocity", "s/position"))
        for interface in self.hardware.state_interfaces:
            interface.value = 0.0
        self.control = manager(self.hardware)
        self.base = add(self.control, "base", "tricycle_controller/TricycleController", **GIVEN | params)
        self.now = 1000 * S
        self.control.switch(["base"], now=self.now)

    def command(self, linear, angular):
        self.control.command("base", [linear, angular], self.now)
        return self

    def run(self, steps, follows=True):
        for _ in range(steps):
            self.control.update(self.now, 0.01)
            self.now += STEP
            if follows:
                for state, value in zip(self.hardware.state_interfaces, self.hardware.values(), strict=True):
                    state.value = state.value if math.isnan(value) else value
        return self

    @property
    def wheel(self):
        return pytest.approx(self.hardware.values(), abs=1e-9)


def test_a_twist_becomes_speed_and_angle_of_the_wheel():
    robot = Robot().command(0.5, 0.25).run(3)
    angle = math.atan(0.25 * 1.2 / 0.5)
    assert robot.wheel == [0.5 / (0.1 * math.cos(angle)), angle]
    sample = robot.base.sample(0)
    assert (sample.frame_id, sample.enable_odom_tf) == ("odom", False)


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_the_odometry_of_a_wheel_that_does_what_is_commanded_is_the_twist(linear, angular):
    pose = DrivenWheelPose(0.1, 1.2)
    pose.follow(*pose.command(linear, angular), 0.01)
    assert (pose.linear, pose.angular) == pytest.approx((linear, angular), abs=1e-9)
    assert pose.heading == pytest.approx(angular * 0.01)


def test_on_the_spot_the_wheel_stands_across():
    robot = Robot().command(0.0, -0.5).run(3)
    assert robot.wheel == [0.5 * 1.2 / 0.1, -math.pi / 2]


@pytest.mark.parametrize(("measured", "part"), [(0.0, math.cos(1.0)), (0.6, 1.0), (-1.0, 0.01)])
def test_the_wheel_turns_slowly_while_it_is_far_from_its_angle(measured, part):
    robot = Robot()
    robot.hardware.state_interfaces[1].value = measured
    linear, angular = 1.0, math.tan(1.0) / 1.2
    robot.command(linear, angular).run(1, follows=False)
    assert robot.hardware.values()[0] == pytest.approx(part * linear / (0.1 * math.cos(1.0)))


def test_without_a_twist_it_brakes_along_the_limit_and_stays_at_its_angle():
    robot = Robot(**{"traction.max_acceleration": 1000.0, "traction.max_deceleration": 10.0}).command(0.5, 0.25).run(5)
    speed, angle = robot.hardware.values()
    robot.now += S  # longer than the timeout of 500 ms
    robot.run(1)
    assert robot.wheel == [speed - 0.1, angle]
    assert robot.run(200).wheel == [0.0, angle]


def test_both_joints_have_limits_of_their_own():
    robot = Robot(
        **{"traction.max_velocity": 4.0, "traction.max_acceleration": 50.0},
        **{"steering.max_position": 0.3, "steering.max_velocity": 2.0},
    )
    robot.command(0.5, 1.0).run(1)
    assert robot.wheel == [0.5, 0.02]
    assert robot.command(0.5, 1.0).run(20).wheel == [4.0, 0.3]


def test_steering_begins_where_it_stands():
    robot = Robot(**{"steering.max_velocity": 1.0})
    robot.hardware.state_interfaces[1].value = 0.5
    assert robot.command(0.5, 0.0).run(1).hardware.values()[1] == pytest.approx(0.49)


def test_a_stop_stops_at_once_and_holds_the_steering():
    robot = Robot(**{"traction.max_deceleration": 1.0}).command(0.5, 0.25).run(50)
    robot.control.running.forget(robot.now, "stop was commanded")
    assert robot.hardware.values()[0] == 0.0
    assert math.isnan(robot.hardware.values()[1])
    assert robot.run(1).hardware.values()[0] == 0.0


def test_the_command_of_the_wheel_is_in_the_sample_where_it_is_to_be_published():
    robot = Robot(publish_ackermann_command=True, **{"traction.max_velocity": 3.0}).command(0.5, 0.25).run(3)
    assert robot.base.sample(0).ackermann == pytest.approx(robot.hardware.values())
    assert Robot().command(0.5, 0.25).run(3).base.sample(0).ackermann is None


def test_a_wheel_whose_angle_is_unknown_has_no_command_to_publish():
    robot = Robot(publish_ackermann_command=True, open_loop=True)
    robot.hardware.state_interfaces[1].value = math.nan
    assert robot.run(2, follows=False).base.sample(0).ackermann is None


@pytest.mark.parametrize("only_twist", [True, False])
def test_odometry_without_a_pose_is_so_in_the_sample(only_twist):
    robot = Robot(odom_only_twist=only_twist).command(0.5, 0.0).run(20)
    sample = robot.base.sample(0)
    assert sample.only_twist is only_twist
    assert sample.x > 0.0  # of the transform


def test_its_interfaces_are_upstreams():
    base = Robot().base
    assert base.command_interface_names() == base.state_interface_names() == ["t/velocity", "s/position"]
    assert (base.reference_interfaces(), base.topic, base.command_timeout.limit_ns) == ((), "cmd_vel", 500_000_000)


def test_limits_can_be_set_while_it_runs():
    robot = Robot()
    robot.base.on_set(robot.control._params["base"].changed({"traction.max_velocity": 1.0}))
    assert robot.command(0.5, 0.0).run(3).wheel == [1.0, 0.0]


def test_every_error_is_named_at_once():
    wrong = {"wheelbase": 0.0, "wheel_radius": 0.0, "steering_joint_name": "t"}
    limits = {"steering.min_position": 1.0, "steering.max_position": -1.0}
    with pytest.raises(ConfigError) as reported:
        Robot(**wrong, **limits)
    for part in (
        "t is both traction and steering joint",
        "wheelbase is missing",
        "wheel_radius is missing",
        "min_position 1 is above",
    ):
        assert part in str(reported.value)


def test_what_would_keep_it_moving_has_no_effect():
    robot = Robot(**{"traction.min_velocity": 1.0, "steering.min_velocity": 0.5})
    texts = [event.text for event in robot.control.events() if "no effect" in event.text]
    assert len(texts) == 2
    assert robot.command(0.0, 0.0).run(3).hardware.values()[0] == 0.0


@pytest.mark.parametrize(
    ("limit", "text"),
    [
        ("traction.max_velocity", "traction.max_velocity is 0, so the wheel does not turn; give a value above 0"),
        ("steering.max_velocity", "steering.max_velocity is 0, so the wheel is not steered; give a value above 0"),
        ("steering.max_position", "steering.max_position is 0, so the wheel is not steered; give a value above 0"),
        ("steering.max_acceleration", "steering.max_acceleration is 0, so the wheel is not steered"),
    ],
)
def test_limits_of_zero_are_reported(limit, text):
    notices = [event.text for event in Robot(**{limit: 0.0}).control.new_events if event.kind == "immobile"]
    assert len(notices) == 1
    assert notices[0].startswith(f"base: {text}")


@pytest.mark.parametrize(
    ("limits", "key"),
    [
        ({"traction.max_deceleration": 0.0}, "max_deceleration is 0, so the wheel would never brake"),
        ({"traction.max_acceleration": 0.0}, "max_acceleration is 0, so the wheel would never brake"),
        ({"traction.max_jerk": 0.0}, "max_jerk is 0, so the wheel can neither start nor brake"),
    ],
)
def test_a_wheel_that_would_never_brake_is_refused(limits, key):
    with pytest.raises(ConfigError, match=f"traction.{key}"):
        Robot(**limits)
