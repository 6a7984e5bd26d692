"""Launch files as the tutorials have them, with one mistake each."""

import re

import pytest
from support.configs import changed, found
from support.launch_files import LAUNCH, make_package

from canopen_control.runtime.robot_files import find_robot

GOOD = """\
<launch>
  <arg name="model" default="mobile_base"/>
  <param name="robot_description" command="$(find xacro)/xacro $(find base)/urdf/$(arg model).urdf.xacro"/>
  <rosparam file="$(find base)/config/ros2_controllers.yaml" command="load"/>
  <node name="spawn_urdf" pkg="gazebo_ros" type="spawn_model" args="-param robot_description -urdf -model base"/>
  <node name="controller_spawner" pkg="controller_manager" type="spawner" output="screen"
        args="joint_state_controller mobile_base_controller --shutdown-timeout 3"/>
  <node name="$(anon teleop)" pkg="teleop" type="keyboard"/>
  <include file="$(find gazebo_ros)/launch/empty_world.launch"/>
</launch>
"""


def collected(tmp_path, text, files=None, name="base.launch"):
    path = tmp_path / name
    path.write_text(text)
    return [item.replace(f"{tmp_path}/", "") for item in found(files or find_robot("mobile_base_ros1"), launch=path)]


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        (
            "mobile_base_controller --",
            "mobile_base_controler --",
            6,
            "error: the spawner loads 'mobile_base_controler', which is not in ros2_controllers.yaml "
            "(did you mean 'mobile_base_controller'?); use a name of the file, or add the controller to it",
        ),
        (
            'name="controller_spawner"',
            'name="controller spawner"',
            6,
            "error: node name 'controller spawner' is not valid: letters, digits and _ only; "
            "call it 'controller_spawner'",
        ),
        (
            'param name="robot_description"',
            'param name="my_description"',
            3,
            "error: the description is called 'my_description'; the controllers, Gazebo and rviz use "
            "'robot_description'; call it 'robot_description'",
        ),
        (
            "-param robot_description",
            "-param my_description",
            5,
            "error: the description is called 'my_description'; the controllers, Gazebo and rviz use "
            "'robot_description'; call it 'robot_description'",
        ),
    ],
)
def test_an_error_is_reported_with_its_line_and_the_remedy(tmp_path, old, new, line, message):
    assert old in GOOD
    (text,) = collected(tmp_path, GOOD.replace(old, new))
    assert text == f"base.launch:{line}: {message}"


def test_a_joint_without_a_transmission(tmp_path):
    files = changed(tmp_path, "mobile_base_ros1")
    text = re.sub(r"<transmission.*?</transmission>", "", files.description.read_text(), flags=re.DOTALL)
    files.description.write_text(text)
    texts = collected(tmp_path, GOOD, files)
    assert texts[0] == (
        "mobile_base.urdf.xacro:29: error: joint 'wheel_left_joint' has no <transmission>, so mobile_base_controller "
        "finds no interface of the joint; add a <transmission> with a SimpleTransmission, the joint and the actuator"
    )
    assert "no <ros2_control> tag and no <transmission>" in texts[-1]


def test_a_namespace_that_only_one_side_has(tmp_path):
    texts = collected(tmp_path, GOOD.replace('type="spawner"', 'type="spawner" ns="/robot"'))
    assert len(texts) == 2
    assert "mobile_base_controller is in the namespace '/', but its controller_manager in '/robot'" in texts[1]
    option = GOOD.replace("--shutdown-timeout 3", "--namespace=/robot")
    assert collected(tmp_path, option) == texts
    files = changed(
        tmp_path, "mobile_base_ros1", controllers={"\nmobile_base_controller:": "\n/robot/mobile_base_controller:"}
    )
    grouped = GOOD.replace("joint_state_controller ", "")
    grouped = grouped.replace("<launch>", '<launch><group ns="robot">').replace("</launch>", "</group></launch>")
    assert collected(tmp_path, grouped, files) == []


def test_ros_2s_xml_is_read_too(tmp_path):
    text = """<launch>
      <node pkg="controller_manager" exec="spawner" args="robby_base_controler -c /controller_manager"/>
    </launch>"""
    (told_text,) = collected(tmp_path, text, find_robot("robby"))
    assert "base.launch:2: error: the spawner loads 'robby_base_controler'" in told_text
    space = (
        '<launch><push-ros-namespace namespace="r"/><node pkg="controller_manager" exec="spawner" args="%s"/></launch>'
    )
    (told_text,) = collected(tmp_path, space % "robby_base_controller", find_robot("robby"))
    assert "its controller_manager in '/r'" in told_text


def test_yaml_is_read_too(tmp_path):
    spawner = "node: {pkg: controller_manager, exec: spawner, args: %s -c /controller_manager}"
    text = f"launch:\n  - {spawner % 'robby_base_controler'}\n"
    (told_text,) = collected(tmp_path, text, find_robot("robby"), name="base.launch.yaml")
    assert "base.launch.yaml:2: error: the spawner loads 'robby_base_controler'" in told_text
    node = "node: {pkg: controller_manager, exec: spawner, args: robby_base_controller}"
    text = f"launch:\n  - group:\n      - push_ros_namespace: {{namespace: r}}\n      - {node}\n"
    (told_text,) = collected(tmp_path, text, find_robot("robby"), name="base.launch.yaml")
    assert "its controller_manager in '/r'" in told_text
    (told_text,) = collected(tmp_path, "launch: [", find_robot("robby"), name="base.launch.yaml")
    assert "base.launch.yaml:1" in told_text


def test_what_is_not_a_xml_or_python_is_reported(tmp_path):
    (text,) = collected(tmp_path, "<launch>")
    assert re.match(r"base\.launch:1: error: .*no element found", text)
    (text,) = collected(tmp_path, "import launch", name="base.launch.py")
    assert text == (
        "base.launch.py:1: warning: the function generate_launch_description, which ros2 launch calls, is missing"
    )
    (text,) = collected(tmp_path, "import launch\nx = (", name="base.launch.py")
    assert text == "base.launch.py:2: error: not valid Python: '(' was never closed"
    (text,) = found(find_robot("robby"), launch=tmp_path / "none.launch")
    assert "cannot be read" in text


# --- Python ---


def of_python(folder, old="", new=""):
    """Return the findings of a launch file in Python with something changed, notes included, without its path."""
    assert old in LAUNCH
    path = make_package(folder, LAUNCH.replace(old, new, 1))
    package = path.parents[1]
    described = str(package / "urdf" / "base" / "robby.urdf.xacro")
    files = find_robot(str(package / "config" / "first"), launch=str(path), description=described)
    here = f"{path}:"
    return [item.removeprefix(here) for item in found(files, launch=path, notes=True) if item.startswith(here)]


def test_what_a_file_in_python_declares_and_starts_is_reported_in_notes(tmp_path):
    texts = [re.sub(r"^\d+: note: ", "", item) for item in of_python(tmp_path)]
    assert texts == [
        "argument mock: default 'false'",
        "argument channel: no constant default",
        "starts controller_manager/ros2_control_node",
        "starts controller_manager/spawner of joint_state_broadcaster",
        "starts controller_manager/spawner of robby_forward_controller",
        "starts rclcpp_components/component_container",
        "starts usb_cam/usb_cam::UsbCamNode",
        "an argument of a node is computed, and unknown without running the file; give the value with NAME:=VALUE",
    ]


@pytest.mark.parametrize(
    "more",
    [
        '"--param-file", PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "first", "ros2_controllers.yaml"])',
        '"--controller-ros-args", "-r /controller/topic:=/cmd vel"',
    ],
)
def test_the_value_of_an_option_of_a_spawner_is_not_a_controller(tmp_path, more):
    for number, end in enumerate((", *[]", "")):  # with one, the list as a whole is not known
        old, new = '"robby_forward_controller", *[]', f'"robby_forward_controller", {more}{end}'
        texts = of_python(tmp_path / str(number), old, new)
        assert any(text.endswith("starts controller_manager/spawner of robby_forward_controller") for text in texts)
        assert not any("error" in text or "warning" in text for text in texts)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            '"robby_forward_controller"',
            '"robby_forwrd_controller"',
            "error: the spawner loads 'robby_forwrd_controller', which ",
        ),
        ('"first", f"', '"second", f"', "warning: file "),
        ("FindPackageShare(PACKAGE)", 'FindPackageShare("elsewhere")', "note: package 'elsewhere' was not found near"),
        ('name="eyes"', 'name="two eyes"', "error: node name 'two eyes' is not valid"),
        ('PACKAGE = "robby_bringup"', "PACKAGE = name()", "note: a command is computed, and unknown without running"),
    ],
)
def test_an_error_of_a_file_in_python_has_its_line(tmp_path, old, new, message):
    (text,) = [item for item in of_python(tmp_path, old, new) if message in item]
    assert re.match(r"\d+: ", text)
