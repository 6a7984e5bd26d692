from __future__ import annotations

import math

import pytest
from support.ros import run_ros

pytestmark = pytest.mark.ros
TOPIC = "/joint_states"


@pytest.fixture(scope="module")
def listening(stage):
    stage.peer.order("subscribe", topic=TOPIC, of="sensor_msgs/msg/JointState", qos="default")
    stage.peer.message(TOPIC)
    return stage


def test_a_sample_of_the_robot_becomes_a_joint_state_of_that_time(listening, fresh):
    message = fresh.peer.message(TOPIC)
    assert message["name"] == ["left", "right"]
    assert message["position"] == [1.0, 2.0]
    assert message["velocity"] == [10.0, 20.0]
    assert [math.isnan(value) for value in message["effort"]] == [True, True]
    assert message["header"]["stamp"] == {"sec": 1_700_000_000, "nanosec": 250_000_000}
    assert message["header"]["frame_id"] == "base_link"


def test_the_order_is_the_broadcasters(listening, fresh):
    before = fresh.robot.controllers[0]["joints"]
    fresh.robot.controllers[0]["joints"] = ["right", "left"]
    fresh.robot.switch(base="active")  # a change that makes the bridge ask again
    try:
        fresh.peer.message(
            TOPIC, lambda message: message["name"] == ["right", "left"] and message["position"] == [2.0, 1.0]
        )
    finally:
        fresh.robot.controllers[0]["joints"] = before
        fresh.robot.switch(base="inactive")


def test_nothing_is_published_while_the_broadcaster_is_not_active(listening, fresh):
    fresh.robot.switch(joint_state_broadcaster="inactive")
    fresh.robot.time = 1_800_000_000.0
    # the samples with the new time may still come until the bridge has seen the switch; a later time never does
    marker = {"name": "marker", "type": "x/Y", "state": "active", "topic": "commands"}
    fresh.robot.controllers.append(marker)
    try:
        topic = "/marker/commands"
        while not fresh.peer.order("publish", topic=topic, of="std_msgs/msg/Float64MultiArray", data={"data": []})[
            "subscribers"
        ]:
            pass
        fresh.robot.time = 1_900_000_000.0
        fresh.robot.switch(joint_state_broadcaster="active")
        fresh.peer.message(TOPIC, lambda message: message["header"]["stamp"]["sec"] == 1_900_000_000)
    finally:
        fresh.robot.controllers.remove(marker)
        fresh.robot.time = 1_700_000_000.25


def test_the_publisher_satisfies_every_subscriber(stage):
    (publisher,) = stage.peer.order("endpoints", topic=TOPIC)["publishers"]
    assert (publisher["reliability"], publisher["durability"]) == ("RELIABLE", "TRANSIENT_LOCAL")


def test_a_time_in_unix_seconds_as_a_message():
    code = "from canopen_control.ros.joint_states import time_message as t; m = t(12.5); print(m.sec, m.nanosec)"
    assert run_ros(code).split() == ["12", "500000000"]
