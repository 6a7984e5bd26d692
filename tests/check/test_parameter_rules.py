"""Findings about the parameters of controllers: types that ROS 2 refuses, limits of 0, and the clock."""

import contextlib

import pytest
from support.configs import changed, found, line_of

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.errors import ConfigError
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.od.issues import Severity
from canopen_control.runtime.core import RobotCore
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot

REFUSED = "ROS 2 refuses this value; the parameter is"
POINT = f"{REFUSED} a number with a decimal point"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("linear.x.max_velocity: 1.0 ", "linear.x.max_velocity: 1 ", f"linear.x.max_velocity: {POINT}; write 1.0"),
        ("linear.x.min_velocity: -1.0", "linear: {x: {min_velocity: -1}}", f"x.min_velocity: {POINT}; write -1.0"),
        ("publish_rate: 50.0 ", "publish_rate: 50 ", f"publish_rate: {POINT}; write 50.0"),
        ("publish_rate: 50.0 ", "publish_rate: 1e2 ", ""),
        ("enable_odom_tf: true", "enable_odom_tf: true\n    velocity_rolling_window_size: 5", ""),
        (
            "pose_covariance_diagonal: [0.001, 0.001, 0.001, 0.001, 0.001, 0.01]",
            "pose_covariance_diagonal: [0.001, 0, 0, 1.e-3, 0.001, 1]",
            f"{REFUSED} a list of numbers with a decimal point; write [0.001, 0.0, 0.0, 1.e-3, 0.001, 1.0]",
        ),
        ("left_wheel_names: [left_wheel_joint]", "left_wheel_names: left_wheel_joint", "; write [left_wheel_joint]"),
        ("command_timeout: 2.0 ", "command_timeout: 2 ", ""),  # not a parameter of ROS 2
    ],
)
def test_a_value_of_a_type_that_ros_2_refuses(tmp_path, old, new, words):
    files = changed(tmp_path, "robby", controllers={old: new})
    texts = found(files)
    if not words:
        assert texts == []
        return
    (text,) = texts
    line = line_of(files, "controllers", new.partition(":")[0] + ": " + new.partition(": ")[2].rstrip()[:6])
    assert text.startswith(f"ros2_controllers.yaml:{line}:")
    assert f"warning: robby_base_controller: {new.partition(':')[0].partition('{')[0]}" in text
    assert text.endswith(words)


def test_a_file_of_ros_1_may_have_integers(tmp_path):
    files = changed(tmp_path, "mobile_base_ros1", controllers={"max_velocity: 1.0": "max_velocity: 1"})
    assert found(files) == []


@pytest.mark.parametrize("where", ["controller_manager", "robby_base_controller", "/**"])
def test_use_sim_time_of_a_robot_without_a_simulation_is_one_warning(tmp_path, where):
    head = f"{where}:\n  ros__parameters:\n"
    edits = {head: f"{head}    use_sim_time: true\n"}
    if where == "/**":
        edits = {"controller_manager:\n": f"{head}    use_sim_time: true\ncontroller_manager:\n"}
    files = changed(tmp_path, "robby", controllers=edits)
    (text,) = found(files)
    line = line_of(files, "controllers", "use_sim_time")
    assert text.startswith(f"ros2_controllers.yaml:{line}: warning: use_sim_time has no effect: no part of this robot")


def test_use_sim_time_of_a_simulated_robot_is_in_order_unless_its_drives_are_real():
    assert found(find_robot("diffbot_sim")) == []
    assert any("use_sim_time has no effect" in text for text in found(find_robot("diffbot_sim"), real=True))


@pytest.mark.parametrize(
    ("key", "value", "effect"),
    [
        ("linear.x.max_velocity", "1.0 ", "move forward; give a value above 0"),
        ("angular.z.max_velocity", "1.0 ", "turn to the left; give a value above 0"),
        ("angular.z.min_velocity", "-1.0", "turn to the right; give a value below 0"),
        ("linear.x.min_velocity", "-1.0", ""),  # a base that drives only forward
    ],
)
def test_a_limit_of_zero_for_one_direction(tmp_path, key, value, effect):
    files = changed(tmp_path, "robby", controllers={f"{key}: {value}": f"{key}: 0.0 "})
    line = line_of(files, "controllers", key)
    text = f"ros2_controllers.yaml:{line}: warning: robby_base_controller: {key} is 0, so the base does not {effect}"
    assert found(files) == ([f"{text}, or remove it"] if effect else [])


def test_a_misspelt_interface_of_several_joints_is_one_error_at_its_name(tmp_path):
    files = changed(tmp_path, "robby", controllers={"interface_name: velocity": "interface_name: velocty"})
    assert found(files) == [
        f"ros2_controllers.yaml:{line_of(files, 'controllers', 'velocty')}: error: robby_forward_controller: "
        "no command interface is called 'velocty' (did you mean 'velocity'?); use the description's name"
    ]


def test_a_joint_that_is_listed_twice_is_an_error_at_the_list(tmp_path):
    files = changed(tmp_path, "robby", controllers={"      - right_wheel_joint": "      - left_wheel_joint"})
    (text,) = found(files)
    assert text.startswith(f"ros2_controllers.yaml:{line_of(files, 'controllers', 'joints:')}:5: error: robby_forward_")
    assert "joints contains a name twice: left_wheel_joint" in text


@pytest.mark.parametrize(("rate", "words"), [("50.0", "got the number 50.0; write 50"), ("'50'", "remove the quotes")])
def test_an_update_rate_that_cannot_be_read_is_one_error(tmp_path, rate, words):
    files = changed(tmp_path, "robby", controllers={"update_rate: 50 ": f"update_rate: {rate} "})
    report = check_robot(files, CheckOptions())
    (text,) = [str(item) for item in report.findings if item.severity is not Severity.NOTE]
    assert "ros2_controllers.yaml:5:18: error: " in text
    assert words in text


def test_an_interface_that_the_description_misspells_is_one_error_there(tmp_path):
    edits = {'<command_interface name="velocity"/>': '<command_interface name="velocty"/>'}
    files = changed(tmp_path, "robby", description=edits)
    (text,) = found(files)
    assert "robby.urdf.xacro:" in text
    assert text.endswith("error: a command interface is called 'velocty'; call it 'velocity'")


def test_two_nodes_of_one_name_are_one_error(tmp_path):
    files = changed(tmp_path, "robby", bus={"\n  right_drive:": "\n  left_drive:"})
    errors = [str(each) for each in check_robot(files, CheckOptions()).findings if each.severity is Severity.ERROR]
    assert len(errors) == 1, errors
    assert "nodes.left_drive: duplicate key 'left_drive' (first at line 73); rename or remove one" in errors[0]


@pytest.mark.parametrize(
    ("old", "new", "meant"),
    [
        ("left_wheel_names: [", "left_wheel_name: [", "left_wheel_names"),
        ("    joints:", "    joint:", "joints"),
        ("interface_name: velocity", "interface: velocity", "interface_name"),
    ],
)
def test_a_misspelt_key_that_is_needed_is_one_error_at_its_place(tmp_path, old, new, meant):
    files = changed(tmp_path, "robby", controllers={old: new})
    (text,) = found(files)
    wrong = new.strip().partition(":")[0]
    assert text.startswith(f"ros2_controllers.yaml:{line_of(files, 'controllers', new)}:5: error: robby_")
    assert text.endswith(f"_controller: unknown key '{wrong}' (did you mean '{meant}'?)")
    setup = read_robot(files, controllers=["robby_base_controller" if "wheel" in meant else "robby_forward_controller"])
    clock = Reactor(ManualClock())
    with contextlib.closing(clock) as reactor, pytest.raises(ConfigError, match=f"unknown key '{wrong}'"):
        RobotCore(setup, reactor)


def test_a_misspelt_block_of_the_controller_manager_is_one_error(tmp_path):
    files = changed(tmp_path, "robby", controllers={"controller_manager:": "controler_manager:"})
    report = check_robot(files, CheckOptions())
    (text,) = [str(item) for item in report.findings if item.severity is not Severity.NOTE]
    assert "unknown block 'controler_manager' (did you mean 'controller_manager'?)" in text


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        (
            "",
            "lower and upper of <limit> are 0 or absent, so it accepts no position but 0; write both, in rad or m, or",
        ),
        ('lower="-180" upper="180"', "180 rad is more than four turns; if these are degrees, write -3.142 and 3.142"),
        ('lower="-6.3" upper="6.3"', ""),
    ],
)
def test_limits_of_a_joint_that_are_absent_or_in_degrees(tmp_path, limits, words):
    files = changed(tmp_path, "arm6", description={'lower="-3.1" upper="3.1"': limits})
    texts = found(files)
    assert len(texts) == bool(words)
    assert all(text.startswith(f"arm6.urdf:{line_of(files, 'description', 'joint_1')}: warning: ") for text in texts)
    assert words in "".join(texts)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("devicename", "unknown <param name='devicename'>; call it 'device_name'"),
        ("node_id", "call the parameter device_"),
    ],
)
def test_a_joint_whose_parameter_has_another_name(tmp_path, name, words):
    (text,) = found(changed(tmp_path, "arm6", description={"device_name": name}))
    assert "joint joint_1: " in text
    assert words in text
