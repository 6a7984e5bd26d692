"""Stamps that follow somebody's /clock: the clocks are the test's own."""

from __future__ import annotations

import time

import pytest
from support import ros
from support.ros import Peer, bridge

from canopen_control.errors import RemoteError
from canopen_control.ros.session import RosTime, wants_sim_time
from canopen_control.rpc.messages.parameters import ParameterReading
from canopen_control.rpc.messages.samples import ImuSample, JointStatesSample, OdometrySample
from canopen_control.rpc.messages.state import RobotEvent, StateSample

UNIX = 1_700_000_000.0


class Clocks:
    def __init__(self, ros_s=None, unix=UNIX):
        self.ros, self.unix = ros_s, unix
        self.time = RosTime(lambda: self.ros, lambda: self.unix)


def sample(unix, *, base=None, sim_time=None, sim_epoch=None):
    states = JointStatesSample(time=unix, names=("a",), joints={"a": {"position": 1.0}})
    odometry = OdometrySample(time=base or unix, x=1.0, y=2.0, heading=0.5)
    return StateSample(time=unix, sim_time=sim_time, sim_epoch=sim_epoch, samples={"states": states, "base": odometry})


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


@pytest.mark.parametrize("ros_s", [None, 42.0], ids=["of its file", "of the bridge"])
def test_with_use_sim_time_the_stamps_of_a_simulated_robot_are_the_simulations(ros_s):
    clocks = Clocks(ros_s=ros_s)
    clocks.time.in_simulation = ros_s is None
    told = clocks.time.state(sample(UNIX + 3.0, base=UNIX + 2.98, sim_time=3.0, sim_epoch=UNIX))
    assert (told.time, times(told)) == (3.0, {"states": 3.0, "base": 2.98})
    assert clocks.time.event(RobotEvent(time=UNIX + 3.5, kind="x", node=None, level="info", text="it is")).time == 3.0
    paused = clocks.time.state(sample(UNIX + 3.0, base=UNIX + 2.98, sim_time=3.0, sim_epoch=UNIX))
    assert times(paused) == times(told)


def test_the_stamp_of_a_command_is_of_the_clock_that_it_is_nearer_to():
    clocks = Clocks(unix=UNIX + 3.5)
    clocks.time.in_simulation = True
    clocks.time.state(sample(UNIX + 3.0, sim_time=3.0, sim_epoch=UNIX))
    assert clocks.time.unix(2.75) == UNIX + 2.75
    assert clocks.time.unix(UNIX + 3.25) == UNIX + 3.25
    assert clocks.time.unix(None) is None


class Answers:
    """A client whose robot's controller manager has parameters, or none that it tells."""

    def __init__(self, *found):
        self.found = found

    def ask(self, _request):
        if not self.found:
            raise RemoteError("UnknownName", "no method parameters")
        return [ParameterReading(name="use_sim_time", kind="bool", value=value) for value in self.found]


@pytest.mark.parametrize(("client", "wanted"), [(Answers(True), True), (Answers(False), False), (Answers(), False)])
def test_the_controller_manager_of_the_file_says_whether_stamps_are_simulated(client, wanted):
    assert wants_sim_time(client) is wanted


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
