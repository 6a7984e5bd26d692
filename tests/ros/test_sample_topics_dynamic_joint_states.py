from __future__ import annotations

import math

import pytest
from support.ros import stamp_of

pytestmark = pytest.mark.ros
TOPIC = "/dynamic_joint_states"


@pytest.fixture(scope="module")
def listening(stage, maker):
    maker.order("subscribe", topic=TOPIC, of="control_msgs/msg/DynamicJointState", qos="default")
    return maker


def test_every_state_interface_is_told_by_its_name(listening, fresh):
    message = listening.message(TOPIC)
    assert message["joint_names"] == ["left", "right"]
    assert message["header"]["frame_id"] == "base_link"
    assert stamp_of(message) == 1_700_000_000.25
    left, _ = message["interface_values"]
    assert left["interface_names"] == ["position", "velocity", "effort"]
    assert left["values"][:2] == [1.0, 10.0]
    assert math.isnan(left["values"][2])


def test_interfaces_beyond_the_usual_ones_are_told_too(listening, fresh):
    fresh.robot.joints["left"]["others"] = {"temperature": 41.5}
    try:
        listening.message(TOPIC, lambda message: message["interface_values"][0]["values"][-1] == 41.5)
    finally:
        del fresh.robot.joints["left"]["others"]


def test_its_type_hash_is_upstreams(listening, fresh):
    publisher = listening.publisher(TOPIC)
    assert publisher["hash"] == "RIHS01_18024c98a62697680f581108eeed40b28fb4542fa0ac5a8e36f56c62b6813d26"
