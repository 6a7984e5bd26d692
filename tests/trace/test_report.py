"""The facts of a report, from a robot whose drive loses power."""

import json

import pytest

from canopen_control.frame import CanFrame
from canopen_control.trace.flight_file import FlightFile
from canopen_control.trace.network import NetworkDescription
from canopen_control.trace.report import facts_of, networks_of


def test_what_went_wrong_first_is_found_and_named(lost_drive):
    facts = facts_of(lost_drive)
    assert facts["fault"]["node"] == "left_drive"
    assert 1.9 < facts["fault"]["at"] < 3.0
    assert "left_drive" in facts["summary"][1]
    assert facts["last_state"] == "fault"


def test_a_run_in_which_nothing_goes_wrong_has_no_fault(calm_run):
    facts = facts_of(calm_run)
    assert facts["fault"] is None
    assert "Nothing was reported" in facts["summary"][1]
    assert facts["stopped_after_s"] == {}


def test_states_of_the_drives_come_from_the_frames_by_joint(lost_drive):
    nodes = facts_of(lost_drive)["nodes"]
    left = nodes["left_drive"]["axes"]["left_wheel_joint"]
    assert [span["state"] for span in left] == ["OPERATION_ENABLED", None]
    assert 1.9 < left[0]["to"] < 2.1
    right = [span["state"] for span in nodes["right_drive"]["axes"]["right_wheel_joint"]]
    assert right[0] == "OPERATION_ENABLED"
    assert right[-1] == "SWITCH_ON_DISABLED"
    sampled = facts_of(FlightFile(lost_drive.meta, lost_drive.events, lost_drive.states))["nodes"]
    assert sampled["left_drive"]["axes"]["left_wheel_joint"][0]["state"] == "OPERATION_ENABLED"
    assert len(right) >= len(sampled["right_drive"]["axes"]["right_wheel_joint"])


def test_the_eds_files_in_the_recording_name_the_objects(lost_drive):
    for node in lost_drive.meta["layout"]["buses"]["can"]["nodes"]:
        node["eds"] = "/gone/" + node["eds"].rsplit("/", 1)[-1]
    network = networks_of(lost_drive)["can"]
    assert network.notes == ()
    assert network.nodes[3].od.device.product_name
    lost_drive.eds = {}
    assert len(networks_of(lost_drive)["can"].notes) == 2
    assert "no names" in " ".join(facts_of(lost_drive)["summary"])


def test_facts_are_plain_data(lost_drive):
    facts = facts_of(lost_drive)
    assert json.loads(json.dumps(facts)) == facts


def test_the_reason_of_the_file_is_the_fault_where_the_window_holds_none(calm_run):
    reason = {"time": calm_run.states[-1]["time"], "kind": "died", "level": "error", "node": None, "text": "it died"}
    calm_run.meta["reason"] = reason
    assert facts_of(calm_run)["fault"]["text"] == "it died"


def test_what_is_missing_is_said(calm_run):
    calm_run.meta.update(unheard=["arm"], frames_lost=7, unread_lines=2, faults_left_out=3)
    said = " ".join(facts_of(calm_run)["summary"])
    for words in ("Not listened to: arm", "7 frames were lost", "2 lines", "3 earlier faults"):
        assert words in said


def test_frames_alone_make_a_report(lost_drive):
    facts = facts_of(FlightFile({"buses": {"can": "run.log"}}, frames=lost_drive.frames), networks_of(lost_drive))
    assert facts["nodes"]["right_drive"]["axes"]["axis 0"]
    assert facts["buses"]["can"]["frames"] == len(lost_drive.frames)
    unnamed = facts_of(FlightFile({}, frames=lost_drive.frames), {"can": NetworkDescription()})
    assert "node 3" in unnamed["nodes"]


@pytest.mark.parametrize("file", [FlightFile({}), FlightFile({"written": 5.0, "robot": "x"})])
def test_an_empty_recording_makes_an_empty_report(file):
    facts = facts_of(file)
    assert facts["seconds"] == 0
    assert "no node was seen" in facts["summary"][0]


def test_where_nobody_told_events_the_first_emcy_is_the_fault(lost_drive):
    times = [time for time, _, _ in lost_drive.frames]
    emcy = (times[500], "can", CanFrame(0x83, bytes.fromhex("3081110000000000")))
    frames = [*lost_drive.frames[:501], emcy, (times[501], "can", emcy[2]), *lost_drive.frames[501:]]
    facts = facts_of(FlightFile({}, frames=frames), networks_of(lost_drive))
    assert facts["fault"]["kind"] == "emcy"
    assert facts["fault"]["node"] == "left_drive"
    assert "0x8130" in facts["summary"][1]
    assert sum("0x8130" in event["text"] for event in facts["events"]) == 1


def test_without_eds_files_in_it_those_of_this_machine_are_read(calm_run):
    calm_run.eds = {}
    assert networks_of(calm_run)["can"].notes == ()
