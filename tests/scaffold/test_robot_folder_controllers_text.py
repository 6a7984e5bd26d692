"""The ros2_controllers.yaml of a new robot."""

from pathlib import Path

import pytest
import yaml
from support.drive_shapes import modes, shape

from canopen_control.scaffold import bases
from canopen_control.scaffold.new_robot import Device, plan_robot
from canopen_control.scaffold.robot_folder import controllers_text


def keys_of(*ods, **how):
    devices = [Device(number, Path("d.eds"), od) for number, od in enumerate(ods, 2)]
    return yaml.safe_load(controllers_text(plan_robot("r", devices, **how)))


def test_joints_are_grouped_by_what_commands_them():
    keys = keys_of(shape(), shape(drop=(0x60FF,), **modes(0x81)), shape())
    assert keys["velocity_controller"]["ros__parameters"]["joints"] == ["joint_1", "joint_3"]
    assert keys["position_controller"]["ros__parameters"]["joints"] == ["joint_2"]
    assert keys["controller_manager"]["ros__parameters"]["enforce_command_limits"] is True


def test_the_rate_is_that_of_sync():
    assert keys_of(shape())["controller_manager"]["ros__parameters"]["update_rate"] == 50


def test_a_base_goes_before_the_controllers_of_single_joints():
    keys = keys_of(shape(), shape(), base="diff")
    assert list(keys["controller_manager"]["ros__parameters"]) == [
        "update_rate",
        "joint_state_broadcaster",
        "base_controller",
        "velocity_controller",
    ]
    assert keys["base_controller"]["ros__parameters"]["position_feedback"] is True


def test_of_four_wheels_those_of_a_side_belong_together():
    parameters = keys_of(*[shape()] * 4, base="diff")["base_controller"]["ros__parameters"]
    assert parameters["left_wheel_names"] == ["front_left_wheel_joint", "rear_left_wheel_joint"]


def test_odometry_is_of_what_the_drives_tell():
    blind = {"drop": (0x606C,), "s6064_00": {"pdo_mappable": False}}
    keys = keys_of(shape(**blind), shape(**blind), base="diff")
    assert keys["base_controller"]["ros__parameters"]["open_loop"] is True
    assert "joint_state_broadcaster" not in keys["controller_manager"]["ros__parameters"]


@pytest.fixture
def every_base(monkeypatch):
    """Let every controller of a base be there."""
    monkeypatch.setattr(bases, "TYPES", {base.type_name for base in bases.BASES.values()})


@pytest.mark.usefixtures("every_base")
def test_a_tricycle_names_its_wheels_from_right_to_left_and_its_steering():
    keys = keys_of(*[shape()] * 3, base="tricycle")
    parameters = keys["base_controller"]["ros__parameters"]
    assert parameters["traction_joints_names"] == ["right_wheel_joint", "left_wheel_joint"]
    assert parameters["steering_joints_names"] == ["steering_joint"]
    assert parameters["reference_timeout"] == 0.5
    assert keys["position_controller"]["ros__parameters"]["joints"] == ["steering_joint"]


@pytest.mark.usefixtures("every_base")
def test_a_mecanum_base_names_each_wheel_and_knows_no_other_odometry():
    parameters = keys_of(*[shape()] * 4, base="mecanum")["base_controller"]["ros__parameters"]
    assert parameters["rear_left_wheel_command_joint_name"] == "rear_left_wheel_joint"
    assert parameters["kinematics.sum_of_robot_center_projection_on_X_Y_axis"] == 0.3
    assert not {"open_loop", "position_feedback", "cmd_vel_timeout"} & parameters.keys()
