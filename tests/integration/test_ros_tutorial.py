"""The three scenarios of ros2_canopen's robby tutorial: processes of its launch files, and its commands."""

from __future__ import annotations

import math

import pytest
from support import ros
from support.launch_stub import launched
from support.robots import PATIENT_ROBBY, copy_robby

pytestmark = pytest.mark.ros
TWIST, ODOMETRY, JOINTS = "geometry_msgs/msg/Twist", "nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState"
PER_RADIAN = 1600 / (2 * math.pi)  # microsteps


@pytest.fixture
def launch(stage):
    """Return what starts the processes of a launch file; yields its ROS programs a domain.

    The `robby` beside them is the bundled one, but bears a busy machine.
    """
    copy_robby(stage.place, bus=PATIENT_ROBBY, controllers={"cmd_vel_timeout: 0.5": "cmd_vel_timeout: 3.0"})
    with ros.domain() as number:
        environment = ros.ros_environment(number)
        environment["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"

        def launch(name, **arguments):
            ((_, *command),), _ = launched(name, **arguments)
            program = stage.start(*command, **environment)
            program.until("robby runs")
            return program

        launch.domain = number
        yield launch


def keys(linear, angular):
    """Return what teleop_twist_keyboard publishes for a key: at 10 Hz while it is held."""
    return {"linear": {"x": linear}, "angular": {"z": angular}}


def test_control_simulation_drives_by_the_keys_of_teleop_on_cmd_vel(launch):
    launch("control_simulation")
    with ros.Peer(launch.domain) as rviz, ros.Peer(launch.domain) as teleop:
        rviz.order("subscribe", topic="/robby_base_controller/odom", of=ODOMETRY)
        teleop.order("publish", topic="/cmd_vel", of=TWIST, data=keys(0.5, 0.0), rate=10)
        rviz.message("/robby_base_controller/odom", lambda message: message["pose"]["pose"]["position"]["x"] > 0.1)
        teleop.order("publish", topic="/cmd_vel", of=TWIST, data=keys(0.0, 1.0), rate=10)
        rviz.message("/robby_base_controller/odom", lambda message: message["pose"]["pose"]["orientation"]["z"] > 0.1)
        teleop.kill()  # the timeout of the controller stops it
        last = rviz.message(
            "/robby_base_controller/odom", lambda message: message["twist"]["twist"]["angular"]["z"] == 0.0
        )
        assert last["pose"]["pose"]["position"]["x"] > 0.1


def test_forward_controller_turns_the_wheels_of_virtual_drives(launch, probe):
    launch("forward_controller")
    left, right = probe("robby", 3), probe("robby", 2)
    with ros.Peer(launch.domain) as other:
        other.order("subscribe", topic="/joint_states", of=JOINTS)
        # ros2 topic pub /robby_forward_controller/commands std_msgs/msg/Float64MultiArray "data: [10.0, 10.0]"
        commands, kind = "/robby_forward_controller/commands", "std_msgs/msg/Float64MultiArray"
        other.order("publish", topic=commands, of=kind, data={"data": [10.0, 10.0]}, rate=1)
        expected = round(10.0 * PER_RADIAN)
        assert ros.eventually(lambda: (round(left.speed), round(right.speed)) == (-expected, expected))
        other.message("/joint_states", lambda message: all(abs(value - 10.0) < 0.01 for value in message["velocity"]))
        other.order("silence", topic=commands)
        assert ros.eventually(lambda: left.speed == right.speed == 0.0)


def test_diff_drive_drives_by_the_remapped_keys_of_teleop(launch, probe):
    launch("diff_drive")
    left, right = probe("robby", 3), probe("robby", 2)
    with ros.Peer(launch.domain, "--interfaces") as rviz, ros.Peer(launch.domain) as teleop:
        rviz.order("subscribe", topic="/robby_base_controller/odom", of=ODOMETRY)
        rviz.order("subscribe", topic="/tf", of="tf2_msgs/msg/TFMessage")
        # teleop_twist_keyboard --ros-args -r /cmd_vel:=/robby_base_controller/cmd_vel_unstamped
        topic = "/robby_base_controller/cmd_vel_unstamped"
        teleop.order("publish", topic=topic, of=TWIST, data=keys(0.35, 0.0), rate=10)
        expected = round(10.0 * PER_RADIAN)
        assert ros.eventually(lambda: abs(left.speed + expected) < 2 and abs(right.speed - expected) < 2)
        rviz.message("/robby_base_controller/odom", lambda message: message["pose"]["pose"]["position"]["x"] > 0.05)
        rviz.message(
            "/tf", lambda message: "base_footprint" in [item["child_frame_id"] for item in message["transforms"]]
        )
        teleop.kill()
        assert ros.eventually(lambda: left.speed == right.speed == 0.0)
