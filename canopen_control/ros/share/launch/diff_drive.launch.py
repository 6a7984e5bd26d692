"""Launch file of robby on virtual or real drives with the diff drive controller.

`ros2 launch canopen_control diff_drive.launch.py`, with `use_real_hardware:=true can_interface_name:=can0` for
real drives; without it, virtual drives are started on the built-in software bus, or on the named interface (vcan0). One
process is the CANopen master, controller manager, robot_state_publisher and the ROS bridge in one; `canopen-control`
must be on the PATH.
"""

from __future__ import annotations

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

CONTROLLER = "robby_base_controller"


def generate_launch_description() -> LaunchDescription:
    """Return the description for ros2 launch."""
    words = [[name, ":=", LaunchConfiguration(name)] for name in ("use_real_hardware", "can_interface_name")]
    command = ["canopen-control", "run", "robby", *words, "--ros", "--controller", CONTROLLER]
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "use_real_hardware", default_value="false", description="Use real drives, not virtual ones."
            ),
            DeclareLaunchArgument(
                "can_interface_name",
                default_value="",
                description="Bus of the drives: can0, vcan0 or local:NAME; optional for virtual drives.",
            ),
            DeclareLaunchArgument("gui", default_value=_has("rviz2"), description="Start rviz2."),
            ExecuteProcess(cmd=command, name="robby", output="both"),
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
