from __future__ import annotations

import pytest
from support import ros

pytestmark = pytest.mark.ros
NODES = [{"name": "left_drive", "node_id": 3}]
OBJECT, LOG = "canopen_interfaces/msg/COData", "rcl_interfaces/msg/Log"


@pytest.fixture(scope="module")
def listening(stage, maker):
    for topic, kind, qos in (
        ("nmt_state", "std_msgs/msg/String", "latched"),
        ("joint_states", "sensor_msgs/msg/JointState", "reliable"),
        ("emcy", LOG, "reliable"),
        ("rpdo", OBJECT, "reliable"),
    ):
        maker.order("subscribe", topic=f"/left_drive/{topic}", of=kind, qos=qos)
    return maker


@pytest.fixture
def node(fresh):
    node = fresh.robot.nodes["left_drive"]
    before = dict(node)
    yield node
    node.update(before)


def test_the_nmt_state_is_kept_for_who_comes_later_and_told_when_it_changes(listening, node):
    topic = "/left_drive/nmt_state"
    assert listening.message(topic) == {"data": "START"}
    for state, word in (("PRE_OPERATIONAL", "PREOP"), ("STOPPED", "STOP"), (None, "ERROR"), ("OPERATIONAL", "START")):
        node["nmt_state"] = state
        assert listening.message(topic) == {"data": word}


def test_joint_states_of_a_drive_have_its_name_and_a_stamp(listening, fresh):
    message = listening.message("/left_drive/joint_states")
    assert (message["name"], message["position"], message["velocity"]) == (["left_drive"], [1.0], [10.0])
    assert message["header"]["stamp"]["sec"] == 1_700_000_000


def test_emcy_messages_of_this_node_alone_are_told(listening, fresh):
    fresh.robot.event(time=1.0, kind="emcy", node="right_drive", level="warning", text="of another")
    fresh.robot.event(time=1.0, kind="state", node="left_drive", level="info", text="no emcy")
    fresh.robot.event(time=12.5, kind="emcy", node="left_drive", level="warning", text="EMCY 0x8130: life guard error")
    message = listening.message("/left_drive/emcy")
    assert (message["msg"], message["level"], message["function"]) == ("EMCY 0x8130: life guard error", 30, "emcy")


def test_the_statusword_comes_as_rpdo_when_it_changes(listening, node):
    axis = node["axes"][0]
    before, axis["statusword"] = axis["statusword"], 0x0218
    assert listening.message("/left_drive/rpdo", lambda message: message["data"] == 0x0218)["index"] == 0x6041
    axis["statusword"] = before


def test_tpdo_is_written_by_sdo_but_not_what_moves_the_drive(listening, fresh):
    fresh.robot.answers["sdo_read"] = {"data": "0000"}
    topic = "/left_drive/tpdo"
    for index in (0x6040, 0x60FF, 0x68FF, 0x607A):
        listening.order("publish", topic=topic, of=OBJECT, data={"index": index, "data": 15})
    listening.order("publish", topic=topic, of=OBJECT, data={"index": 0x4000, "subindex": 1, "data": 5}, rate=20)
    assert ros.eventually(lambda: fresh.robot.commands("sdo_write"))
    listening.order("silence", topic=topic)
    assert {each["index"] for each in fresh.robot.commands("sdo_write")} == {0x4000}
    assert fresh.robot.commands("sdo_write")[0] == {
        "node": "left_drive", "index": 0x4000, "subindex": 1, "data": "0500",
    }  # fmt: skip
