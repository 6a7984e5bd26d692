from __future__ import annotations

import pytest
from support import ros

pytestmark = pytest.mark.ros
TOPIC, PLAIN, STAMPED = "/cmd_vel", "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"


def twist(linear):
    return {"linear": {"x": linear}, "angular": {"z": 0.5}}


@pytest.fixture
def driving(fresh):
    fresh.robot.switch(base="active")
    fresh.robot.time += 1.0
    return fresh


def seen(stage, linear):
    stage.robot.time += 0.01  # the bridge looks at the graph by the robot's clock
    return any(command["linear"] == linear for command in stage.robot.commands("twist"))


def test_the_type_is_that_of_the_publisher_and_changes_when_it_has_left(driving):
    for linear, kind, data in (
        (0.1, PLAIN, twist(0.1)),
        (0.2, STAMPED, {"twist": twist(0.2)}),
        (0.3, PLAIN, twist(0.3)),
    ):
        with ros.Peer(driving.domain) as teleop:
            teleop.order("publish", topic=TOPIC, of=kind, data=data, rate=20)
            assert ros.eventually(lambda: seen(driving, linear)), kind  # noqa: B023 - waited for


def test_with_several_base_controllers_it_is_not_known_which_one_is_meant(driving):
    second = {**driving.robot.controllers[2], "name": "second", "state": "active"}
    driving.robot.controllers.append(second)
    try:
        with ros.Peer(driving.domain) as teleop:
            teleop.order("subscribe", topic="/rosout", of="rcl_interfaces/msg/Log", qos="latched")
            teleop.order("publish", topic=TOPIC, of=PLAIN, data=twist(0.4), rate=20)

            def collected():
                driving.robot.time += 0.01
                return any("several base controllers" in message["msg"] for message in teleop.waiting("/rosout"))

            assert ros.eventually(collected)
    finally:
        driving.robot.controllers.remove(second)
    assert driving.robot.commands("twist") == []
