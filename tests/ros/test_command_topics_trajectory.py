"""The topics with stand-ins for ROS and the robot; tests/integration uses them over DDS."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("trajectory_msgs")

from support.endpoints import Ros, interface, publisher_of
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from canopen_control.errors import RemoteError
from canopen_control.ros import command_topics, sample_publisher
from canopen_control.ros.command_topics import SpeedScalingTopic, TrajectoryQuery, TrajectoryTopic
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.samples import TrajectoryPoint, TrajectorySample
from canopen_control.rpc.messages.state import ControllerReading, StateSample
from canopen_control.rpc.messages.trajectory import (
    QueryTrajectory,
    ScaleTrajectory,
    SetTrajectory,
    TrajectoryAt,
    TrajectoryData,
)

pytestmark = pytest.mark.ros
ARM = ControllerReading(name="arm", type="x/Y", state="active", interface="position", tells="trajectory")


@pytest.fixture
def ros(monkeypatch):
    for module in (command_topics, sample_publisher):
        monkeypatch.setattr(module, "interface", interface, raising=False)
    return Ros()


def trajectory(*firsts, stamp=0):
    message = JointTrajectory(joint_names=["a", "b"])
    message.header.stamp.sec = stamp
    message.points = [JointTrajectoryPoint(positions=[first, 0.0]) for first in firsts]
    return message


class TestTrajectories:
    TOPIC = "arm/joint_trajectory"

    @pytest.fixture
    def topic(self, ros):
        return TrajectoryTopic(ros, ARM)

    def sent(self, ros):
        return [request for client in ros.clients for request, _ in client.asked]

    def answer(self, client, result=None, error=None):
        client.asked[-1][1](result, error)

    def test_it_goes_to_the_robot_with_its_stamp_and_ends_with_its_connection(self, ros, topic):
        ros.publish(self.TOPIC, trajectory(1.0, stamp=12))
        point = TrajectoryPoint(positions=[1.0, 0.0])
        assert self.sent(ros) == [
            SetTrajectory(controller="arm", joints=["a", "b"], points=[point], stamp=12.0, source="ros", heartbeat=3.0)
        ]
        topic.close()
        assert ros.clients[0].closed
        assert ros.left == [self.TOPIC]

    def test_its_end_is_compared_with_those_of_other_publishers(self, ros, topic):
        """Joints in another order, and the way to the end, make no other command; two publishers alternate here."""
        turned = JointTrajectory(joint_names=["b", "a"], points=[JointTrajectoryPoint(positions=[0.0, 2.0])])
        for message in (trajectory(1.0, 2.0), turned, trajectory()):
            ros.publish(self.TOPIC, message)
        assert ros.watched == [
            (self.TOPIC, self.TOPIC, [2.0, 0.0]),
            (self.TOPIC, self.TOPIC, [2.0, 0.0]),
            (self.TOPIC, self.TOPIC, []),
        ]

    def test_of_those_that_come_while_one_is_on_its_way_the_newest_counts(self, ros, topic):
        for first in (1.0, 2.0, 3.0):
            ros.publish(self.TOPIC, trajectory(first))
        assert len(self.sent(ros)) == 1
        self.answer(ros.clients[0], Done())
        assert [item.points[0].positions[0] for item in self.sent(ros)] == [1.0, 3.0]
        self.answer(ros.clients[0], Done())
        assert len(ros.clients) == 1
        assert len(self.sent(ros)) == 2

    def test_a_bad_one_is_reported_and_what_is_followed_continues(self, ros, topic):
        ros.publish(self.TOPIC, trajectory(1.0))
        self.answer(ros.clients[0], Done())
        ros.publish(self.TOPIC, trajectory(math.nan))
        ros.publish(self.TOPIC, trajectory(2.0))
        self.answer(ros.clients[0], None, "arm refuses the trajectory: it has no points")
        assert ros.collected == [
            f"{self.TOPIC}: point 0: the position of a is nan; give finite numbers",
            f"{self.TOPIC}: arm refuses the trajectory: it has no points",
        ]
        assert not ros.clients[0].closed

    def test_a_long_one_has_a_connection_of_its_own_that_takes_over_when_it_is_taken(self, ros, topic):
        ros.publish(self.TOPIC, trajectory(1.0))
        self.answer(ros.clients[0], Done())
        long = trajectory(*map(float, range(2000)))
        ros.publish(self.TOPIC, long)
        self.answer(ros.clients[1], None, "no more")
        assert [client.closed for client in ros.clients] == [False, True]
        ros.publish(self.TOPIC, long)
        while isinstance(ros.clients[2].asked[-1][0], TrajectoryData):
            self.answer(ros.clients[2], Done())
        assert not ros.clients[0].closed
        self.answer(ros.clients[2], Done())
        assert [client.closed for client in ros.clients] == [True, True, False]

    def test_a_robot_that_is_gone_is_reported(self, ros):
        def gone():
            raise RemoteError("BusClosed", "robot fake is gone")

        ros.connect = gone
        TrajectoryTopic(ros, ARM)
        ros.publish(self.TOPIC, trajectory(1.0))
        assert ros.collected == [f"{self.TOPIC}: robot fake is gone"]


class TestState:
    @pytest.fixture
    def sample(self):
        point = TrajectoryPoint(positions=[0.1, 0.2])
        return TrajectorySample(
            time=1_700_000_000.5, joints=("a", "b"), executing=False, holding=True, reference=point, feedback=point,
            error=point, output=point, speed_scaling_factor=0.5,
        )  # fmt: skip

    def test_it_is_published_once_per_sample_and_only_with_a_subscriber(self, ros, sample):
        state = publisher_of(ros, ARM, "controller_state")
        (publisher,) = ros.publishers
        assert publisher.topic == "arm/controller_state"
        publisher.subscribers = 0
        state.on_state(StateSample(samples={"arm": sample}))
        publisher.subscribers = 1
        state.on_state(StateSample(samples={"arm": sample}))
        assert publisher.collected == []
        for _ in range(2):
            later = type(sample)(**{name: getattr(sample, name) for name in sample.__struct_fields__} | {"time": 2.0})
            state.on_state(StateSample(samples={"arm": later}))
        (reported,) = publisher.collected
        assert (reported.header.stamp.sec, list(reported.reference.positions), reported.speed_scaling_factor) == (
            2,
            [0.1, 0.2],
            0.5,
        )
        state.close()
        assert ros.left == [publisher]


class TestQuery:
    def ask(self, ros, sec, result, error=None):
        kind, handler = ros.services["arm/query_state"]
        request, response, replies = kind.Request(), kind.Response(), []
        request.time.sec = sec
        handler(request, response, replies.append)
        requested, answer = ros.asked[-1]
        assert requested == QueryTrajectory(controller="arm", time=float(sec))
        answer(result, error)
        assert replies == [response]
        return response

    def test_what_the_trajectory_reports_is_the_response(self, ros):
        TrajectoryQuery(ros, ARM)
        point = TrajectoryPoint(positions=[0.1], velocities=[0.2], accelerations=[0.3])
        reported = self.ask(ros, 3, TrajectoryAt(known=True, joints=["a"], point=point))
        assert (reported.success, reported.message, list(reported.name)) == (True, "", ["a"])
        assert (list(reported.position), list(reported.velocity), list(reported.acceleration)) == ([0.1], [0.2], [0.3])

    def test_why_there_is_nothing_is_its_message(self, ros):
        query = TrajectoryQuery(ros, ARM)
        reported = self.ask(ros, 0, None, "arm follows no trajectories")
        assert (reported.success, reported.message) == (False, "arm follows no trajectories")
        reported = self.ask(ros, 0, TrajectoryAt(known=False, text="arm is inactive; activate it first"))
        assert (reported.success, reported.message, list(reported.name)) == (
            False,
            "arm is inactive; activate it first",
            [],
        )
        query.close()
        assert ros.left == ["arm/query_state"]


class TestSpeed:
    TOPIC = "arm/speed_scaling_input"

    def test_a_factor_goes_to_the_robot_and_what_is_none_is_reported(self, ros):
        scaling = SpeedScalingTopic(ros, ARM)
        created = interface("control_msgs/msg/SpeedScalingFactor")
        for factor in (0.5, -1.0, math.nan, math.inf):
            ros.publish(self.TOPIC, created(factor=factor))
        assert [request for request, _ in ros.asked] == [ScaleTrajectory(controller="arm", factor=0.5)]
        assert [reported.partition("scaling of ")[2][:4] for reported in ros.collected] == ["-1 i", "nan ", "inf "]
        ros.asked[0][1](None, "STOP is latched")
        assert ros.collected[-1] == f"{self.TOPIC}: STOP is latched"
        scaling.close()
        assert ros.left == [self.TOPIC]

    def test_it_is_there_once_positions_alone_are_commanded_and_keeps_what_was_reported_before(self, ros):
        scaling = SpeedScalingTopic(ros, ControllerReading(name="arm", type="x/Y", state="unconfigured"))
        assert ros.subscriptions == {}
        scaling.on_controller(
            ControllerReading(name="arm", type="x/Y", state="inactive", interface="position, velocity")
        )
        assert ros.subscriptions == {}
        scaling.on_controller(ARM)
        scaling.on_controller(ARM)
        assert ros.subscriptions[self.TOPIC][2].durability.name == "TRANSIENT_LOCAL"
