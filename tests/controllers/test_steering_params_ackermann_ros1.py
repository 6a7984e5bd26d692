from __future__ import annotations

import math

import pytest
from support.bases import ACKERMANN
from support.control import Hardware, S, add, manager

from canopen_control.controllers.params import Params
from canopen_control.controllers.steering_params import is_ros1, read_ros1
from canopen_control.errors import RobotConfigError
from canopen_control.rpc.messages.parameters import ParameterValue

#: as the package's own test robot has it
NOETIC = {
    "rear_wheel": "rear_wheel_joint",
    "front_steer": "front_steer_joint",
    "publish_rate": 50.0,
    "pose_covariance_diagonal": [0.001, 0.001, 1000000.0, 1000000.0, 1000000.0, 1000.0],
    "twist_covariance_diagonal": [0.001, 0.001, 1000000.0, 1000000.0, 1000000.0, 1000.0],
    "wheel_separation_h": 0.4,
    "wheel_radius": 0.11,
    "wheel_separation_h_multiplier": 1.5,
    "cmd_vel_timeout": 20.0,
    "linear": {"x": {"has_velocity_limits": True, "max_velocity": 0.5}},
    "angular": {"z": {"has_velocity_limits": True, "max_velocity": 0.3}},
}


def read(**params):
    inputs = Params.of({**NOETIC, **params}, "base")
    return inputs, read_ros1(inputs)


def test_its_keys_report_it_from_the_controller_of_ros_2():
    assert is_ros1(Params.of(NOETIC))
    assert is_ros1(Params.of({"wheel_separation_h": 0.4}))
    assert not is_ros1(Params.of({"wheelbase": 0.4, "traction_joints_names": ["r", "l"]}))


def test_it_is_a_bicycle_of_its_two_joints_and_sizes():
    params, inputs = read()
    assert (inputs.traction_joints_names, inputs.steering_joints_names) == (
        ("rear_wheel_joint",),
        ("front_steer_joint",),
    )
    assert inputs.wheelbase == pytest.approx(0.6)
    assert (inputs.radius, inputs.reference_timeout, inputs.position_feedback) == (0.11, 20.0, True)
    assert inputs.limits[0].limits().max_velocity == 0.5
    assert math.isnan(inputs.limits[1].limits().max_velocity)
    assert params.source is inputs


@pytest.mark.parametrize(
    "words",
    [
        "'wheel_separation_h' is read as 'wheelbase'",
        "'publish_rate' has no effect",
        "'angular.z.max_velocity' has no effect",
        "used it as the angle of front_steer",
    ],
)
def test_what_is_read_otherwise_is_reported(words):
    params, _ = read()
    assert any(words in warning for warning in params.warnings)


def base(**params):
    hardware = Hardware(
        "rear_wheel_joint/velocity", "front_steer_joint/position",
        states=tuple(f"{joint}_joint/position" for joint in ("rear_wheel", "front_steer")),
    )  # fmt: skip
    for interface in hardware.state_interfaces:
        interface.value = 0.0
    control = manager(hardware)
    return hardware, control, add(control, "base", ACKERMANN, **{**NOETIC, "cmd_vel_timeout": 0.5, **params})


def test_the_controller_drives_and_follows_its_two_joints_within_the_limit():
    hardware, control, base_controller = base()
    control.switch(["base"], now=0)
    control.command("base", [2.0, 0.5], 0)
    control.update(S // 50, 0.02)
    speed, angle = hardware.values()
    assert speed == pytest.approx(0.5 / 0.11)
    assert angle == pytest.approx(math.atan(0.5 * 0.6 / 0.5))
    hardware.set("rear_wheel_joint/position", 1.0)
    control.update(S // 25, 0.02)
    assert base_controller.pose.x == pytest.approx(0.11, abs=0.01)


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"steer_pos_multiplier": 2.0}, "steer_pos_multiplier is 2"),
        ({"wheel_separation_h": 0.0}, "wheelbase is missing or 0"),
        ({"front_steer": "rear_wheel_joint", "wheel_radius": -1.0}, "wheel_radius"),
    ],
)
def test_what_cannot_be_is_refused(params, words):
    with pytest.raises(RobotConfigError) as caught:
        base(**params)
    assert words in str(caught.value)


class Geometry:
    def separation(self, left, right):
        return 0.5 if (left, right) == (("rear_wheel_joint",), ("front_steer_joint",)) else None

    def radius(self, wheels):
        return 0.2 if wheels == ("rear_wheel_joint",) else None


def test_sizes_that_are_not_given_are_the_descriptions_and_reported():
    reports = []
    ros1 = read_ros1(Params.of({"front_steer": "front_steer_joint"}, "base"), Geometry(), reports.append)
    assert (ros1.wheelbase, ros1.radius) == (0.5, 0.2)
    assert [text.partition(" is not")[0] for text in reports] == ["wheel_separation_h", "wheel_radius"]
    ros1 = read_ros1(Params.of(NOETIC, "base"), Geometry(), reports.append)
    assert (ros1.radius, len(reports)) == (0.11, 2)
    assert read_ros1(Params.of({"front_steer": "other"}, "base"), Geometry(), reports.append).wheelbase == 0.0


def test_sizes_of_the_description_are_reported_once_and_not_again_when_a_parameter_is_set():
    hardware = Hardware(
        "rear_wheel_joint/velocity", "front_steer_joint/position",
        states=tuple(f"{joint}_joint/position" for joint in ("rear_wheel", "front_steer")),
    )  # fmt: skip
    control = manager(hardware)
    base_controller = control.load("base", ACKERMANN, Params.of({"front_steer": "front_steer_joint"}))
    base_controller.geometry = Geometry()
    control.configure("base")
    control.set_parameters("base", [ParameterValue(name="reference_timeout", kind="double", value=1.0)])
    assert sum("the value of the description is used" in event.text for event in control.events()) == 2
