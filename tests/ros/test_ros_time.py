"""Stamps that follow somebody's /clock: the clocks are the test's own."""

from __future__ import annotations

import time

import pytest
from support import ros
from support.ros import Peer, bridge

from canopen_control.ros.ros_time import RosTime
from canopen_control.rpc.messages.samples import ImuSample, JointStatesSample, OdometrySample
from canopen_control.rpc.messages.state import RobotEvent, StateSample

UNIX = 1_700_000_000.0


class Clocks:
    def __init__(self, ros_s=None, unix=UNIX):
        self.ros, self.unix = ros_s, unix
        self.time = RosTime(lambda: self.ros, lambda: self.unix)


def sample(unix, *, base=None, sim_time=None):
    states = JointStatesSample(time=unix, names=("a",), joints={"a": {"position": 1.0}})
    odometry = OdometrySample(time=base or unix, x=1.0, y=2.0, heading=0.5)
    return StateSample(time=unix, sim_time=sim_time, samples={"states": states, "base": odometry})


def times(message):
    return {name: each.time for name, each in message.samples.items()}


def test_without_use_sim_time_everything_is_as_the_robot_says():
    clocks, told = Clocks(), sample(UNIX)
    assert clocks.time.state(told) is told
    assert clocks.time.unix(12.5) == 12.5
    assert clocks.time.unix(None) is None


def test_what_comes_has_the_time_of_the_clock_and_keeps_it():
    clocks = Clocks(ros_s=42.0)
    first = clocks.time.state(sample(UNIX))
    assert (first.time, times(first)) == (42.0, {"states": 42.0, "base": 42.0})
    assert first.samples["base"].x == 1.0
    clocks.ros = 42.5
    second = clocks.time.state(sample(UNIX + 1.0, base=UNIX))  # the base has published nothing new
    assert (second.time, times(second)) == (42.5, {"states": 42.5, "base": 42.0})


def test_while_the_clock_stands_there_is_nothing_new_and_before_it_begins_the_time_is_0():
    clocks = Clocks(ros_s=0.0)
    assert times(clocks.time.state(sample(UNIX))) == {"states": 0.0, "base": 0.0}
    clocks.ros = 7.0
    assert times(clocks.time.state(sample(UNIX + 1.0))) == {"states": 7.0, "base": 7.0}
    assert times(clocks.time.state(sample(UNIX + 2.0))) == {"states": 7.0, "base": 7.0}


def test_the_stamp_of_a_command_counts_by_its_age():
    clocks = Clocks(ros_s=100.0)
    assert clocks.time.unix(99.75) == UNIX - 0.25
    assert clocks.time.unix(101.0) == UNIX + 1.0
    assert clocks.time.unix(None) is None


def test_events_have_the_time_of_the_clock():
    event = RobotEvent(time=UNIX, kind="x", node=None, level="info", text="it is so")
    assert Clocks(ros_s=5.0).time.event(event).time == 5.0
    assert Clocks().time.event(event) is event


def test_a_robot_that_is_simulated_has_its_own_time():
    clocks, told = Clocks(ros_s=42.0), sample(UNIX, sim_time=3.0)
    assert clocks.time.state(told) is told
    assert clocks.time.unix(12.5) == 12.5


def test_a_controller_that_comes_anew_is_stamped_anew():
    clocks = Clocks(ros_s=1.0)
    imu = ImuSample(time=UNIX, frame_id="i", orientation=(), angular_velocity=(), linear_acceleration=())
    clocks.time.state(StateSample(time=UNIX, samples={"imu": imu}))
    clocks.time.state(StateSample(time=UNIX))
    clocks.ros = 2.0
    assert times(clocks.time.state(StateSample(time=UNIX, samples={"imu": imu}))) == {"imu": 2.0}


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
