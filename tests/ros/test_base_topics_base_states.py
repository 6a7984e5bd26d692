"""Messages of steering and mecanum controllers, with stand-ins for ROS and the robot; nothing is sent."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("std_msgs")

from support.endpoints import Ros, interface, publisher_of

from canopen_control.ros import base_topics, controller_endpoints, sample_publisher
from canopen_control.ros.base_topics import OdometrySetting, TfOdometry, TwistCommands
from canopen_control.ros.rcl import SYSTEM_DEFAULT
from canopen_control.rpc.messages.samples import MecanumSample, SteeringSample
from canopen_control.rpc.messages.state import ControllerReading, StateSample

pytestmark = pytest.mark.ros
PLANAR, HOLONOMIC = ("linear.x", "angular.z"), ("linear.x", "linear.y", "angular.z")
WHERE = {"time": 5.5, "x": 1.0, "y": 2.0, "heading": math.pi, "frame_id": "map", "child_frame_id": "base"}


def reading(tells, axes, topic="reference"):
    return ControllerReading(name="base", type="x/Y", state="active", topic=topic, tells=tells, twist_axes=axes)


@pytest.fixture
def ros(monkeypatch):
    for module in (base_topics, sample_publisher):
        monkeypatch.setattr(module, "interface", interface, raising=False)
    return Ros()


@pytest.mark.parametrize(
    ("tells", "axes", "kind"),
    [("steering", PLANAR, "SteeringControllerStatus"), ("mecanum", HOLONOMIC, "MecanumDriveControllerState")],
)
def test_they_have_upstreams_topics(ros, tells, axes, kind):
    created = controller_endpoints.endpoints_for(ros, reading(tells, axes))
    assert [type(item) for item in created[:3]] == [TwistCommands, OdometrySetting, TfOdometry]
    assert list(ros.services) == ["base/set_odometry"]
    assert [(publisher.topic, publisher.kind.__name__) for publisher in ros.publishers] == [
        ("base/tf_odometry", "TFMessage"),
        ("base/odometry", "Odometry"),
        ("base/controller_state", kind),
    ]
    assert all(publisher.quality is SYSTEM_DEFAULT for publisher in ros.publishers)
    kind, _, quality = ros.subscriptions["base/reference"]
    assert kind.__name__ == "TwistStamped"
    assert (quality.depth, quality.reliability.name) == (1, "BEST_EFFORT")
    assert ros.subscriptions["base/reference_unstamped"][0].__name__ == "Twist"


def test_an_omni_base_has_the_topics_of_the_diff_drive(ros):
    controller_endpoints.endpoints_for(ros, reading("odometry", HOLONOMIC, "cmd_vel"))
    assert list(ros.subscriptions) == ["base/cmd_vel", "base/cmd_vel_unstamped"]
    assert [publisher.topic for publisher in ros.publishers] == ["base/odom"]
    assert list(ros.services) == ["base/set_odometry"]


def test_a_steered_base_reports_its_wheels(ros):
    state = publisher_of(ros, reading("steering", PLANAR), "controller_state")
    sample = SteeringSample(
        **WHERE, traction_velocities=[1.0, None], steering=[0.25], traction_commands=[2.0, 3.0], steering_commands=[0.5]
    )
    state.on_state(StateSample(samples={"base": sample}))
    (reported,) = ros.publishers[0].collected
    assert (reported.header.stamp.sec, reported.header.frame_id) == (5, "map")
    assert list(reported.traction_wheels_position) == []
    assert reported.traction_wheels_velocity[0] == 1.0
    assert math.isnan(reported.traction_wheels_velocity[1])
    assert (list(reported.steer_positions), list(reported.steering_angle_command)) == ([0.25], [0.5])
    assert list(reported.linear_velocity_command) == [2.0, 3.0]


def test_a_base_on_mecanum_wheels_reports_them_and_its_twist(ros):
    state = publisher_of(ros, reading("mecanum", HOLONOMIC), "controller_state")
    sample = MecanumSample(**WHERE, wheels=[1.0, 2.0, 3.0, None], reference=[0.1, 0.2, None])
    state.on_state(StateSample(samples={"base": sample}))
    (reported,) = ros.publishers[0].collected
    result = (reported.front_left_wheel_velocity, reported.back_left_wheel_velocity, reported.back_right_wheel_velocity)
    assert result == (1.0, 2.0, 3.0)
    assert math.isnan(reported.front_right_wheel_velocity)
    assert (reported.reference_velocity.linear.x, reported.reference_velocity.linear.y) == (0.1, 0.2)
    assert math.isnan(reported.reference_velocity.angular.z)


@pytest.mark.parametrize("broadcast", [True, False])
def test_the_transform_of_odometry_is_reported_once_where_it_is_broadcast(ros, broadcast):
    endpoint = TfOdometry(ros, reading("mecanum", HOLONOMIC))
    state = StateSample(samples={"base": MecanumSample(**WHERE, enable_odom_tf=broadcast)})
    endpoint.on_state(state)
    endpoint.on_state(state)
    (publisher,) = ros.publishers
    assert len(publisher.collected) == int(broadcast)
    if broadcast:
        (transform,) = publisher.collected[0].transforms
        assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base")
        assert (transform.transform.translation.x, transform.transform.rotation.z) == (1.0, pytest.approx(1.0))
    endpoint.close()
    assert ros.left == [publisher]
