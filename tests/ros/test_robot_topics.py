from __future__ import annotations

import msgspec
import pytest
from support import endpoints
from support.ros import eventually

from canopen_control.ros import robot_topics
from canopen_control.ros.nodes import RosNode
from canopen_control.ros.rcl import ROSOUT
from canopen_control.ros.robot_topics import Rosout
from canopen_control.rpc.messages.state import RobotEvent

pytestmark = pytest.mark.ros


@pytest.fixture
def robot(monkeypatch):
    monkeypatch.setattr(robot_topics, "interface", endpoints.interface)
    robot = endpoints.Ros()
    robot.robot = "robby"
    nodes = [RosNode("left drive", 3, "/robot"), RosNode("arm_drive", 4, "/arm/lower")]
    robot.endpoint = Rosout(robot, nodes)
    return robot


def event(text="it happened", level="error", **more):
    return RobotEvent(time=12.5, kind="emcy", level=level, text=text, **{"node": None, **more})


@pytest.mark.parametrize(
    ("of", "name"),
    [
        ({"node": "left drive"}, "robot.left_drive"),
        ({"node": "arm_drive"}, "arm.lower.arm_drive"),
        ({"node": "new"}, "robot.new"),
        ({"controller": "base"}, "robot.base"),
        ({}, "robot.bridge"),
    ],
)
def test_an_event_comes_from_the_node_it_concerns(robot, of, name):
    robot.endpoint.on_event(event(**of))
    (publisher,) = robot.publishers
    assert [item.name for item in publisher.collected] == [name]


@pytest.mark.parametrize(("level", "number"), [("info", 20), ("warning", 30), ("error", 40)])
def test_it_has_its_level_time_and_text(robot, level, number):
    robot.endpoint.on_event(event("EMCY 0x8130", level))
    (reported,) = robot.publishers[0].collected
    assert (reported.level, reported.msg, reported.function, reported.stamp.sec) == (number, "EMCY 0x8130", "emcy", 12)


LOST = "no heartbeat for 0.5 s; is it powered and connected?"


@pytest.mark.parametrize(
    ("then", "reported"),
    [
        ({"text": f"node 3: lost: {LOST}"}, 1),
        ({"text": f"node 3: lost: {LOST}", "level": "error", "time": 14.0}, 2),
        ({"text": f"node 2: lost: {LOST}", "node": "arm_drive"}, 2),
        ({"text": f"stopping both wheels: node 3: lost: {LOST}", "kind": "stop"}, 2),
        ({"text": "node 3: lost: another reason"}, 2),
    ],
)
def test_one_cause_is_reported_once_but_a_stop_always(robot, then, reported):
    first = event(f"node 3 (left drive): {LOST}", node="left drive")
    robot.endpoint.on_event(first)
    robot.endpoint.on_event(msgspec.structs.replace(first, **then))
    assert len(robot.publishers[0].collected) == reported


def test_what_is_worse_is_reported_although_the_cause_is_the_same(robot):
    for level in ("warning", "error", "warning"):
        robot.endpoint.on_event(event(f"node 3: {LOST}", level, node="left drive"))
    assert [item.level for item in robot.publishers[0].collected] == [30, 40]


def test_its_quality_is_that_of_every_log_so_that_late_comers_have_it(robot):
    (publisher,) = robot.publishers
    assert (publisher.topic, publisher.quality) == ("/rosout", ROSOUT)
    assert (ROSOUT.depth, ROSOUT.durability.name, ROSOUT.lifespan.nanoseconds) == (1000, "TRANSIENT_LOCAL", 10**10)
    robot.endpoint.close()
    assert robot.left == [publisher]


TOPIC, EVENTS = "/diagnostics", "/canopen_control_bridge/events"


@pytest.fixture(scope="module")
def listening(stage):
    stage.peer.order("subscribe", topic=TOPIC, of="diagnostic_msgs/msg/DiagnosticArray")
    stage.peer.order("subscribe", topic=EVENTS, of="rcl_interfaces/msg/Log")
    return stage


def told_soon(stage):
    """Let the robot's clock go on until a message has come: the first may be sent before the subscription is known."""
    results = []

    def look():
        stage.robot.time += 1.0
        results.extend(stage.peer.waiting(TOPIC))
        return results

    assert eventually(look)
    return results[-1]


def statuses(message):
    return {item["name"]: item for item in message["status"]}


def test_diagnostics_hold_every_node_every_controller_and_the_cycle(listening, fresh):
    reported = statuses(told_soon(fresh))
    assert set(reported) == {
        f"fake: {name}" for name in ("left_drive", "right_drive", "joint_state_broadcaster", "forward", "base", "cycle")
    }
    assert reported["fake: left_drive"]["level"] == 0
    assert reported["fake: left_drive"]["hardware_id"] == "node 3"
    assert {"key": "NMT state", "value": "OPERATIONAL"} in reported["fake: left_drive"]["values"]


def test_what_becomes_worse_is_reported_at_once_in_the_same_second(listening, fresh):
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
