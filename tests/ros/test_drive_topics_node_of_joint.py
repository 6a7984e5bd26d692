"""The topics and services with stand-ins for ROS and the robot; nothing is sent."""

from __future__ import annotations

import pytest

pytest.importorskip("std_msgs")

from support.endpoints import Ros, interface

from canopen_control.ros import drive_services, drive_topics, sdo_services
from canopen_control.ros.drive_topics import DeviceNode, ProxyNode
from canopen_control.rpc.messages.layout import BusLayout, Layout, MappedEntry, NodeLayout, PdoLayout
from canopen_control.rpc.messages.robot import (
    AxisDone,
    AxisRequest,
    GetLayout,
    GetNodes,
    MappedValue,
    NmtRequest,
    NodeListing,
    NodePlace,
    PdoWrite,
    SdoData,
    SdoRead,
)
from canopen_control.rpc.messages.state import ControllerReading, NodeReading, RobotEvent, StateSample

pytestmark = pytest.mark.ros
NODES = NodeListing(
    nodes=[
        NodePlace(name="left_drive", node_id=3, joints=["left", "mirror"], namespace="/elsewhere"),
        NodePlace(name="terminal", node_id=9),
    ]
)
RPDO = PdoLayout(cob_id=0x209, direction="rpdo", number=1, objects=(MappedEntry(0x6200, 1, 8, "UNSIGNED8"),))
LAYOUT = Layout({"can": BusLayout("local:x", 500_000, nodes=(NodeLayout("terminal", 9, pdos=(RPDO,)),))})
RESET = {"command": "reset-node", "boot": True}
THEIRS = {"nmt_reset_node", "nmt_start_node", "sdo_read", "sdo_write"}
MODES = {f"{mode}_mode" for mode in ("position", "velocity", "cyclic_velocity", "cyclic_position")}


def reading(kind="Proxy", joint="terminal", state="active"):
    type_name = {"Proxy": "CanopenProxyController", "Device": "Cia402DeviceController"}[kind]
    joints = (joint,) if joint else ()
    return ControllerReading(name="io", type=f"canopen_ros2_controllers/{type_name}", state=state, joints=joints)


@pytest.fixture
def ros(monkeypatch):
    for module in (drive_services, drive_topics, sdo_services):
        monkeypatch.setattr(module, "interface", interface, raising=False)
    return Ros()


def made(ros, kind, joint):
    """Return the endpoint of a controller, once the robot has reported its nodes."""
    controller = reading(kind, joint)
    endpoint = (ProxyNode if kind == "Proxy" else DeviceNode)(ros, controller)
    endpoint.on_controller(controller)
    for expected, answer in ((GetNodes(), NODES), (GetLayout(), LAYOUT)):
        request, reported = ros.asked.pop()
        assert request == expected
        reported(answer, None)
    return endpoint


def call(ros, name, error=None, answer=None, **fields):
    """Call a service, and return what was asked of the robot and the response."""
    kind, handler = ros.services[f"/robot/io/{name}"]
    replies = []
    handler(kind.Request(**fields), kind.Response(), replies.append)
    request, reported = ros.asked.pop()
    reported(answer, error)
    return request, replies[0]


def test_a_proxy_has_the_names_of_ros2_canopen_below_its_own_and_nothing_that_moves(ros):
    made(ros, "Proxy", "terminal")
    services = {name.removeprefix("/robot/io/") for name in ros.services}
    assert services == {*THEIRS, "get_objects", "set_objects"}
    assert {"/robot/io/rpdo", "/robot/io/nmt_state"} <= {publisher.topic for publisher in ros.publishers}
    assert list(ros.subscriptions) == ["/robot/io/tpdo"]


def test_a_drive_has_its_states_and_modes_besides(ros):
    made(ros, "Device", "left")
    services = {name.removeprefix("/robot/io/") for name in ros.services}
    assert services >= {*THEIRS, "init", "halt", "recover", "interpolated_position_mode", *MODES}


@pytest.mark.parametrize(
    ("service", "action", "mode"),
    [
        ("init", "enable", None),
        ("halt", "halt", None),
        ("recover", "fault-reset", None),
        ("position_mode", "mode", "PP"),
        ("velocity_mode", "mode", "PV"),
        ("cyclic_velocity_mode", "mode", "CSV"),
        ("cyclic_position_mode", "mode", "CSP"),
        ("interpolated_position_mode", "mode", "IP"),
    ],
)
def test_a_trigger_is_for_its_joint_alone_and_answers_with_an_empty_message(ros, service, action, mode):
    made(ros, "Device", "mirror")
    request, response = call(ros, service, answer=AxisDone())
    assert request == AxisRequest(node="left_drive", joint="mirror", action=action, mode=mode, source="ros")
    assert (response.success, response.message) == (True, "")
    _, response = call(ros, service, error="node 3 (left_drive) is not operational")
    assert (response.success, response.message) == (False, "node 3 (left_drive) is not operational")


@pytest.mark.parametrize(("service", "command"), [("nmt_reset_node", RESET), ("nmt_start_node", {"command": "start"})])
def test_nmt_is_of_the_whole_node(ros, service, command):
    made(ros, "Device", "mirror")
    request, response = call(ros, service)
    assert request == NmtRequest(node="left_drive", **command)
    assert (response.success, response.message) == (True, "")


def test_an_object_is_read_where_upstream_always_fails(ros):
    made(ros, "Proxy", "terminal")
    request, response = call(ros, "sdo_read", answer=SdoData(data=b"\x2a\x00"), index=0x6000, subindex=1)
    assert request == SdoRead(node="terminal", index=0x6000, subindex=1)
    assert (response.success, response.data) == (True, 42)


def test_tpdo_goes_out_in_the_rpdo_that_maps_the_object(ros):
    made(ros, "Proxy", "terminal")
    ros.publish("/robot/io/tpdo", interface("canopen_interfaces/msg/COData")(index=0x6200, subindex=1, data=5))
    ((request, _),) = ros.asked
    assert request == PdoWrite(node="terminal", index=0x6200, subindex=1, data=b"\x05")


def test_states_and_process_data_of_its_node_are_published(ros):
    endpoint = made(ros, "Proxy", "terminal")
    endpoint.on_state(StateSample(nodes={"terminal": NodeReading(node_id=9, nmt_state="OPERATIONAL")}))
    endpoint.on_process_data(
        {"terminal": [MappedValue(0x6000, 1, b"\x07")], "left_drive": [MappedValue(1, 1, b"\x00")]}
    )
    endpoint.on_event(RobotEvent(time=1.0, kind="emcy", node="terminal", level="error", text="no power"))
    reported = {publisher.topic: publisher.collected for publisher in ros.publishers}
    assert [item.data for item in reported["/robot/io/nmt_state"]] == ["START"]
    assert [(item.index, item.subindex, item.data) for item in reported["/robot/io/rpdo"]] == [(0x6000, 1, 7)]
    assert [item.status[0].message for item in reported["/robot/io/emcy"]] == ["no power"]


def test_a_joint_that_is_not_a_nodes_and_no_node_is_reported(ros):
    made(ros, "Proxy", "lift")
    assert ros.services == {}
    assert ros.collected == [
        "io has no topics: no node drives joint 'lift' or has this name; set `joint` to a joint or node of bus.yml"
    ]


def test_what_the_robot_cannot_report_is_reported(ros):
    endpoint = ProxyNode(ros, reading())
    endpoint.on_controller(reading())
    ros.asked.pop()[1](None, "the robot is gone")
    assert ros.collected == ["io has no topics: the robot is gone"]


def test_before_it_is_configured_nothing_is_asked_and_then_once(ros):
    endpoint = ProxyNode(ros, reading(joint=""))
    endpoint.on_controller(reading(joint="", state="unconfigured"))
    assert ros.asked == []
    endpoint.on_controller(reading(state="inactive"))
    endpoint.on_controller(reading())
    assert [request for request, _ in ros.asked] == [GetNodes()]


def test_one_that_was_unloaded_meanwhile_makes_nothing_and_one_that_leaves_leaves_all(ros):
    endpoint = ProxyNode(ros, reading())
    endpoint.on_controller(reading())
    endpoint.close()
    ros.asked.pop()[1](NODES, None)
    ros.asked.pop()[1](LAYOUT, None)
    assert ros.services == {}
    made(ros, "Proxy", "terminal").close()
    assert set(ros.services) <= set(ros.left)
    assert "/robot/io/tpdo" in ros.left
