"""Choice of the mode for a command interface, by bus.yml, the modes of the drive, and its RPDOs."""

from dataclasses import replace

import pytest
from support.busalone import AloneBench, write_drives
from support.generic import write_generic
from support.peerfiles import write_peer_files
from support.robots import Bench, copy_robby

from canopen_control.cia402.modes import OperationMode
from canopen_control.errors import DriveError, RobotConfigError, UnsupportedMode
from canopen_control.hardware.axis_parameters import PLUGINS, add_plugin_interfaces, choose_mode, listed_modes
from canopen_control.hardware.axis_statechart import Action
from canopen_control.hardware.plugins import KNOWN, PluginKind
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
    return add_plugin_interfaces(parse_description(text, "x.urdf"), read_bus(files / "bus.yml").plans.values())


def interfaces(description):
    return {joint.name: list(joint.command_interfaces) for tag in description.hardware for joint in tag.joints}


def test_a_joint_without_any_has_those_that_an_rpdo_carries_and_a_note(files):
    result = completed(files)
    assert interfaces(result) == {"joint1": ["position"], "joint2": ["position"]}
    assert any("joint1 lists no command interface" in note and "x.urdf:26" in note for note in result.notes)


def test_a_joint_that_lists_some_has_those(files):
    own = '<command_interface name="velocity"/><state_interface name="position"/>'
    result = completed(files, ('<state_interface name="position"/>', own))
    assert interfaces(result) == {"joint1": ["velocity"], "joint2": ["velocity"]}
    assert result.notes == ()


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
    assert {KNOWN[plugin] for plugin in PLUGINS} == {PluginKind.CANOPEN}


@pytest.fixture
def bench(tmp_path):
    benches = []

    def make(config, **how):
        benches.append(Bench(f"choice{len(benches)}", config=config, **how))
        return benches[-1]

    yield make
    for benche in benches:
        benche.close()


def chosen(joint, interface):
    return choose_mode(joint.axis, joint.parameters, interface)


def test_cyclic_goes_before_profile_and_what_the_drive_reads_goes_before_its_eds(bench, tmp_path):
    servo = bench(write_generic(tmp_path), drives=(2, 3), controllers=["velocity"])
    joint = servo.joint(2)
    assert chosen(joint, "velocity") is OperationMode.CSV
    assert chosen(joint, "position") is OperationMode.CSP
    assert chosen(joint, "effort") is OperationMode.CST
    joint.parameters.values[0x6502, 0] = 1 << 0 | 1 << 1
    assert chosen(joint, "position") is OperationMode.PP
    assert chosen(joint, "velocity") is OperationMode.VL
    with pytest.raises(UnsupportedMode):
        chosen(joint, "effort")
    assert listed_modes(joint.axis, joint.parameters) == (OperationMode.PP, OperationMode.VL)


def test_the_target_of_a_mode_of_bus_yml_must_be_mapped(bench, tmp_path):
    robby = bench(str(copy_robby(tmp_path, bus={"  position_mode: 1\n": "  position_mode: 8\n"})))
    joint = robby.joint(3)
    assert chosen(joint, "position") is OperationMode.CSP
    joint.parameters.values[0x6502, 0] = 0x3FF
    object.__setattr__(joint.node.config.motion, "velocity_mode", 2)
    with pytest.raises(DriveError, match=r"no RPDO carries 0x6042:00, the target of mode VL"):
        chosen(joint, "velocity")


def test_a_list_of_nothing_reports_nothing_and_bus_yml_has_the_word(bench, tmp_path):
    servo = bench(write_generic(tmp_path, modes="velocity_mode: 3"), drives=(2, 3), controllers=["velocity"])
    joint = servo.joint(2)
    joint.parameters.values[0x6502, 0] = 0
    assert chosen(joint, "position") is OperationMode.CSP  # by the EDS
    eds = joint.node.od.entries
    eds[0x6502, 0] = replace(eds[0x6502, 0], default=None)
    assert listed_modes(joint.axis, joint.parameters) == ()
    assert chosen(joint, "velocity") is OperationMode.PV
    assert chosen(joint, "position") is OperationMode.PP
    joint.parameters.values[0x6502, 0] = 0x3EF  # the connected drive takes precedence
    assert chosen(joint, "position") is OperationMode.CSP


def test_an_interface_that_nothing_serves_is_an_error_of_the_description(bench, tmp_path):
    config = copy_robby(
        tmp_path, description={'<command_interface name="velocity"/>': '<command_interface name="colour"/>'}
    )
    with pytest.raises(RobotConfigError, match="no command interface 'colour'"):
        bench(config)


def test_outputs_must_be_mapped(bench, tmp_path):
    new = '<command_interface name="velocity"/><command_interface name="digital_outputs"/>'
    config = copy_robby(tmp_path, description={'<command_interface name="velocity"/>': new})
    with pytest.raises(RobotConfigError, match="0x60FE"):
        bench(config)


@pytest.mark.rest
def test_a_target_begins_with_a_mode_in_which_the_drive_makes_the_ramp_or_with_that_of_bus_yml(tmp_path):
    for number, (modes, first) in enumerate([("", "PP"), ("velocity_mode: 9", "CSV"), ("effort_mode: 4", "TQ")]):
        folder = tmp_path / str(number)
        folder.mkdir()
        drives = AloneBench(f"firstmode{number}", config=write_drives(folder, modes=modes), drives=(2, 3))
        drives.start()
        assert drives.joint(2).targets.mode is None  # a claim alone asks for nothing
        drives.enable("drive_one")
        assert drives.joint(2).targets.mode is OperationMode[first]
        drives.close()


def test_a_mode_without_a_target_or_without_an_rpdo_is_refused_where_targets_are_given(tmp_path):
    config = write_drives(tmp_path)
    bus = config / "bus.yml"
    bus.write_text(bus.read_text().replace("{index: 0x6071}, ", ""))
    drives = AloneBench("nomode", config=config, drives=(2, 3))
    drives.start()
    for mode, words in (("HM", "has no target"), ("CST", "0x6071")):
        assert words in drives.axis(Action.MODE, "drive_one", mode=mode)
    drives.mode("CSV")
    drives.close()
