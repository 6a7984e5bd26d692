"""The topics with what ROS and the robot are to them, nothing is sent."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("sensor_msgs")

from support.endpoints import Ros

from canopen_control.ros import interfaces, state_topics, table
from canopen_control.ros.state_topics import BatteryTopics
from canopen_control.rpc.messages.samples import BatteriesSample, BatteryReading
from canopen_control.rpc.messages.state import ControllerReading, StateSample

pytestmark = pytest.mark.ros
MAIN = BatteryReading(name="main", voltage=24.5, current=-3.0, percentage=0.5, power_supply_status=2, present=True,
                      capacity=40.0, power_supply_technology=3, location="slot 1", serial_number="77")  # fmt: skip
STATE = StateSample(
    samples={"power": BatteriesSample(time=2.25, batteries=[MAIN], together=BatteryReading(name="", voltage=24.5))}
)
POWER = ControllerReading(name="power", type="x/Y", state="active", tells="batteries", is_broadcaster=True)


@pytest.fixture
def ros(monkeypatch):
    made = {"control_msgs/msg/BatteryStateArray": Array}
    monkeypatch.setattr(state_topics, "interface", lambda name: made.get(name) or interfaces.interface(name))
    return Ros()


class Array:
    """The message whose parts are of another package, which are not made here."""

    def __init__(self, battery_states):
        self.battery_states = battery_states


def test_all_batteries_and_each_by_itself_are_published_once(ros):
    (topics,) = table.endpoints_for(ros, POWER)
    assert type(topics) is BatteryTopics
    topics.on_state(STATE)
    topics.on_state(STATE)
    together, each = ros.publishers
    assert [one.topic for one in ros.publishers] == ["power/battery_state", "power/raw_battery_states"]
    assert together.kind.__name__ == "BatteryState"
    (message,) = together.told
    assert (message.voltage, message.header.frame_id, message.header.stamp.nanosec) == (24.5, "", 250_000_000)
    assert math.isnan(message.current)
    (array,) = each.told
    (main,) = array.battery_states
    assert (main.header.frame_id, main.voltage, main.current, main.percentage) == ("main", 24.5, -3.0, 0.5)
    assert (main.power_supply_status, main.power_supply_technology, main.present) == (2, 3, True)
    assert (main.capacity, main.location, main.serial_number) == (40.0, "slot 1", "77")
    assert math.isnan(main.temperature)
    topics.close()
    assert ros.left == [together, each]


def test_nothing_is_made_where_nobody_listens(ros):
    topics = BatteryTopics(ros, POWER)
    for publisher in ros.publishers:
        publisher.subscribers = 0
    topics.on_state(STATE)
    assert [each.told for each in ros.publishers] == [[], []]
