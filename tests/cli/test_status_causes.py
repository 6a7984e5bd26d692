"""What `status` makes of the events of a robot; the sentences are those of real runs."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.cli.status import tell_causes
from canopen_control.rpc.messages.state import RobotEvent

LEFT = "node 3 (left_drive)"
RIGHT = "node 2 (right_drive)"
SILENT = "no heartbeat for 0.506 s; is it powered and connected?"
HOT = "EMCY 0x4310 (drive temperature too high)"
BOTH = "stopping left_wheel_joint, right_wheel_joint"


def event(at, kind, text, level="error"):
    return RobotEvent(time=at, kind=kind, node=None, level=level, text=text)


def drive_fault(at):
    return [
        event(at, "emcy", f"{LEFT}: {HOT}, register 0x09, data 00 00 00 00 00", "warning"),
        event(at + 0.02, "fault", f"{LEFT}: fault (statusword 0x0618) while enabled; {HOT}"),
        event(at + 0.02, "stop", f"{BOTH}: {LEFT}: fault (statusword 0x0618) while enabled"),
    ]


FAULT_LINE = (
    f"error: {LEFT}: {HOT}, register 0x09, data 00 00 00 00 00; fault (statusword 0x0618) while enabled; {BOTH}"
)


def loss(at):
    return [
        event(at, "heartbeat_lost", f"{RIGHT}: {SILENT}"),
        event(at, "node_lost", f"{RIGHT}: lost: {SILENT}"),
        event(at, "stop", f"{BOTH}: {RIGHT}: lost: {SILENT}"),
    ]


def test_a_fault_its_emergency_message_and_its_stop_are_one_line():
    assert tell_causes(drive_fault(10.0), {}) == [FAULT_LINE]


def test_a_lost_node_is_one_line():
    assert tell_causes(loss(10.0), {}) == [f"error: {RIGHT}: {SILENT}; {BOTH}"]


def test_what_stands_above_as_the_error_of_the_node_is_not_told_again():
    assert tell_causes(loss(10.0)[:2], {"right_drive": f"{RIGHT}: {SILENT}"}) == []
    assert tell_causes(loss(10.0), {"right_drive": f"{RIGHT}: {SILENT}"}) == [f"error: {RIGHT}: {BOTH}"]
    assert tell_causes(loss(10.0)[:2], {"left_drive": f"{LEFT}: {SILENT}"}) == [f"error: {RIGHT}: {SILENT}"]


def test_what_comes_again_is_counted_with_its_times():
    lines = tell_causes([*drive_fault(0.0), *drive_fault(60.0), *drive_fault(120.0)], {})
    assert len(lines) == 1
    assert lines[0].startswith(f"{FAULT_LINE} (3 times, ")
    assert lines[0].endswith(":02:00)")


def test_what_comes_again_at_once_is_counted_too():
    again = [event(at, "error_passive", "bus can (local:robby): error-passive; check", "warning") for at in (1, 1.5)]
    (line,) = tell_causes(again, {})
    assert line.startswith("warning: bus can (local:robby): error-passive; check (2 times, ")


def test_two_nodes_and_two_times_are_two_causes():
    other = event(10.0, "heartbeat_lost", f"{LEFT}: {SILENT}")
    assert len(tell_causes([*loss(10.0), other], {})) == 2
    late = event(20.0, "fault", f"{LEFT}: fault (statusword 0x0618); {HOT}")
    assert len(tell_causes([*drive_fault(10.0), late], {})) == 2


def test_each_axis_of_a_node_that_tells_the_same_in_one_cycle_is_told_once():
    assert tell_causes([event(5.0, "node_lost", f"{LEFT}: lost: {SILENT}")] * 6, {}) == [f"error: {LEFT}: {SILENT}"]


def test_infos_are_left_out_and_other_sentences_stay_as_they_are():
    events = [
        event(1.0, "running", "robby runs", "info"),
        event(2.0, "client_dropped", "client x (pid 7) read too slowly"),
    ]
    assert tell_causes(events, {}) == ["error: client x (pid 7) read too slowly"]


WORDS = [f"{LEFT}: {HOT}", f"{LEFT}: fault; {HOT}", f"{RIGHT}: {SILENT}", f"{BOTH}: {LEFT}: fault", "a: b; c", "c"]


@pytest.mark.rest
@given(st.lists(st.tuples(st.floats(0, 100), st.sampled_from("abc"), st.sampled_from(WORDS)), max_size=12))
def test_whatever_happens_every_clause_is_told_and_no_line_twice(told):
    events = [event(at, kind, text) for at, kind, text in sorted(told)]
    lines = tell_causes(events, {})
    assert len(lines) == len(set(lines))
    for each in events:
        for clause in each.text.rpartition("): ")[2].split("; "):
            assert any(clause in line for line in lines)


@pytest.mark.parametrize("events", [drive_fault(1.0), loss(1.0)])
def test_no_clause_stands_twice_in_a_line(events):
    (line,) = tell_causes(events, {})
    clauses = line.split("; ")
    assert len(clauses) == len(set(clauses))
