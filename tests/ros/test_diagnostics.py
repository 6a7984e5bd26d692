from __future__ import annotations

import pytest
from support.ros import eventually

pytestmark = pytest.mark.ros
TOPIC, EVENTS = "/diagnostics", "/canopen_control_bridge/events"


@pytest.fixture(scope="module")
def listening(stage):
    stage.peer.order("subscribe", topic=TOPIC, of="diagnostic_msgs/msg/DiagnosticArray")
    stage.peer.order("subscribe", topic=EVENTS, of="rcl_interfaces/msg/Log")
    return stage


def told_soon(stage):
    """Let the robot's clock go on until a message has come: the first may be sent before the subscription is known."""
    found = []

    def look():
        stage.robot.time += 1.0
        found.extend(stage.peer.waiting(TOPIC))
        return found

    assert eventually(look)
    return found[-1]


def statuses(message):
    return {each["name"]: each for each in message["status"]}


def test_diagnostics_hold_every_node_every_controller_and_the_cycle(listening, fresh):
    told = statuses(told_soon(fresh))
    assert set(told) == {
        f"fake: {name}" for name in ("left_drive", "right_drive", "joint_state_broadcaster", "forward", "base", "cycle")
    }
    assert told["fake: left_drive"]["level"] == 0
    assert told["fake: left_drive"]["hardware_id"] == "node 3"
    assert {"key": "NMT state", "value": "OPERATIONAL"} in told["fake: left_drive"]["values"]


def test_what_becomes_worse_is_told_at_once_in_the_same_second(listening, fresh):
    fresh.peer.waiting(TOPIC)
    axis = fresh.robot.nodes["left_drive"]["axes"][0]
    axis["cia402_state"] = "FAULT"
    message = fresh.peer.message(TOPIC, lambda message: statuses(message)["fake: left_drive"]["level"] == 2)
    assert message["header"]["stamp"]["sec"] == int(fresh.robot.time)
    axis["cia402_state"] = "OPERATION_ENABLED"
    fresh.peer.message(TOPIC, lambda message: statuses(message)["fake: left_drive"]["level"] == 0)


def test_events_are_log_messages_with_their_level(listening, fresh):
    fresh.robot.event(time=12.5, kind="emcy", node="left_drive", level="warning", text="EMCY 0x8130: life guard error")
    message = fresh.peer.message(EVENTS)
    assert (message["level"], message["name"], message["function"]) == (30, "left_drive", "emcy")
    assert message["msg"] == "EMCY 0x8130: life guard error"
    assert message["stamp"] == {"sec": 12, "nanosec": 500_000_000}
    fresh.robot.event(time=13.0, kind="running", node=None, level="info", text="it runs")
    assert fresh.peer.message(EVENTS)["name"] == "fake"


def test_a_fault_is_in_ros_log_from_the_node_it_concerns(fresh):
    fresh.peer.order("subscribe", topic="/rosout", of="rcl_interfaces/msg/Log", qos="latched")
    fresh.robot.event(time=12.5, kind="emcy", node="left_drive", level="error", text="EMCY 0x3210: overvoltage")
    fresh.robot.event(time=13.0, kind="error", controller="base", level="error", text="base was deactivated")
    drive = fresh.peer.message("/rosout", lambda message: "0x3210" in message["msg"])
    assert (drive["level"], drive["name"]) == (40, "left_drive")
    assert fresh.peer.message("/rosout", lambda message: "base was" in message["msg"])["name"] == "base"
