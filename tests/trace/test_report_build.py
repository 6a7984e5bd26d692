"""The facts of a report, from a robot whose drive loses power."""

import pytest
from msgspec.structs import replace

from canopen_control.frame import CanFrame
from canopen_control.rpc.messages.layout import Layout
from canopen_control.rpc.messages.state import RobotEvent
from canopen_control.rpc.wire import plain
from canopen_control.trace.flight_file import NO_FAULT, FlightFile, FlightMeta
from canopen_control.trace.network_description import NetworkDescription
from canopen_control.trace.report_build import facts_of, networks_of

EMPTY = FlightMeta(robot="", reason=NO_FAULT)


@pytest.mark.rest
def test_what_went_wrong_first_is_found_and_named(lost_drive):
    facts = facts_of(lost_drive)
    assert facts.fault.node == "left_drive"
    assert 1.9 < facts.fault.at < 3.0
    assert "left_drive" in facts.summary[1]
    assert facts.last_state == "fault"


def test_a_run_in_which_nothing_goes_wrong_has_no_fault(calm_run):
    facts = facts_of(calm_run)
    assert facts.fault is None
    assert "Nothing was reported" in facts.summary[1]
    assert facts.stopped_after_s == {}


def test_states_of_the_drives_come_from_the_frames_by_joint(lost_drive):
    nodes = facts_of(lost_drive).nodes
    left = nodes["left_drive"].axes["left_wheel_joint"]
    assert [span.state for span in left] == ["OPERATION_ENABLED", None]
    assert 1.9 < left[0].end < 2.1
    right = [span.state for span in nodes["right_drive"].axes["right_wheel_joint"]]
    assert right[0] == "OPERATION_ENABLED"
    assert right[-1] == "SWITCH_ON_DISABLED"
    sampled = facts_of(FlightFile(lost_drive.meta, lost_drive.events, lost_drive.states)).nodes
    assert sampled["left_drive"].axes["left_wheel_joint"][0].state == "OPERATION_ENABLED"
    assert len(right) >= len(sampled["right_drive"].axes["right_wheel_joint"])


def test_the_eds_files_in_the_recording_name_the_objects(lost_drive):
    bus = lost_drive.meta.layout.buses["can"]
    nodes = tuple(replace(node, eds="/gone/" + node.eds.rsplit("/", 1)[-1]) for node in bus.nodes)
    lost_drive.meta = replace(lost_drive.meta, layout=Layout({"can": replace(bus, nodes=nodes)}))
    network = networks_of(lost_drive)["can"]
    assert network.notes == ()
    assert network.nodes[3].od.device.product_name
    lost_drive.eds = {}
    assert len(networks_of(lost_drive)["can"].notes) == 2
    assert "no names" in " ".join(facts_of(lost_drive).summary)


def test_facts_are_printed_with_the_keys_that_scripts_know(lost_drive):
    facts = plain(facts_of(lost_drive))
    assert " ".join(facts) == (
        "summary robot begin end seconds channels fault events nodes joints stopped_after_s last_state cycle boot sdo "
        "buses frames last_words gaps measured true_pose"
    )
    assert set(facts["joints"]["left_wheel_joint"]) == set(
        "quantity time command actual error position velocity effort tracking".split()  # noqa: SIM905 - one line
    )
    assert list(facts["nodes"]["left_drive"]["axes"]["left_wheel_joint"][0]) == ["from", "to", "state"]
    assert facts["buses"]["can"]["load"]["value"]
    assert facts["fault"] in facts["events"]
    assert facts["cycle"]["late_counts"]
    assert plain(facts_of(FlightFile(EMPTY)))["cycle"] is None


def test_the_reason_of_the_file_is_the_fault_where_the_window_holds_none(calm_run):
    died = calm_run.states[-1].time
    reason = RobotEvent(time=died, kind="died", level="error", node=None, text="it died")
    calm_run.meta = replace(calm_run.meta, reason=reason)
    assert facts_of(calm_run).fault.text == "it died"


def test_what_is_missing_is_said(calm_run):
    calm_run.meta = replace(calm_run.meta, unheard=("arm",), frames_lost=7, faults_left_out=3)
    calm_run.unread_lines = 2
    said = " ".join(facts_of(calm_run).summary)
    for words in ("Not listened to: arm", "7 frames were lost", "2 lines", "3 earlier faults"):
        assert words in said


def test_frames_alone_make_a_report(lost_drive):
    facts = facts_of(
        FlightFile(replace(EMPTY, buses={"can": "run.log"}), frames=lost_drive.frames), networks_of(lost_drive)
    )
    assert facts.nodes["right_drive"].axes["axis 0"]
    assert facts.buses["can"].frames == len(lost_drive.frames)
    unnamed = facts_of(FlightFile(EMPTY, frames=lost_drive.frames), {"can": NetworkDescription()})
    assert "node 3" in unnamed.nodes


@pytest.mark.parametrize("file", [FlightFile(EMPTY), FlightFile(replace(EMPTY, written=5.0, robot="x"))])
def test_an_empty_recording_makes_an_empty_report(file):
    facts = facts_of(file)
    assert facts.seconds == 0
    assert "no node was seen" in facts.summary[0]


def test_where_nobody_told_events_the_first_emcy_is_the_fault(lost_drive):
    times = [time for time, _, _ in lost_drive.frames]
    emcy = (times[500], "can", CanFrame(0x83, bytes.fromhex("3081110000000000")))
    frames = [*lost_drive.frames[:501], emcy, (times[501], "can", emcy[2]), *lost_drive.frames[501:]]
    facts = facts_of(FlightFile(EMPTY, frames=frames), networks_of(lost_drive))
    assert facts.fault.kind == "emcy"
    assert facts.fault.node == "left_drive"
    assert "0x8130" in facts.summary[1]
    assert sum("0x8130" in event.text for event in facts.events) == 1


def test_without_eds_files_in_it_those_of_this_machine_are_read(calm_run):
    calm_run.eds = {}
    assert networks_of(calm_run)["can"].notes == ()
