"""Choice of the SYNC producer by default and by setting, and the notes for the user."""

import pytest
from support.arm6 import copy_arm
from support.robots import copy_robby

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.cia402.modes import OperationMode
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.runtime.sync_choice import SyncSender, cyclic_axes, joint_words

KERNEL, PROGRAM, NODE, NOBODY = SyncSender.KERNEL, SyncSender.PROGRAM, SyncSender.NODE, SyncSender.NONE


def setup_of(config, channel="can0", **how):
    return read_robot(find_robot(str(config)), can=[channel], **how)


def arm(folder, *edits):
    config = copy_arm(folder)
    path = config / "bus.yml"
    text = path.read_text()
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new)
    path.write_text(text)
    return config


def key(words):
    return "sync_period: 20000", f"sync_period: 20000\n  {words}"


UNWATCHED = ("heartbeat_consumer: true ", "heartbeat_consumer: false\n  allow_unsupervised: true ")


@pytest.mark.parametrize(
    ("edits", "channel", "sender", "why"),
    [
        ([], "can0", KERNEL, "joint_1, joint_2, joint_3 and 3 more time their motion by SYNC"),
        ([], "vcan0", KERNEL, "joint_1, joint_2, joint_3 and 3 more time their motion by SYNC"),
        ([], "local:arm", PROGRAM, "on SocketCAN interfaces alone, and local:arm is none"),
        ([], "pcan:PCAN_USBBUS1", PROGRAM, "on SocketCAN interfaces alone, and pcan:PCAN_USBBUS1 is none"),
        ([key("sync_order: first")], "can0", KERNEL, "time their motion"),
        ([key("sync_order: last")], "can0", PROGRAM, "sync_order: last"),
        ([key("sync_producer: master")], "can0", PROGRAM, "sync_producer: master"),
        ([key("sync_producer: kernel\n  sync_order: last")], "can0", KERNEL, "sync_producer: kernel"),
        ([key("sync_producer: kernel")], "local:arm", PROGRAM, "on SocketCAN interfaces alone"),
        ([key("sync_producer: other")], "can0", NODE, "sync_producer: other"),
        ([UNWATCHED], "can0", PROGRAM, "nothing would stop joint_1_drive"),
        ([("position_mode: 8", "position_mode: 1")], "can0", PROGRAM, "no joint is commanded in CSP or CSV"),
    ],
)
def test_for_drives_in_csp_the_kernel_sends_sync_by_default_if_it_can(tmp_path, edits, channel, sender, why):
    choice = setup_of(arm(tmp_path, *edits), channel).sync["can"]
    assert choice.sender is sender
    assert why in choice.why
    assert choice.why in choice.words


def test_wheels_in_profile_velocity_and_a_bus_without_sync_are_as_they_were(tmp_path):
    wheels = setup_of(copy_robby(tmp_path))
    assert wheels.sync["can"].sender is PROGRAM
    assert list(wheels.sync_notes) == []
    silent = copy_robby(tmp_path / "silent", bus={"sync_period: 20000": "sync_period: 0"})
    choice = setup_of(silent).sync["can"]
    assert (choice.sender, choice.words, choice.hint) == (NOBODY, "no device sends SYNC", "")


@pytest.mark.parametrize(
    ("edits", "part"),
    [
        ([], 8),
        ([key("sync_producer: kernel\n  sync_order: last")], 2),
        ([key("sync_producer: other")], 8),
        ([key("sync_order: last")], 2),
    ],
)
def test_behind_the_sync_of_others_an_eighth_of_a_period_is_the_default_which_leaves_seven_to_be_late_in(
    tmp_path, edits, part
):
    setup = setup_of(arm(tmp_path, *edits))
    assert setup.phase_ns == setup.cycle_ns // part


def test_it_is_reported_that_the_kernel_sends_and_what_a_late_process_does_to_real_drives(tmp_path):
    config = arm(tmp_path)
    (reported,) = setup_of(config).sync_notes
    assert reported.startswith("SYNC is sent by the kernel, and the cycle follows it: joint_1, joint_2")
    (hint,) = setup_of(config, "pcan:PCAN_USBBUS1").sync_notes
    assert hint.startswith("SYNC comes from this program: the kernel can send it on SocketCAN interfaces alone")
    assert "joint_1, joint_2, joint_3 and 3 more time their motion by it and jerk when it is late" in hint
    assert "sync_producer: other" in hint
    assert "--realtime" in hint
    assert list(setup_of(config, "local:arm").sync_notes) == [], "no motor is there to be heard"
    assert list(setup_of(config, mock=True).sync_notes) == []


def test_check_reports_the_sync_producer_of_each_bus_and_the_reason(tmp_path):
    report = check_robot(find_robot(str(arm(tmp_path))), CheckOptions(can=["local:arm"]))
    assert report.sync == {
        "can": "SYNC every 20 ms, after the RPDOs of its cycle (sync_order: last); SYNC comes from this program: the "
        "kernel can send it on SocketCAN interfaces alone, and local:arm is none"
    }
    there_is_none = check_robot(find_robot(str(arm(tmp_path / "b"))), CheckOptions(can=["can99"]))
    assert "can99" in there_is_none.sync["can"]
    assert "kernel" in there_is_none.sync["can"]
    assert "after the RPDOs of its cycle" in there_is_none.sync["can"], "what holds here, where it is not to be had"


# Joints of a robot's files in a cyclic synchronous mode: by key, and by the modes in the EDS.


def axes_of(config):
    setup = read_robot(find_robot(str(config)))
    return cyclic_axes(setup.bus, setup.description)


@pytest.mark.rest
def test_the_joints_of_an_arm_are_in_csp_by_the_key_or_where_the_eds_lists_it(tmp_path):
    config = copy_arm(tmp_path)
    axes = axes_of(config)
    assert [(axis.joint, axis.node.node_id, axis.mode, axis.target) for axis in axes[:2]] == [
        ("joint_1", 2, OperationMode.CSP, 0x607A),
        ("joint_2", 3, OperationMode.CSP, 0x607A),
    ]
    path = config / "bus.yml"
    text = path.read_text()
    path.write_text(text.replace("  position_mode: 8  ", "  #"))
    assert len(axes_of(config)) == 6, "it is the first of the modes that the EDS lists"
    path.write_text(text.replace("position_mode: 8", "position_mode: 1"))
    assert axes_of(config) == []


def test_wheels_in_profile_velocity_are_none(tmp_path):
    assert axes_of(copy_robby(tmp_path)) == []


@pytest.mark.parametrize(
    ("count", "words"),
    [(1, "joint_1"), (3, "joint_1, joint_2, joint_3"), (6, "joint_1, joint_2, joint_3 and 3 more"), (0, "")],
)
def test_many_joints_are_named_by_the_first(tmp_path, count, words):
    assert joint_words(axes_of(copy_arm(tmp_path))[:count]) == words
