"""Typical mistakes, inserted into each bundled robot that can have them, give exactly the expected findings."""

import dataclasses
import re

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.configs import BASES, FIRST, ROBOTS, changed, found, line_of
from support.makers import folder
from support.properties import examples
from support.robots import copy_robby

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.check.rules import find
from canopen_control.controllers.controllers_file import read_controllers
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.master.config import read_bus
from canopen_control.od.issues import Severity
from canopen_control.runtime.robot_files import find_robot
from canopen_control.urdf.description import read_description


@pytest.mark.parametrize("name", ROBOTS)
def test_nothing_is_wrong_with_a_bundled_robot(name):
    assert found(find_robot(name)) == []


def test_what_a_ros_1_file_specifies_in_other_words_is_noted_once_each():
    files = find_robot("mobile_base_ros1")
    findings = find(
        files, read_bus(files.bus), read_controllers(files.controllers), read_description(files.description)
    )
    texts = [finding.text for finding in findings]
    assert len(texts) == len(set(texts)) == 6
    assert "wheel_left_joint turns once for 30 turns of left_wheel_motor" in texts[4]
    assert {finding.severity for finding in findings} == {Severity.NOTE}
    assert "mobile_base_controller.left_wheel: 'left_wheel' is read as 'left_wheel_names'" in texts


@pytest.mark.parametrize("name", ROBOTS)
def test_a_controller_that_the_file_does_not_have(name):
    right = FIRST[name]
    typed = right.replace("controller", "controler")
    (text,) = found(find_robot(name), controllers=[typed])
    assert re.fullmatch(
        rf"ros2_controllers\.yaml:\d+: error: --controller {typed}: no controller of this name \(did you mean '{right}'"
        r"\?\); use that name, or add the controller",
        text,
    )


JOINTS = {
    "robby": ("      - left_wheel_joint", "left_wheel_joint", "lef_wheel_joint"),
    "diffbot_sim": ('["left_wheel_joint"]', "left_wheel_joint", "left_weel_joint"),
    "mobile_base_ros1": ("joints: [wheel_left_joint", "wheel_left_joint", "wheel_lft_joint"),
    "arm6": ("joint_1,", "joint_1", "joint_11"),
    "forklift": ("[steering_joint]", "steering_joint", "stering_joint"),
    "mecanum": (": front_left_wheel_joint", "front_left_wheel_joint", "front_let_wheel_joint"),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_a_joint_that_the_description_does_not_have(name, tmp_path):
    place, right, wrong = JOINTS[name]
    files = changed(tmp_path, name, controllers={place: place.replace(right, wrong)})
    texts = found(files)
    controller = "wheels_velocity_controller" if name == "mobile_base_ros1" else FIRST[name]
    line = line_of(files, "controllers", wrong)
    expected = (
        f"ros2_controllers.yaml:{line}: error: {controller}: joint '{wrong}' is not in {files.description.name} "
        f"(did you mean '{right}'?); use the description's name"
    )
    assert texts == [expected]


DEVICES = {
    "robby": ("${side}_drive", "${side}_drve", "device_name 'left_drve'", "left_drive", 2),
    "diffbot_sim": (">left_drive<", ">left_drve<", "device_name 'left_drve'", "left_drive", 1),
    "mobile_base_ros1": (
        "${side}_wheel_motor",
        "${side}_weel_motor",
        "actuator 'left_weel_motor'",
        "left_wheel_motor",
        2,
    ),
    "arm6": (">joint_1_drive<", ">joint_1_drve<", "device_name 'joint_1_drve'", "joint_1_drive", 1),
    "forklift": ("${name}_drive", "${name}_drve", "device_name 'right_traction_drve'", "right_traction_drive", 3),
    "mecanum": ("${name}_drive", "${name}_drve", "device_name 'front_left_drve'", "front_left_drive", 4),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_a_drive_that_bus_yml_does_not_have(name, tmp_path):
    old, new, reported, right, count = DEVICES[name]
    edits = {old: new}
    if name == "diffbot_sim":
        edits["gz_ros2_control/GazeboSimSystem"] = "canopen_ros2_control/RobotSystem"
    texts = found(changed(tmp_path, name, description=edits))
    texts = [text for text in texts if "use_sim_time has no effect" not in text]  # of the plugin that is replaced
    assert len(texts) == count
    assert re.fullmatch(
        rf".*:\d+: error: joint \w+: {reported} is not a node of bus\.yml \(did you mean '{right}'\?\); "
        "use a name under nodes:",
        texts[0],
    )


BLOCKS = {
    "robby": (
        "\nrobby_forward_controller:\n  ros__parameters",
        "\n/robot/robby_forward_controller:\n  ros__parameters",
    ),
    "diffbot_sim": ("\ndiff_drive_base_controller:\n", "\n/robot/diff_drive_base_controller:\n"),
    "mobile_base_ros1": ("\nmobile_base_controller:\n", "\n/robot/mobile_base_controller:\n"),
    "arm6": ("\narm_position_controller:\n", "\n/robot/arm_position_controller:\n"),
    "forklift": ("\nforklift_base_controller:\n", "\n/robot/forklift_base_controller:\n"),
    "mecanum": ("\nmecanum_base_controller:\n", "\n/robot/mecanum_base_controller:\n"),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_a_namespace_that_should_not_be_there(name, tmp_path):
    old, new = BLOCKS[name]
    files = changed(tmp_path, name, controllers={old: new})
    (text,) = found(files)
    line = line_of(files, "controllers", "/robot/")
    assert text == (
        f"ros2_controllers.yaml:{line}: warning: {FIRST[name]} is in the namespace '/robot', "
        f"but its controller_manager in '/'; name the block '{FIRST[name]}', otherwise ROS does not find its parameters"
    )


@pytest.mark.parametrize("name", ROBOTS)
def test_a_name_that_no_node_may_have(name, tmp_path):
    files = find_robot(name)
    text = files.controllers.read_text()
    wrong = FIRST[name].replace("_", " ", 1)
    count = text.count(FIRST[name])
    folder = changed(tmp_path, name)
    folder.controllers.write_text(text.replace(FIRST[name], wrong))
    assert count
    (reported,) = found(folder)
    line = line_of(folder, "controllers", wrong) + ("ros1" not in name)  # the line of the type
    assert re.fullmatch(
        rf"ros2_controllers\.yaml:{line}: error: '{wrong}' is not a valid node name: letters, digits and _ only; "
        f"call it '{FIRST[name]}'",
        reported,
    )


TIMEOUTS = {
    "robby": ("cmd_vel_timeout: 0.5", "cmd_vel_timeout: 0.15", "cmd_vel_timeout"),
    "diffbot_sim": ("cmd_vel_timeout: 0.5", "cmd_vel_timeout: 0.15", "cmd_vel_timeout"),
    "mobile_base_ros1": ("cmd_vel_timeout: 0.25", "cmd_vel_timeout: 0.15", "cmd_vel_timeout"),
    "arm6": ("    joints:", "    command_timeout: 0.15\n    joints:", "command_timeout"),
    "forklift": ("reference_timeout: 0.5", "reference_timeout: 0.15", "reference_timeout"),
    "mecanum": ("reference_timeout: 0.5", "reference_timeout: 0.15", "reference_timeout"),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_a_timeout_below_two_command_periods(name, tmp_path):
    old, new, key = TIMEOUTS[name]
    files = changed(tmp_path, name, controllers={old: new})
    base = BASES[name][0] if name in BASES else FIRST[name]
    line = line_of(files, "controllers", f"{key}: 0.15")
    assert found(files) == [
        f"ros2_controllers.yaml:{line}: warning: {base}: {key} 0.15 s is below two "
        "command periods, so the robot stutters; give 0.2 s or more: teleop and `twist` send every 0.1 s"
    ]


@pytest.mark.parametrize("name", ["forklift", "mecanum"])
def test_a_timeout_of_zero_is_one_update_where_upstream_has_it_so(name, tmp_path):
    files = changed(tmp_path, name, controllers={"reference_timeout: 0.5": "reference_timeout: 0.0"})
    assert found(files) == [
        f"ros2_controllers.yaml:{line_of(files, 'controllers', 'reference_timeout')}: warning: {FIRST[name]}: "
        "reference_timeout is 0, so a twist is used for one update only; give a time in s; the robot stutters unless "
        "each update receives a twist; 0.5 s is usual"
    ]


@pytest.mark.parametrize("name", ["robby", "diffbot_sim", "mobile_base_ros1"])
def test_a_timeout_of_zero_is_for_ever(name, tmp_path):
    old, _, key = TIMEOUTS[name]
    files = changed(tmp_path, name, controllers={old: f"{key}: 0.0"})
    base = BASES[name][0] if name in BASES else FIRST[name]
    assert found(files) == [
        f"ros2_controllers.yaml:{line_of(files, 'controllers', f'{key}: 0.0')}: warning: {base}: {key} is 0, so "
        "commands never expire: moving joints continue when the sender disappears; give the time without a command "
        "after which the joints stop, such as 2 s"
    ]


@pytest.mark.parametrize("name", ["robby", "diffbot_sim", "mobile_base_ros1"])
@pytest.mark.parametrize(("seconds", "reported"), [(60, 0), (500, 1)])
def test_a_timeout_that_was_written_in_ms_is_a_warning(name, seconds, reported, tmp_path):
    old, _, key = TIMEOUTS[name]
    files = changed(tmp_path, name, controllers={old: f"{key}: {seconds}.0"})
    texts = [line for line in found(files) if f"{key} is " in line]
    assert len(texts) == reported
    assert all(
        "500 s: moving joints continue for that time when the sender disappears; give the time without" in line
        for line in texts
    )


@pytest.mark.parametrize("name", ["robby", "diffbot_sim", "arm6"])
def test_an_update_rate_above_the_sync(name, tmp_path):
    files = changed(tmp_path, name, controllers={"update_rate: 50": "update_rate: 100"})
    line = line_of(files, "controllers", "update_rate")
    assert found(files) == [
        f"ros2_controllers.yaml:{line}: warning: update_rate 100 Hz is higher than the SYNC rate of bus.yml, "
        "50 Hz; set update_rate: 50, or sync_period: 10000"
    ]


@pytest.mark.parametrize("name", ["robby", "diffbot_sim", "arm6"])
def test_an_update_rate_below_the_sync(name, tmp_path):
    files = changed(tmp_path / "1", name, controllers={"update_rate: 50": "update_rate: 10"})
    line = line_of(files, "controllers", "update_rate")
    assert (
        f"ros2_controllers.yaml:{line}: note: controllers run at 10 Hz, though the SYNC rate of bus.yml is 50 Hz; "
        "set update_rate: 50 to run them in each cycle"
    ) in found(files, notes=True)
    files = changed(tmp_path / "2", name, controllers={"update_rate: 50": "update_rate: 40"})
    assert not any("controllers run at" in item for item in found(files, notes=True))


def test_what_is_published_more_often_than_anybody_asks_for_is_reported(tmp_path):
    states = "JointStateBroadcaster\n"
    edits = {"update_rate: 50": "update_rate: 500", states: f"{states}      update_rate: 250\n"}
    files = changed(tmp_path, "robby", bus={"sync_period: 20000": "sync_period: 2000"}, controllers=edits)
    reported = [item for item in found(files, notes=True) if "request" in item]
    assert reported == [
        f"ros2_controllers.yaml:{line_of(files, 'controllers', 'update_rate: 250')}: note: joint_state_broadcaster "
        "publishes at 250 Hz, but ROS and bags request 100 Hz by default; run the bridge with --ros-args -p "
        "rate:=250.0, record with --rate 250"
    ]


@pytest.mark.parametrize("name", ROBOTS)
def test_no_hardware_at_all(name, tmp_path):
    files = changed(tmp_path, name)
    text = files.description.read_text()
    files.description.write_text(re.sub(r"<(ros2_control|transmission).*?</\1>", "", text, flags=re.DOTALL))
    assert found(files) == [
        f"{files.description.name}:1: error: no <ros2_control> tag and no <transmission> assigns drives to "
        "joints; add a <ros2_control> tag with the joints and drives"
    ]


PLUGINS = {
    "robby": ("canopen_ros2_control/RobotSystem", "canopen_ros2_control/RobotSystm"),
    "diffbot_sim": ("gz_ros2_control/GazeboSimSystem", "gz_ros2_control/GazeboSimSystm"),
    "arm6": ("canopen_ros2_control/RobotSystem", "canopen_ros2_control/RobotSystm"),
}


@pytest.mark.parametrize("name", PLUGINS)
def test_an_unknown_plugin(name, tmp_path):
    old, new = PLUGINS[name]
    (text,) = found(changed(tmp_path, name, description={old: new}))
    assert re.fullmatch(
        rf".*:\d+: error: no hardware plugin '{new}' \(did you mean '{old}'\?\); use that, or --mock or --real", text
    )


@pytest.mark.parametrize("name", ROBOTS)
def test_a_gazebo_plugin_with_a_typing_error(name, tmp_path):
    tag = '  <gazebo><plugin name="control" filename="libgazebo_ros_contol.so"/></gazebo>\n</robot>'
    files = changed(tmp_path, name, description={"</robot>": tag})
    line = line_of(files, "description", "libgazebo")
    if files.description.suffix == ".xacro":
        line = line_of(files, "description", 'plugin name="control"')
    assert found(files) == [
        f"{files.description.name}:{line}: error: no Gazebo plugin 'libgazebo_ros_contol.so' (did you mean "
        "'libgazebo_ros_control.so'?); Gazebo runs without controllers"
    ]


@pytest.mark.parametrize("sensor", ["ft_sensor", "contact", "camera"])
def test_another_gazebo_plugin_is_not_a_typing_error(sensor, tmp_path):
    tag = f'  <gazebo><plugin name="sensor" filename="libgazebo_ros_{sensor}.so"/></gazebo>\n</robot>'
    assert found(changed(tmp_path, "robby", description={"</robot>": tag})) == []


@pytest.mark.parametrize("name", ROBOTS)
def test_a_key_that_is_unknown_or_repeated(name, tmp_path):
    controller = FIRST[name]
    text = data_path("config", name).joinpath("ros2_controllers.yaml").read_text()
    block = text[text.rindex(f"\n{controller}:") :]
    key = next(
        line for line in block.splitlines()[2:] if re.match(r"\s+\w+: *\S", line) or re.match(r"\s+joints", line)
    )
    indent = key[: len(key) - len(key.lstrip())]
    files = changed(tmp_path, name, controllers={key: f"{indent}joimts: 1\n{key}"})
    (reported,) = found(files)
    assert re.match(r"ros2_controllers\.yaml:\d+:\d+: warning: .*unknown key 'joimts'", reported)

    twice = changed(tmp_path / "2", name, controllers={key: f"{key.split(':')[0]}: 1\n{key}"})
    (reported,) = found(twice)
    assert re.match(r"ros2_controllers\.yaml:\d+:\d+: warning: .*duplicate key '\w+' \(first at line \d+\)", reported)


def test_a_name_for_all_nodes_that_no_controller_has_is_reported_with_where_one_has_nearly(tmp_path):
    block = "/**:\n  ros__parameters: {comand_timeout: 1.0, other_nodes: 1}\n"
    (reported,) = found(
        changed(tmp_path, "robby", controllers={"controller_manager:\n": block + "controller_manager:\n"})
    )
    assert "'comand_timeout'; did you mean 'command_timeout'?" in reported


@pytest.mark.rest
@given(st.data())
@settings(max_examples=examples(40), suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_the_rules_never_raise_whatever_is_missing_in_the_files(tmp_path, data):
    name = data.draw(st.sampled_from(ROBOTS))
    source = find_robot(name)
    bus = read_bus(source.bus)
    damaged = {}
    for which, suffix in (("controllers", "yaml"), ("description", "urdf.xacro")):
        lines = getattr(source, which).read_text().splitlines()
        gone = data.draw(st.sets(st.integers(0, len(lines) - 1), max_size=4))
        path = tmp_path / f"{which}.{suffix}"
        path.write_text("\n".join(line for number, line in enumerate(lines) if number not in gone))
        damaged[which] = path
    control = readable(read_controllers, damaged["controllers"])
    description = readable(read_description, damaged["description"])
    for item in find(source, bus, control, description, controllers=["nobody"]):
        assert item.path
        assert item.text


def readable(read, path):
    try:
        return read(path)
    except ConfigError:
        return None


def errors(files, **how):
    return [item for item in found(files, **how) if ": error: " in item]


def test_a_plugin_that_is_unknown_is_not_an_error_where_an_option_overrules_it(tmp_path):
    files = changed(tmp_path, "robby", description={"canopen_ros2_control/": "other_ros2_control/"})
    assert "no hardware plugin 'other_ros2_control/RobotSystem'" in errors(files)[0]
    assert errors(files, mock=True) == errors(files, real=True) == []


def test_an_unknown_type_is_an_error_only_if_its_controller_is_started(tmp_path):
    files = changed(tmp_path, "robby", controllers={"diff_drive_controller/": "other_controller/"})
    (reported,) = found(files)
    assert "warning: controller robby_base_controller: unknown type 'other_controller/DiffDriveController'" in reported
    assert reported.endswith("; it is not activated at the start, and cannot be activated later")
    assert found(files, controllers=["robby_forward_controller"]) == []  # it is a note
    for started in (
        errors(files, controllers=["robby_base_controller"]),
        errors(dataclasses.replace(files, spawned=("robby_base_controller",))),
    ):
        assert "controller robby_base_controller: unknown type 'other_controller/DiffDriveController'" in started[0]


def test_an_error_of_a_controller_that_waits_is_a_warning_where_another_one_is_chosen(tmp_path):
    files = changed(tmp_path, "robby", controllers={"[left_wheel_joint]": "[left_whel_joint]"})
    assert "joint 'left_whel_joint' is not in" in errors(files)[0]
    for how in ({"controllers": ["robby_forward_controller"]}, {"mock": True}):
        assert errors(files, **how) == []
        assert any("warning: robby_base_controller: joint 'left_whel_joint'" in item for item in found(files, **how))
    assert errors(files, controllers=["robby_base_controller"]) != []


def test_a_joint_may_have_its_interfaces_in_two_tags(tmp_path):
    sensor = (
        '<ros2_control name="encoders" type="system">'
        "<hardware><plugin>mock_components/GenericSystem</plugin></hardware>"
        '<joint name="left_wheel_joint"><state_interface name="effort"/></joint></ros2_control>\n</robot>'
    )
    assert found(changed(tmp_path, "diffbot_sim", description={"</robot>": sensor})) == []


def test_a_gpio_that_names_no_device_is_reported(tmp_path):
    anchor = '    <xacro:drive side="right"/>'
    part = f'{anchor}\n    <gpio name="lamps"><state_interface name="di0"/></gpio>'
    files = changed(tmp_path, "robby", description={anchor: part})
    (text,) = found(files)
    assert "warning: lamps of robby names no device of" in text
    assert text.endswith('and has no interfaces; add <param name="device_name">NODE</param>')


def test_a_controller_of_a_mimic_joint_is_answered_with_what_works(tmp_path):
    """ros2_control takes mimic="false" for a joint that mimics in simulation only, and has its own drive."""
    path = folder(tmp_path, "csv")
    urdf = path / "two_axes.urdf"
    text = urdf.read_text().replace('<joint name="tilt" type="revolute">',
                                    '<joint name="tilt" type="revolute"><mimic joint="pan"/>')  # fmt: skip
    urdf.write_text(re.sub(r'(?s)(<param name="device_name">tilt_drive</param>)<command_interface[^>]*>', r"\1", text))
    (reported,) = [item for item in found(find_robot(str(path))) if "mimics" in item]
    assert re.search(
        r"vel: joint 'tilt' mimics pan, so it has no command interface; remove it here, or write mimic=\"false\" "
        r"and its command interface at .*two_axes\.urdf:\d+ if it has its own drive",
        reported,
    )
    own = text.replace('<joint name="tilt"><param', '<joint name="tilt" mimic="false"><param')
    urdf.write_text(own)
    assert not [item for item in found(find_robot(str(path))) if "error" in item]


def test_limits_of_zero_are_reported_with_the_axis_that_they_stop(tmp_path):
    edits = {"linear.x.max_velocity: 1.0 ": "linear.x.max_velocity: 0.0 ", "linear.x.min_velocity: -1.0": ""}
    config = copy_robby(tmp_path, controllers=edits)
    files = find_robot(str(config))
    line = line_of(files, "controllers", "linear.x.max_velocity: 0.0")
    assert found(files) == [
        f"ros2_controllers.yaml:{line}: warning: robby_base_controller: linear.x.max_velocity is 0, so the base does "
        "not move along linear.x; give a value above 0, or remove it"
    ]


@pytest.mark.parametrize(("effort", "count"), [("0", 1), ("-2.5", 0), ("2.5", 0)])
def test_an_effort_limit_of_zero_is_reported_for_a_commanded_effort(effort, count, tmp_path):
    description = {
        '<command_interface name="velocity"/>': '<command_interface name="effort"/>',
        '<axis xyz="0 1 0"/>': f'<axis xyz="0 1 0"/><limit effort="{effort}" velocity="0"/>',
    }
    files = changed(
        tmp_path, "robby", controllers={"interface_name: velocity": "interface_name: effort"}, description=description
    )
    reported = [text for text in found(files) if "<limit>" in text and "left_wheel_joint" in text]
    line = line_of(files, "controllers", "- left_wheel_joint")
    assert reported == count * [
        f'ros2_controllers.yaml:{line}: warning: robby_forward_controller: effort="0" in the <limit> of '
        "left_wheel_joint reduces every commanded effort to 0; give the maximum effort in Nm (N of a prismatic joint) "
        "there, in robby.urdf.xacro"
    ]


def test_a_system_plugin_under_another_type_is_a_warning_with_its_line(tmp_path):
    files = changed(tmp_path, "robby", description={'name="robby" type="system"': 'name="robby" type="actuator"'})
    line = line_of(files, "description", 'type="actuator"')
    assert found(files) == [
        f"robby.urdf.xacro:{line}: warning: <ros2_control name='robby'>: canopen_ros2_control/RobotSystem is a system, "
        'so ROS 2 does not load it as actuator; give it type="system"'
    ]


def test_a_scale_that_is_no_number_is_one_error(tmp_path):
    files = changed(tmp_path, "robby", bus={"scale_pos_to_dev: 254.6": "scale_pos_to_dev: .nan #"})
    errors = [item for item in check_robot(files, CheckOptions()).findings if item.severity is Severity.ERROR]
    assert [item.text.partition(" cannot")[0] for item in errors] == ["nodes.right_drive.scale_pos_to_dev: nan"]
