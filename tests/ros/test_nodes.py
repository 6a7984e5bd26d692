from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.ros.nodes import RosNode, nodes_of, resolve, ros_name
from canopen_control.rpc.messages.layout import BusLayout, Layout, MappedEntry, NodeLayout, PdoLayout
from canopen_control.rpc.messages.robot import NodeListing, NodePlace
from canopen_control.rpc.messages.state import AxisReading, NodeReading


def only(bridges="/", /, **reported):
    (node,) = nodes_of(NodeListing(nodes=[NodePlace(name="left_drive", node_id=3, **reported)]), bridges)
    return node


def test_a_node_has_its_names_below_the_namespace_of_the_bridge():
    assert only().path("init") == "/left_drive/init"
    assert only("/robot").path("init") == "/robot/left_drive/init"


def test_its_own_namespace_of_bus_yml_wins():
    assert only("/robot", namespace="/test1").path("init") == "/test1/left_drive/init"
    assert only("/robot", namespace="test1").path("") == "/test1/left_drive"


@pytest.mark.parametrize("old", ["~/joint_states", "left_drive/joint_states", "/left_drive/joint_states"])
def test_remappings_of_bus_yml_are_followed_however_the_name_is_written(old):
    assert only(remappings={old: "wheels"}).path("joint_states") == "/wheels"
    assert only(remappings={old: "wheels"}).path("nmt_state") == "/left_drive/nmt_state"


def test_a_lifecycle_driver_is_known_by_its_name():
    assert only(driver="ros2_canopen::LifecycleCia402Driver").lifecycle
    assert not only(driver="ros2_canopen::Cia402Driver").lifecycle


def test_what_the_runtime_does_not_report_has_defaults():
    assert nodes_of(NodeListing(), "/") == []
    assert only() == RosNode("left_drive", 3, "/")


def two_axes(**reported):
    states = {"arm": NodeReading(name="arm", node_id=5, axes=(AxisReading("shoulder", 0), AxisReading("elbow", 1)))}
    (node,) = nodes_of(NodeListing(nodes=[NodePlace(name="arm", node_id=5, **reported)]), "/robot", None, states)
    return node


def test_each_axis_of_a_node_with_several_has_its_names_below_its_channel():
    node = two_axes(remappings={"arm/elbow/halt": "/stop"})
    assert [channel.joint for channel in node.channels] == ["shoulder", "elbow"]
    assert [node.path("halt", channel) for channel in node.channels] == ["/robot/arm/shoulder/halt", "/stop"]
    assert node.path("halt") == "/robot/arm/halt"


def test_what_the_rpdos_map_comes_from_the_layout():
    outputs, word = MappedEntry(0x60FE, 1, 32, "UNSIGNED32"), MappedEntry(0x6041, 0, 16, "UNSIGNED16")
    pdos = (PdoLayout(0x203, "rpdo", 1, objects=(outputs,)), PdoLayout(0x183, "tpdo", 1, objects=(word,)))
    layout = Layout({"can": BusLayout("local:x", 1_000_000, nodes=(NodeLayout("left_drive", 3, "", pdos),))})
    (node,) = nodes_of(NodeListing(nodes=[NodePlace(name="left_drive", node_id=3)]), "/", layout)
    assert node.rpdo == {(0x60FE, 1): 32}


def test_private_names_are_below_the_node():
    assert resolve("/a", "~/x", "n") == "/a/n/x"
    assert resolve("", "x") == "/x"


@given(st.text(min_size=1))
def test_any_name_becomes_one_that_ros_allows(name):
    created = ros_name(name)
    assert created.isascii()
    assert created.isidentifier()


def test_a_node_that_moves_nothing_is_a_proxy_and_may_be_a_drive_all_the_same():
    assert (only().joints, only().is_drive) == ((), False)
    assert only(axes=1).is_drive
    assert only(joints=["left_wheel_joint"]).joints == ("left_wheel_joint",)
    assert two_axes().joints == ("shoulder", "elbow")
