from __future__ import annotations

import pytest

pytestmark = pytest.mark.ros
TOPIC = "/clock"


@pytest.fixture(scope="module")
def listening(stage):
    stage.peer.order("subscribe", topic=TOPIC, of="rosgraph_msgs/msg/Clock", qos="default")
    return stage


def test_a_simulated_robot_tells_its_time(listening, fresh):
    fresh.robot.more = {"sim_time": 12.5}
    message = fresh.peer.message(TOPIC)
    assert message["clock"] == {"sec": 12, "nanosec": 500_000_000}
    fresh.robot.more = {"sim_time": 13.0}
    fresh.peer.message(TOPIC, lambda message: message["clock"]["sec"] == 13)
