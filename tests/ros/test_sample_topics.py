"""The topics with stand-ins for ROS and the robot; nothing is sent."""

from __future__ import annotations

import math

import pytest
from support.endpoints import Ros, publisher_of

from canopen_control.ros import controller_endpoints, interfaces, sample_publisher
from canopen_control.ros.sample_topics import SAMPLE_TOPICS
from canopen_control.rpc.messages.samples import (
    BatteriesSample,
    BatteryReading,
    ImuSample,
    PoseSample,
    RangeSample,
    WrenchSample,
)
from canopen_control.rpc.messages.state import ControllerReading, StateSample

pytest.importorskip("sensor_msgs")


pytestmark = pytest.mark.ros
SAMPLES = {
    "imu": ImuSample(
        time=2.25,
        frame_id="imu_link",
        orientation=(0.1, 0.2, 0.3, 0.9),
        angular_velocity=(1.0, 2.0, None),
        linear_acceleration=(0.0, 0.5, 9.81),
        orientation_covariance=[float(each) for each in range(9)],
        angular_velocity_covariance=[-1.0, *[0.0] * 8],
        linear_acceleration_covariance=[0.5] * 9,
    ),
    "range": RangeSample(time=2.25, frame_id="front", range=1.25, radiation_type=1, field_of_view=0.5, min_range=0.125,
                         max_range=4.0, variance=0.25),
    "wrench": WrenchSample(time=2.25, frame_id="tool0", force=(1.0, None, -3.5), torque=(0.5, 0.25, 0.125)),
    "pose": PoseSample(time=2.25, frame_id="map", position=(1.0, 2.0, None), orientation=(0.0, 0.6, 0.0, 0.8)),
}  # fmt: skip
TOPICS = {row.topic: row for row in SAMPLE_TOPICS if row.topic in SAMPLES}


def published(kind, sample=None):
    """Return the publisher of a kind of sample, after one update."""
    ros = Ros()
    controller = ControllerReading(name="b", type="x/Y", state="active", tells=kind, is_broadcaster=True)
    (endpoint,) = controller_endpoints.endpoints_for(ros, controller)
    assert endpoint._row is TOPICS[kind]
    state = StateSample(samples={"b": sample or SAMPLES[kind]})
    endpoint.on_state(state)
    endpoint.on_state(state)  # the same publication once more
    endpoint.close()
    (publisher,) = ros.publishers
    assert ros.left == [publisher]
    return publisher


@pytest.mark.parametrize("kind", TOPICS)
def test_names_types_and_quality_are_upstreams(kind):
    publisher = published(kind)
    name = {"imu": "Imu", "range": "Range", "wrench": "WrenchStamped", "pose": "PoseStamped"}[kind]
    assert (publisher.topic, publisher.kind.__name__) == (f"b/{kind}", name)
    assert publisher.quality.reliability.name == "SYSTEM_DEFAULT"
    (message,) = publisher.collected
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (2, 250_000_000)
    assert message.header.frame_id == SAMPLES[kind].frame_id


def xyz(vector):
    return [vector.x, vector.y, vector.z]


def test_an_imu():
    (message,) = published("imu").collected
    assert [*xyz(message.orientation), message.orientation.w] == [0.1, 0.2, 0.3, 0.9]
    assert xyz(message.angular_velocity)[:2] == [1.0, 2.0]
    assert math.isnan(message.angular_velocity.z)
    assert xyz(message.linear_acceleration) == [0.0, 0.5, 9.81]
    assert list(message.orientation_covariance) == [float(number) for number in range(9)]
    assert message.angular_velocity_covariance[0] == -1.0
    assert list(message.linear_acceleration_covariance) == [0.5] * 9


def test_a_pose():
    (message,) = published("pose").collected
    assert xyz(message.pose.position)[:2] == [1.0, 2.0]
    assert math.isnan(message.pose.position.z)
    assert [*xyz(message.pose.orientation), message.pose.orientation.w] == [0.0, 0.6, 0.0, 0.8]


def test_no_sensor_message_is_built_without_a_subscriber():
    ros = Ros()
    reading = ControllerReading(name="b", type="x/Y", state="active", tells="wrench")
    topic = publisher_of(ros, reading, "wrench")
    ros.publishers[0].subscribers = 0
    topic.on_state(StateSample(samples={"b": SAMPLES["wrench"]}))
    assert ros.publishers[0].collected == []


MAIN = BatteryReading(name="main", voltage=24.5, current=-3.0, percentage=0.5, power_supply_status=2, present=True,
                      capacity=40.0, power_supply_technology=3, location="slot 1", serial_number="77")  # fmt: skip
STATE = StateSample(
    samples={"power": BatteriesSample(time=2.25, batteries=[MAIN], together=BatteryReading(name="", voltage=24.5))}
)
POWER = ControllerReading(name="power", type="x/Y", state="active", tells="batteries", is_broadcaster=True)


@pytest.fixture
def ros(monkeypatch):
    created = {"control_msgs/msg/BatteryStateArray": Array}
    monkeypatch.setattr(sample_publisher, "interface", lambda name: created.get(name) or interfaces.interface(name))
    return Ros()


class Array:
    """The message whose parts are of another package, which are not made here."""

    battery_states = ()


def test_all_batteries_and_each_by_itself_are_published_once(ros):
    topics = controller_endpoints.endpoints_for(ros, POWER)
    for topic in (*topics, *topics):
        topic.on_state(STATE)
    together, each = ros.publishers
    assert [one.topic for one in ros.publishers] == ["power/battery_state", "power/raw_battery_states"]
    assert together.kind.__name__ == "BatteryState"
    (message,) = together.collected
    assert (message.voltage, message.header.frame_id, message.header.stamp.nanosec) == (24.5, "", 250_000_000)
    assert math.isnan(message.current)
    (array,) = each.collected
    (main,) = array.battery_states
    assert (main.header.frame_id, main.voltage, main.current, main.percentage) == ("main", 24.5, -3.0, 0.5)
    assert (main.power_supply_status, main.power_supply_technology, main.present) == (2, 3, True)
    assert (main.capacity, main.location, main.serial_number) == (40.0, "slot 1", "77")
    assert math.isnan(main.temperature)
    for topic in topics:
        topic.close()
    assert ros.left == [together, each]
