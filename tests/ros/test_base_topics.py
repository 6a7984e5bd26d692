from __future__ import annotations

import math

import pytest

pytest.importorskip("geometry_msgs")

from geometry_msgs.msg import Twist
from msgspec.structs import replace
from support import ros
from support.endpoints import Ros, interface, publisher_of
from support.ros import eventually

from canopen_control.ros import base_topics, sample_publisher
from canopen_control.ros.base_topics import OdometryReset, OdometrySetting, SharedTwist, TwistCommands
from canopen_control.rpc.messages.robot import SetOdometry
from canopen_control.rpc.messages.samples import OdometrySample
from canopen_control.rpc.messages.state import ControllerReading, StateSample

pytestmark = pytest.mark.ros
STAMPED, PLAIN = "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist"
ODOMETRY = {
    "kind": "odometry", "time": 1_700_000_000.5, "x": 1.0, "y": 2.0, "heading": math.pi / 2, "linear": 0.5,
    "angular": -0.25, "frame_id": "odom", "child_frame_id": "base_link", "limited": [0.4, -0.2],
    "pose_covariance": [0.001, 0.002, 0, 0, 0, 0.01], "twist_covariance": [0.1, 0, 0, 0, 0, 0.2],
}  # fmt: skip


HOLONOMIC = ("linear.x", "linear.y", "angular.z")


def reading(axes):
    return ControllerReading(name="base", type="x/Y", state="active", topic="cmd_vel", twist_axes=axes)


def twist(linear, angular):
    return {"linear": {"x": linear}, "angular": {"z": angular}}


def twists(stage):
    return stage.robot.commands("twist")


@pytest.fixture
def driving(fresh):
    fresh.robot.switch(base="active")
    return fresh


def test_a_stamped_twist_goes_to_the_runtime_with_its_stamp(driving):
    data = {
        "header": {"stamp": {"sec": 12, "nanosec": 500_000_000}, "frame_id": "whatever"},
        "twist": twist(0.5, -0.25),
    }
    driving.peer.order("publish", topic="/base/cmd_vel", of=STAMPED, data=data, rate=20)
    assert eventually(lambda: twists(driving))
    driving.peer.order("silence", topic="/base/cmd_vel")
    assert twists(driving)[-1] == {
        "controller": "base",
        "linear": 0.5,
        "lateral": 0.0,
        "angular": -0.25,
        "stamp": 12.5,
        "source": "ros",
        "dead_man": True,
    }


def test_a_plain_twist_has_its_own_topic(driving):
    driving.peer.order("publish", topic="/base/cmd_vel_unstamped", of=PLAIN, data=twist(0.1, 0.2), rate=20)
    sent = {"controller": "base", "linear": 0.1, "lateral": 0.0, "angular": 0.2, "source": "ros", "dead_man": True}
    assert eventually(lambda: sent in twists(driving))
    driving.peer.order("silence", topic="/base/cmd_vel_unstamped")


def test_a_plain_twist_on_the_stamped_topic_is_taken_as_in_ros_1_and_a_stamped_one_after_it(driving):
    topic = "/base/cmd_vel"
    driving.peer.order("renew", topic=topic)
    with ros.Peer(driving.domain) as old:
        old.order("publish", topic=topic, of=PLAIN, data=twist(0.4, 0.0), rate=20)

        def taken():
            driving.robot.time += 0.1  # of the looks
            return any(item["linear"] == 0.4 for item in twists(driving))

        assert eventually(taken)
    driving.peer.order("publish", topic=topic, of=STAMPED, data={"twist": twist(0.6, 0.0)}, rate=20)

    def taken_again():
        driving.robot.time += 0.1
        return any(item["linear"] == 0.6 for item in twists(driving))

    assert eventually(taken_again)
    driving.peer.order("silence", topic=topic)


def test_a_twist_that_is_not_finite_is_dropped(driving):
    topic = "/base/cmd_vel_unstamped"
    for bad in (twist(math.nan, 0.0), twist(0.0, math.inf)):
        driving.peer.order("publish", topic=topic, of=PLAIN, data=bad)
    driving.peer.order("publish", topic=topic, of=PLAIN, data=twist(0.3, 0.3), rate=20)
    assert eventually(lambda: any(item["linear"] == 0.3 for item in twists(driving)))
    driving.peer.order("silence", topic=topic)
    assert not any(item["linear"] == 0.0 for item in twists(driving))


def test_odometry_is_published_once_for_each_new_sample(driving):
    peer, robot = driving.peer, driving.robot
    peer.order("subscribe", topic="/base/odom", of="nav_msgs/msg/Odometry", qos="latched")
    peer.order("subscribe", topic="/base/cmd_vel_out", of=STAMPED, qos="latched")
    robot.samples = {"base": ODOMETRY}
    odom = peer.message("/base/odom")
    limited = peer.message("/base/cmd_vel_out")
    assert (odom["header"]["frame_id"], odom["child_frame_id"]) == ("odom", "base_link")
    assert odom["header"]["stamp"] == {"sec": 1_700_000_000, "nanosec": 500_000_000}
    pose, velocity = odom["pose"], odom["twist"]
    assert pose["pose"]["position"] == {"x": 1.0, "y": 2.0, "z": 0.0}
    assert pose["pose"]["orientation"]["z"] == pytest.approx(math.sqrt(0.5))
    assert pose["covariance"][0::7] == [0.001, 0.002, 0.0, 0.0, 0.0, 0.01]
    assert (velocity["twist"]["linear"]["x"], velocity["twist"]["angular"]["z"]) == (0.5, -0.25)
    assert velocity["covariance"][0::7] == [0.1, 0.0, 0.0, 0.0, 0.0, 0.2]
    assert (limited["twist"]["linear"]["x"], limited["twist"]["angular"]["z"]) == (0.4, -0.2)
    robot.samples = {"base": {**ODOMETRY, "time": 1_700_000_001.0, "limited": None}}
    assert peer.message("/base/odom")["header"]["stamp"]["sec"] == 1_700_000_001, "the same sample was not repeated"


@pytest.mark.parametrize(("axes", "lateral"), [(("linear.x", "angular.z"), 0.0), (HOLONOMIC, 0.4)])
def test_what_goes_sideways_is_for_a_base_that_can(axes, lateral):
    inputs = Ros()
    commands = TwistCommands(inputs, reading(axes))
    message = Twist()
    message.linear.x, message.linear.y, message.angular.z = 0.5, 0.4, 0.3
    inputs.publish("base/cmd_vel_unstamped", message)
    (sent,) = inputs.commanded
    assert (sent.linear, sent.lateral, sent.angular) == (0.5, lateral, 0.3)
    message.linear.y = math.nan
    inputs.publish("base/cmd_vel_unstamped", message)
    assert len(inputs.commanded) == (1 if lateral else 2)
    assert inputs.collected == (
        ["base: a twist is not finite: linear.x 0.5, linear.y nan, angular.z 0.3; it was dropped"] * bool(lateral)
    )
    commands.close()


WHEEL = {"time": 1.0, "x": 1.0, "y": 2.0, "heading": 0.5, "linear": 0.25}


def test_odometry_without_its_pose_has_the_twist_alone():
    ros = Ros()
    endpoint = publisher_of(ros, replace(reading(HOLONOMIC), tells="odometry"), "odom")
    endpoint.on_state(StateSample(samples={"base": OdometrySample(**WHEEL, only_twist=True)}))
    (message,) = ros.publishers[0].collected
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    assert (position.x, position.y, orientation.z, orientation.w) == (0.0, 0.0, 0.0, 1.0)
    assert message.twist.twist.linear.x == 0.25


def test_the_command_of_the_wheel_is_published_where_it_is_in_the_sample(monkeypatch):
    monkeypatch.setattr(sample_publisher, "interface", interface)
    ros = Ros()
    endpoint = publisher_of(ros, replace(reading(HOLONOMIC), tells="odometry"), "cmd_ackermann")
    endpoint.on_state(StateSample(samples={"base": OdometrySample(**WHEEL)}))
    assert ros.publishers == []
    endpoint.on_state(StateSample(samples={"base": OdometrySample(**WHEEL | {"time": 2.0}, ackermann=(4.0, -0.5))}))
    (publisher,) = ros.publishers
    assert (publisher.topic, publisher.kind.__name__) == ("base/cmd_ackermann", "AckermannDrive")
    assert (publisher.collected[0].speed, publisher.collected[0].steering_angle) == (4.0, -0.5)


def test_odometry_is_reset_by_a_service_without_fields(monkeypatch):
    monkeypatch.setattr(base_topics, "interface", interface, raising=False)
    ros = Ros()
    endpoint = OdometryReset(ros, reading(HOLONOMIC))
    _, requests = ros.call("base/reset_odometry", {})
    assert requests == [SetOdometry(controller="base", x=0.0, y=0.0, heading=0.0)]
    ros.call("base/reset_odometry", "base is inactive")
    assert ros.collected == ["base/reset_odometry: base is inactive"]
    endpoint.close()
    assert ros.left == ["base/reset_odometry"]


def test_odometry_is_set_by_a_service_in_the_plane_alone(monkeypatch):
    monkeypatch.setattr(base_topics, "interface", interface, raising=False)
    inputs = Ros()
    endpoint = OdometrySetting(inputs, reading(HOLONOMIC))
    response, requested = inputs.call("base/set_odometry", {}, x=1.0, y=-2.0, yaw=0.5)
    assert (response.success, response.message) == (True, "")
    assert requested == [SetOdometry(controller="base", x=1.0, y=-2.0, heading=0.5)]
    response, _ = inputs.call("base/set_odometry", "base is inactive", yaw=0.5)
    assert (response.success, response.message) == (False, "base is inactive")
    response, requested = inputs.call("base/set_odometry", z=0.5, pitch=0.1)
    assert (response.success, requested) == (False, [])
    assert response.message == "base moves only in the plane; z, pitch must be 0"
    endpoint.close()
    assert inputs.left == ["base/set_odometry"]


def test_the_publishers_on_all_topics_of_a_base_are_watched_together():
    inputs = Ros()
    inputs.controllers = {"base": reading(("linear.x", "angular.z"))}
    commands, shared = TwistCommands(inputs, inputs.controllers["base"]), SharedTwist(inputs, "cmd_vel", "Twist")
    message = Twist()
    message.linear.x = 0.5
    for topic in ("cmd_vel", "base/cmd_vel", "base/cmd_vel_unstamped"):
        inputs.publish(topic, message)
    message.linear.x = math.nan
    inputs.publish("cmd_vel", message)
    watched = [("base", topic, (0.5, 0.0, 0.0)) for topic in ("cmd_vel", "base/cmd_vel", "base/cmd_vel_unstamped")]
    assert inputs.watched == watched
    commands.close()
    shared.close()
