from __future__ import annotations

import itertools
import math

import pytest

pytestmark = pytest.mark.ros
BROADCASTER = {"name": "gpio", "type": "canopen_control/GpioBroadcaster", "state": "active", "topic": None,
               "joints": [], "tells": "gpio", "is_broadcaster": True}  # fmt: skip
TOPIC = "/gpio/gpio_states"


def test_inputs_and_outputs_are_reported_by_part_and_name(fresh, maker):
    fresh.robot.controllers.append(BROADCASTER)
    parts = {"left": {"digital_inputs": 5.0}, "lamp": {"on": None, "dim": 0.5}}
    seconds = itertools.count(1_700_000_000)

    def tell():
        fresh.robot.samples["gpio"] = {"kind": "gpio", "time": next(seconds) + 0.25, "parts": parts}

    try:
        maker.order("subscribe", topic=TOPIC, of="control_msgs/msg/DynamicInterfaceGroupValues", qos="default")
        message = maker.hears(TOPIC, tell)
    finally:
        fresh.robot.controllers.remove(BROADCASTER)
    assert message["interface_groups"] == ["left", "lamp"]
    assert message["header"]["stamp"]["sec"] >= 1_700_000_000
    assert message["header"]["stamp"]["nanosec"] == 250_000_000
    left, lamp = message["interface_values"]
    assert left == {"interface_names": ["digital_inputs"], "values": [5.0]}
    assert lamp["interface_names"] == ["on", "dim"]
    assert math.isnan(lamp["values"][0])
    assert lamp["values"][1] == 0.5
