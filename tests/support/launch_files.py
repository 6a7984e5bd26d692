"""A ROS package with a launch file in Python, as the tutorials of ros2_control build them, around a bundled robot."""

from __future__ import annotations

import shutil

from canopen_control.data_files import data_path

LAUNCH = """\
import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import Command, FindExecutable, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import ComposableNodeContainer, Node
from launch_ros.descriptions import ComposableNode
from launch_ros.substitutions import FindPackageShare

PACKAGE = "robby_bringup"


def generate_launch_description():
    share = get_package_share_directory(PACKAGE)
    mock = LaunchConfiguration("mock")
    description = Command([
        PathJoinSubstitution([FindExecutable(name="xacro")]),
        " ",
        PathJoinSubstitution([FindPackageShare(PACKAGE), "urdf", "base", "robby.urdf.xacro"]),
        " ",
        "use_mock_hardware:=", mock,
    ])
    robot_description = {"robot_description": description}
    controllers = os.path.join(share, "config", "first", f"{'ros2_controllers'}.yaml")
    manager = Node(
        package="controller_manager",
        executable="ros2_control_node",
        parameters=[robot_description, controllers],
    )
    common = ["--controller-manager", "/controller_manager"]
    spawner = Node(
        package="controller_manager",
        executable="spawner",
        arguments=["joint_state_broadcaster"] + common,
    )
    wheels = Node(
        package="controller_manager", executable="spawner", arguments=["robby_forward_controller", *[]]
    )
    camera = ComposableNodeContainer(
        name="eyes", namespace="", package="rclcpp_components", executable="component_container",
        composable_node_descriptions=[ComposableNode(package="usb_cam", plugin="usb_cam::UsbCamNode", name="cam")],
    )
    return LaunchDescription([
        DeclareLaunchArgument("mock", default_value="false", description="no drives"),
        DeclareLaunchArgument("channel"),
        manager, spawner, wheels, camera,
    ])
"""


def make_package(folder, text=LAUNCH):
    """Make robby_bringup in `folder`: a launch file, robby's files where it says; returns the launch file."""
    package = folder / "robby_bringup"
    for name in ("launch", "config/first", "urdf/base"):
        (package / name).mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>robby_bringup</name></package>", encoding="utf-8")
    for name, place in {
        "bus.yml": "config/first",
        "ros2_controllers.yaml": "config/first",
        "robby.urdf.xacro": "urdf/base",
    }.items():
        shutil.copy(data_path("config", "robby") / name, package / place / name)
    path = package / "launch" / "robby.launch.py"
    path.write_text(text, encoding="utf-8")
    return path
