"""What ros2_canopen's plugins export beside what the description lists."""

import pytest
from support.peerfiles import write_peer_files

from canopen_control.hardware.mode_choice import PLUGINS, with_interfaces_of_plugins
from canopen_control.hardware.plugins import KNOWN, Kind
from canopen_control.master.config import read_bus
from canopen_control.urdf.description import parse_description


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_peer_files(tmp_path_factory.mktemp("peer"), "robot_control")


def completed(files, *edits):
    text = (files / "robot_control.urdf").read_text()
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    return with_interfaces_of_plugins(parse_description(text, "x.urdf"), read_bus(files / "bus.yml").plans.values())


def interfaces(description):
    return {joint.name: list(joint.command_interfaces) for tag in description.hardware for joint in tag.joints}


def test_a_joint_without_any_has_those_that_an_rpdo_carries_and_a_note(files):
    found = completed(files)
    assert interfaces(found) == {"joint1": ["position"], "joint2": ["position"]}
    assert any("joint1 lists no command interface" in each and "x.urdf:26" in each for each in found.notes)


def test_a_joint_that_lists_some_has_those(files):
    own = '<command_interface name="velocity"/><state_interface name="position"/>'
    found = completed(files, ('<state_interface name="position"/>', own))
    assert interfaces(found) == {"joint1": ["velocity"], "joint2": ["velocity"]}
    assert found.notes == ()


@pytest.mark.parametrize(
    "edit",
    [
        ("canopen_ros2_control/Cia402RobotSystem", "canopen_control/CanopenSystem"),
        ('<param name="node_id">', '<param name="node_id">9'),
        ('<param name="node_id">', '<param name="axis">1</param><param name="node_id">'),
    ],
)
def test_another_plugin_an_unknown_node_and_an_unmapped_axis_are_left_as_they_are(files, edit):
    assert interfaces(completed(files, edit)) == {"joint1": [], "joint2": []}


def test_every_plugin_is_one_that_runs_here():
    assert {KNOWN[each] for each in PLUGINS} == {Kind.CANOPEN}
