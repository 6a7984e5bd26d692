import pytest
from support.fake_client import FakeClient
from support.service_node import NodeStub

from canopen_control.commissioning import driven_axis
from canopen_control.commissioning.driven_axis import (
    CURRENTS,
    DriveCurrent,
    JogDrive,
    choose_mode,
    drive_of_robot,
    ended_words,
    error_history,
    fault_words,
    why_not_free,
)
from canopen_control.commissioning.node_session import NodeSession
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, RemoteError
from canopen_control.od.eds import read_eds
from canopen_control.rpc.messages.robot import (
    AxisRequest,
    GetNodes,
    ListControllers,
    NodeListing,
    NodePlace,
    SdoData,
    SdoRead,
)
from canopen_control.rpc.messages.state import AxisReading, ControllerReading, NodeReading, StateSample

DRIVE = JogDrive("jog_5", "drive", "joint", "controller", "PV")


NODES = NodeListing({}, [NodePlace(name="left", node_id=2, joints=["wheel"]), NodePlace(name="io", node_id=3)])


def robot(*controllers):
    return FakeClient(answers={GetNodes: NODES, ListControllers: controllers})


def controller(name, topic=None, *, active=True, joint="wheel"):
    return ControllerReading(name=name, type="", state="active" if active else "inactive", joints=(joint,), topic=topic)


def test_a_drive_that_takes_targets_by_itself_is_moved_through_its_robot():
    result = drive_of_robot(robot(controller("wheel", "target")), "2", 0, "PV")
    assert (result.robot, result.node, result.joint, result.controller, result.mode) == (
        "robby",
        "left",
        "wheel",
        "wheel",
        "PV",
    )


@pytest.mark.parametrize(
    ("node", "controllers", "why"),
    [
        (
            "left",
            [controller("forward", "commands")],
            "and is commanded by forward, and only one client may move it; drive it by",
        ),
        ("left", [controller("wheel", "target", active=False)], "but no active controller moves it; activate one"),
        ("io", [], r"node 3 \(io\) of the running robot robby does not move a joint"),
        ("9", [], "robot robby has no node '9'; its nodes: 2 left, 3 io"),
    ],
)
def test_any_other_drive_of_a_robot_is_left_to_it_with_what_to_do_instead(node, controllers, why):
    with pytest.raises(ConfigError, match=why):
        drive_of_robot(robot(*controllers), node, 0, "PV")


def test_a_mode_is_asked_for_again_while_the_drive_boots(monkeypatch):
    monkeypatch.setattr(driven_axis, "PERIOD_S", 0.0)
    client = FakeClient(("ControlError", "has not booted yet"), ("ControlError", "has not booted yet"))
    choose_mode(client, AxisRequest(action="mode", node="drive", mode="PV"))
    assert len(client.asked) == 3


def test_a_mode_that_the_drive_lacks_is_reported_at_once():
    with pytest.raises(RemoteError, match="no PV"):
        choose_mode(FakeClient(("UnsupportedMode", "no PV")), AxisRequest(action="mode", node="drive", mode="PV"))


def test_the_current_is_read_where_the_drive_reports_it_and_else_its_torque():
    client = FakeClient(("SdoAbort", "no such object"), answers={SdoRead: SdoData(b"\xce\xff")})
    current = DriveCurrent(DRIVE)
    for _ in range(2):
        current._read_ns = -(10**12)
        current.ask(client)
    assert [item.index for item in client.asked] == [index for index, _ in CURRENTS]
    assert current.value == -50.0


def test_a_drive_of_which_nothing_is_known_is_reported_as_such():
    node = NodeReading(node_id=5, axes=(AxisReading(joint=DRIVE.joint),))
    lost = StateSample(nodes={DRIVE.node: node})
    for sample in (None, lost):
        assert ended_words(sample, DRIVE).startswith("the drive reports no state any more, so it may still move")


# -- drive faults


OD = read_eds(data_path("eds", "generic_cia402.eds"), 5).od
FAULT, ENABLED, OFF = (word.to_bytes(2, "little") for word in (0x0218, 0x0237, 0x0250))


def session(statusword, **objects):
    result = {(0x6041, 0): statusword, **{(int(name[1:], 16), 0): data for name, data in objects.items()}}
    return NodeSession(NodeStub(result), 5, OD)


def test_a_drive_without_a_fault_has_nothing_to_report():
    assert (fault_words(session(OFF)), why_not_free(session(OFF))) == ("", "")


def test_a_fault_is_reported_by_its_code_and_the_error_register():
    words = fault_words(session(FAULT, x603F=b"\x20\x32", x1001=b"\x05"))
    assert words.startswith("0x3220 ")
    assert "register 0x05 (" in words


def test_without_an_error_code_only_the_history_is_reported():
    node = session(FAULT)
    assert fault_words(node) == "unknown (the drive reports no error code)"
    node.transfers.objects[0x1003, 1] = b"\x10\x43\x02\x00"
    assert fault_words(node).startswith("0x4310 ")


@pytest.mark.parametrize(("word", "free"), [(ENABLED, False), (FAULT, True), (b"\x01\x00", True)])
def test_a_drive_enabled_by_another_master_is_not_free(word, free):
    assert (why_not_free(session(word)) == "") is free
    if not free:
        assert "OPERATION ENABLED: another program" in why_not_free(session(word))


def test_the_error_history_is_reported_newest_first():
    held = {(0x1003, 0): b"\2", (0x1003, 1): (0x00012310).to_bytes(4, "little"), (0x1003, 2): b"\x10\x81\0\0"}
    result = error_history(NodeSession(NodeStub(held), 5, None))
    assert [item[:6] for item in result] == ["0x2310", "0x8110"]
    assert result[0].endswith(", additional information 0x0001")
    assert error_history(NodeSession(NodeStub({(0x1003, 0): b"\0"}), 5, None)) == []
    with pytest.raises(ConfigError, match=r"node 5 has no error history \(0x1003\)"):
        error_history(NodeSession(NodeStub({}), 5, None))
