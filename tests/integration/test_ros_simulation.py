"""A program of ROS joins a robot in virtual time: by its topics, in the time of its `/clock`."""

from __future__ import annotations

import json
import signal
import subprocess
import sys

import pytest
from support import ros
from support.simulated import setup_of

from canopen_control.testing.tested_robot import TestedRobot

pytestmark = pytest.mark.ros

JOINS = """
import json, time
import rclpy
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

rclpy.init()
node = rclpy.create_node("joins", parameter_overrides=[Parameter("use_sim_time", value=True)])
seen = []

def hear(message):
    stamp = message.header.stamp.sec + message.header.stamp.nanosec / 1e9
    seen.append((stamp, node.get_clock().now().nanoseconds / 1e9, message.velocity[0]))

node.create_subscription(JointState, "/joint_states", hear, 10)
wheels = node.create_publisher(Float64MultiArray, "/robby_forward_controller/commands", 10)
end = time.monotonic() + 30
while time.monotonic() < end and not (seen and seen[-1][2] > 4.9):
    wheels.publish(Float64MultiArray(data=[5.0, 5.0]))
    rclpy.spin_once(node, timeout_sec=0.05)
print(json.dumps(seen[-1] if seen else None))
"""


def test_a_node_with_use_sim_time_drives_it_and_lives_in_its_time():
    with ros.domain() as number:
        words = ["simulate", "robby", "--ros", "--for", "2min", "--json"]
        simulation = subprocess.Popen(
            [sys.executable, "-m", "canopen_control", *words],
            env=ros.ros_environment(number),
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            stamp, clock, velocity = json.loads(ros.run_ros(JOINS, number))
        finally:
            simulation.send_signal(signal.SIGINT)
            message, _ = simulation.communicate(timeout=60)
    assert velocity > 4.9
    assert 1.0 < stamp < 60.0
    assert clock == pytest.approx(stamp, abs=1.0)
    assert json.loads(message)["breaches"] == []


def test_a_robot_of_a_test_is_served_to_a_node_whose_left_drive_dies(monkeypatch):
    with ros.domain() as number:
        for name, value in ros.ros_environment(number).items():
            monkeypatch.setenv(name, value)
        robot = TestedRobot(setup_of(), 1)
        try:
            robot.serve(ros=[])
            node = subprocess.Popen(
                [sys.executable, "-c", JOINS], env=ros.ros_environment(number), stdout=subprocess.PIPE
            )
            try:
                robot.until(lambda: robot.velocity("left_wheel_joint") > 4.9, timeout=60.0)
                robot.drives["left_drive"].power_off()
                assert robot.stopped_within(1.0)
                assert "left_drive" in " ".join(event.node for event in robot.events[-20:])
            finally:
                node.kill()
                node.communicate(timeout=60)
        finally:
            robot.close()
