from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.ros.nodes import NMT_STATES, NodeView, nodes_of, resolve, ros_name


def only(bridges="/", /, **told):
    (node,) = nodes_of({"nodes": [{"name": "left_drive", "node_id": 3, **told}]}, bridges)
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


def test_what_the_runtime_does_not_tell_has_defaults():
    assert nodes_of({}, "/") == []
    assert only() == NodeView("left_drive", 3, "/")


def test_private_names_are_below_the_node():
    assert resolve("/a", "~/x", "n") == "/a/n/x"
    assert resolve("", "x") == "/x"


def test_every_nmt_state_has_a_word():
    assert set(NMT_STATES) == {"INITIALISING", "PRE_OPERATIONAL", "OPERATIONAL", "STOPPED", None}


@given(st.text(min_size=1))
def test_any_name_becomes_one_that_ros_allows(name):
    made = ros_name(name)
    assert made.isascii()
    assert made.isidentifier()
