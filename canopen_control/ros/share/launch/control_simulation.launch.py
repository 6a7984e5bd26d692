"""Launch file of robby on mock hardware, with the diff drive controller and rviz.

`ros2 launch canopen_control control_simulation.launch.py`. No drive and no bus: commands are mirrored to states, as by
mock_components/GenericSystem. One process is the controller manager, robot_state_publisher and the ROS bridge in one;
`canopen-control` must be on the PATH.
"""

from __future__ import annotations

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Return the description for ros2 launch."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("gui", default_value=_has("rviz2"), description="Start rviz2."),
            ExecuteProcess(
                cmd=["canopen-control", "run", "robby", "--ros", "--mock", "--controller", "robby_base_controller"],
                name="robby",
                output="both",
            ),
            Node(
                package="rviz2",
                executable="rviz2",
                name="rviz2",
                output="log",
                condition=IfCondition(LaunchConfiguration("gui")),
            ),
        ]
    )


def _has(package: str) -> str:
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return "false"
    return "true"
