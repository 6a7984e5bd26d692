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


def test_every_state_interface_is_reported_by_its_name(listening, fresh):
    message = listening.message(TOPIC)
    assert message["joint_names"] == ["left", "right"]
    assert message["header"]["frame_id"] == "base_link"
    assert stamp_of(message) == 1_700_000_000.25
    left, _ = message["interface_values"]
    assert left["interface_names"] == ["position", "velocity", "effort"]
    assert left["values"][:2] == [1.0, 10.0]
    assert math.isnan(left["values"][2])
