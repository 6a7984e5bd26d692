from __future__ import annotations

import pytest
from support import ros

pytestmark = pytest.mark.ros
NODES = [{"name": "left_drive", "node_id": 3}]
OBJECT = "canopen_interfaces/msg/COData"
MAPPED = [{"index": 0x60FE, "subindex": 1, "bits": 32}, {"index": 0x2001, "subindex": 0, "bits": 16}]
SENT, COMING = {"direction": "rpdo", "objects": MAPPED}, {"direction": "tpdo", "objects": MAPPED[:1]}
LAYOUT = {"buses": {"can": {"nodes": [{"name": "left_drive", "pdos": [SENT, COMING]}]}}}


@pytest.fixture(scope="module")
def listening(stage, maker):
    for topic, kind, qos in (
        ("nmt_state", "std_msgs/msg/String", "latched"),
        ("joint_states", "sensor_msgs/msg/JointState", "reliable"),
        ("emcy", "diagnostic_msgs/msg/DiagnosticArray", "reliable"),
    ):
        maker.order("subscribe", topic=f"/left_drive/{topic}", of=kind, qos=qos)
    return maker


@pytest.fixture
def node(fresh):
    node = fresh.robot.nodes["left_drive"]
    before = dict(node)
    yield node
    node.update(before)


def test_the_nmt_state_is_latched_and_published_when_it_changes(listening, node):
    topic = "/left_drive/nmt_state"
    assert listening.message(topic) == {"data": "START"}
    for state, word in (("PRE_OPERATIONAL", "PREOP"), ("STOPPED", "STOP"), (None, "ERROR"), ("OPERATIONAL", "START")):
        node["nmt_state"] = state
        assert listening.message(topic) == {"data": word}


def test_emcy_messages_of_this_node_alone_are_reported_in_words_and_in_parts(listening, fresh):
    fresh.robot.event(time=1.0, kind="emcy", node="right_drive", level="warning", text="of another")
    fresh.robot.event(time=1.0, kind="state", node="left_drive", level="info", text="no emcy")
    details = {"error_code": 0x8130, "error_register": 0x11, "data": "0102030405"}
    text = "EMCY 0x8130 (life guard error)"
    fresh.robot.event(time=12.5, kind="emcy", node="left_drive", level="warning", text=text, details=details)
    fresh.robot.event(time=13.0, kind="emcy_flood", node="left_drive", level="warning", text="many more")
    message = listening.message("/left_drive/emcy")
    assert message["header"]["stamp"] == {"sec": 12, "nanosec": 500_000_000}
    (status,) = message["status"]
    assert (status["name"], status["hardware_id"], status["level"]) == ("left_drive", "node 3", 1)
    assert status["message"] == text
    assert {item["key"]: item["value"] for item in status["values"]} == {
        "error_code": "0x8130", "error_register": "0x11", "data": "01 02 03 04 05",
    }  # fmt: skip
    (status,) = listening.message("/left_drive/emcy")["status"]
    assert (status["message"], status["values"]) == ("many more", [])


def test_a_subscriber_to_rpdos_gets_everything_first_and_then_changes(listening, fresh):
    topic, robot = "/left_drive/rpdo", fresh.robot
    wide, position = [0x2000, 1, "0102030405060708"], [0x6064, 0, "f6ffffff"]
    robot.process_data = {"left_drive": [[0x6041, 0, "3702"], wide, position], "right_drive": [[0x6041, 0, "0000"]]}
    listening.order("subscribe", topic=topic, of=OBJECT, qos="reliable")
    assert listening.message(topic) == {"index": 0x6041, "subindex": 0, "data": 0x237}
    assert listening.message(topic) == {"index": 0x6064, "subindex": 0, "data": 0xFFFFFFF6}
    robot.tell_process_data(right_drive=[[0x6041, 0, "0100"]], left_drive=[[0x6041, 0, "1802"], [0x60FD, 0, "03"]])
    assert listening.message(topic) == {"index": 0x6041, "subindex": 0, "data": 0x218}
    assert listening.message(topic) == {"index": 0x60FD, "subindex": 0, "data": 3}
    with ros.Peer(fresh.domain, "--interfaces") as later:
        later.order("subscribe", topic=topic, of=OBJECT, qos="reliable")
        reported = [later.message(topic) for _ in range(3)]
        assert {item["index"]: item["data"] for item in reported} == {0x6041: 0x218, 0x6064: 0xFFFFFFF6, 0x60FD: 3}
        assert robot.watching_process_data
    listening.order("unsubscribe", topic=topic)
    assert ros.eventually(lambda: not robot.watching_process_data)


def test_tpdo_travels_in_the_rpdo_that_maps_it(listening, fresh):
    topic, robot = "/left_drive/tpdo", fresh.robot
    listening.order("publish", topic=topic, of=OBJECT, data={"index": 0x60FE, "subindex": 1, "data": 0x30000}, rate=20)
    assert ros.eventually(lambda: robot.commands("pdo_write"))
    assert robot.commands("pdo_write")[0] == {
        "node": "left_drive", "index": 0x60FE, "subindex": 1, "data": "00000300",
    }  # fmt: skip
    listening.order("publish", topic=topic, of=OBJECT, data={"index": 0x2001, "data": 0xFFFFFFFF}, rate=20)
    assert ros.eventually(
        lambda: {"node": "left_drive", "index": 0x2001, "subindex": 0, "data": "ffff"} in robot.commands("pdo_write")
    )
    listening.order("silence", topic=topic)
    assert not robot.commands("sdo_write")
    assert not robot.commands("sdo_read")


def test_what_no_rpdo_maps_is_written_by_sdo_but_not_what_moves_the_drive(listening, fresh):
    fresh.robot.answers["sdo_read"] = {"data": "0000"}
    topic = "/left_drive/tpdo"
    for index in (0x6040, 0x60FF, 0x68FF, 0x607A):
        listening.order("publish", topic=topic, of=OBJECT, data={"index": index, "data": 15})
    listening.order("publish", topic=topic, of=OBJECT, data={"index": 0x4000, "subindex": 1, "data": 5}, rate=20)
    assert ros.eventually(lambda: fresh.robot.commands("sdo_write"))
    listening.order("silence", topic=topic)
    assert {command["index"] for command in fresh.robot.commands("sdo_write")} == {0x4000}
    assert fresh.robot.commands("sdo_write")[0] == {
        "node": "left_drive", "index": 0x4000, "subindex": 1, "data": "0500",
    }  # fmt: skip
