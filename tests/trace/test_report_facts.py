"""Facts of a report in the form for scripts."""

from msgspec.structs import replace

from canopen_control.rpc.messages.fault import FaultEvent
from canopen_control.rpc.messages.state import RobotEvent, TrackingReading, TruePose
from canopen_control.rpc.wire import plain
from canopen_control.trace.report_build import facts_of
from canopen_control.trace.report_facts import Span, event_at, summary


def test_a_span_has_the_stable_json_keys():
    assert plain(Span(1.0, 2.0, None)) == {"from": 1.0, "to": 2.0, "state": None}


def test_an_event_keeps_all_it_reports_and_gets_its_time_in_the_recording():
    event = RobotEvent(
        time=12.5, kind="emcy", node="left", level="warning", text="t", count=3, since=11.0,
        details=FaultEvent(error_code=0x8130),
    )  # fmt: skip
    assert plain(event_at(event, 10.0)) == {**plain(event), "at": 2.5}


# The first lines of a report.


def test_the_first_lines_name_robot_drives_and_the_fault(lost_drive):
    text = facts_of(lost_drive).summary
    assert text[0].startswith("robby: 4.0 s up to ")
    assert "left_drive (node 3), right_drive (node 2)" in text[0]
    assert text[1].startswith("First error, 2.")
    assert "left_drive" in text[1]
    assert any(line.startswith("right_wheel_joint stopped") for line in text)
    assert "left_wheel_joint did not stop in the recording." in text
    assert all(line.endswith((".", "?")) for line in text)


def test_a_storm_is_counted_instead_of_listed(lost_drive):
    fault = facts_of(lost_drive).fault
    lost_drive.events += [
        RobotEvent(time=fault.time + n, kind="x", node=None, level="error", text=f"more {n}") for n in range(20)
    ]
    message = facts_of(lost_drive).summary
    assert len(message) < 15
    assert any("more errors followed" in line for line in message)


def test_hardware_that_is_made_up_is_called_that(calm_run):
    calm_run.states = [replace(sample, nodes={}) for sample in calm_run.states]
    calm_run.frames, calm_run.meta = [], replace(calm_run.meta, buses={})
    assert "no bus, simulated hardware: left_wheel_joint, right_wheel_joint" in facts_of(calm_run).summary[0]


def test_the_joint_that_was_furthest_off_and_odd_set_points_are_reported(calm_run):
    facts = facts_of(calm_run)
    assert any(line.startswith("Largest velocity tracking error: ") for line in summary(facts))
    first, second = list(facts.joints)[:2]
    near = TrackingReading(interface="velocity", error_max_since_enable=0.1, error_rms_since_enable=0.01)
    far = TrackingReading(interface="velocity", error_max_since_enable=0.5, error_rms_since_enable=0.02, skipped=3)
    joints = {first: replace(facts.joints[first], tracking=near), second: replace(facts.joints[second], tracking=far)}
    text = summary(replace(facts, joints=joints))
    assert f"Largest velocity tracking error: {second}, 0.5 rad/s, RMS 0.02." in text
    assert f"Set-points that were repeated, and skipped, while a joint moved: {second} 0 and 3." in text


def test_the_true_pose_of_a_simulated_base_is_reported_as_it_was_in_the_end(calm_run):
    assert facts_of(calm_run).true_pose is None
    truth = TruePose(time=1.0, x=1.0, y=0.5, heading=0.0, error=(0.003, 0.004, 0.0))
    calm_run.states[-1] = replace(calm_run.states[-1], true_pose=truth)
    text = "At the end: true pose 1.000, 0.500 m, 0.0 deg; odometry is off by 5.0 mm and 0.00 deg."
    assert text in facts_of(calm_run).summary


def test_a_node_without_a_name_is_named_once(calm_run):
    facts = facts_of(calm_run)
    unknown = replace(facts, nodes={f"node {node.node_id}": node for node in facts.nodes.values()})
    assert "; node 2, node 3." in summary(unknown)[0] or "; node 3, node 2." in summary(unknown)[0]


def test_one_error_more_is_counted_as_one(lost_drive):
    fault = facts_of(lost_drive).fault
    events = lost_drive.events
    shown = 0
    for n in range(20):
        message = facts_of(lost_drive).summary
        if any("followed" in line for line in message):
            break
        events.append(RobotEvent(time=fault.time + n, kind="x", node=None, level="error", text=f"more {n}"))
        shown = n
    assert any(line == "1 more error followed; it is in the list of events." for line in message), (shown, message)
