"""Stamps of a bridge that follow the /clock of another program."""

import time

import pytest
from support import ros
from support.ros import Peer, bridge


@pytest.mark.ros
def test_the_bridges_stamps_follow_the_clock_of_another_program(ros_folder):
    with pytest.MonkeyPatch.context() as patch, ros.domain() as number:
        for name, value in ros_folder.items():
            patch.setenv(name, value)
        with (
            ros.FakeRobot() as robot,
            bridge(number, "--ros-args", "-p", "use_sim_time:=true", **ros_folder),
            Peer(number) as peer,
        ):
            peer.order("subscribe", topic="/joint_states", of="sensor_msgs/msg/JointState")
            clock = {"clock": {"sec": 42, "nanosec": 500_000_000}}
            peer.order("publish", topic="/clock", of="rosgraph_msgs/msg/Clock", data=clock, rate=50)
            peer.message("/joint_states", lambda message: ros.stamp_of(message) == 42.5)
            robot.switch(base="active")
            data = {"header": {"stamp": {"sec": 42, "nanosec": 400_000_000}}, "twist": {"linear": {"x": 0.5}}}
            peer.order("publish", topic="/base/cmd_vel", of="geometry_msgs/msg/TwistStamped", data=data, rate=20)
            assert ros.eventually(lambda: robot.commands("twist"))
            assert robot.commands("twist")[-1]["stamp"] == pytest.approx(time.time() - 0.1, abs=5.0)
