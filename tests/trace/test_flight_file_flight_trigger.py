"""When a file is written, in simulated time."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.rpc.messages.state import RobotEvent
from canopen_control.trace.flight_file import AFTER_NS, GAP_NS, WIDEST_GAP_NS, RecordingTrigger, is_fault, is_sum

S = 1_000_000_000
KEEP = 50 * S


def event(text="", kind="fault", level="error", **more):
    return RobotEvent(time=1.0, kind=kind, node=None, level=level, text=text, **more)


@pytest.mark.parametrize(
    ("kind", "level", "expected"),
    [
        ("fault", "error", True),
        ("bus_bus_off", "warning", True),
        ("emcy", "warning", False),
        ("running", "info", False),
        ("", "", False),
    ],
)
def test_a_fault_is_an_error_or_a_bus_that_carries_nothing(kind, level, expected):
    assert is_fault(event(kind=kind, level=level)) is expected


@pytest.mark.parametrize(("since", "expected"), [(None, False), (1.0, False), (0.5, True)])
def test_a_sum_reports_of_more_than_its_own_moment(since, expected):
    assert is_sum(event(since=since)) is expected


def test_a_storm_makes_few_files_and_ever_fewer():
    trigger, written, end = RecordingTrigger(KEEP), [], 3600
    for tenth in range(end * 10):
        now = tenth * S // 10
        trigger.fault(event(str(tenth)), now)
        if trigger.due(now) is not None:
            written.append(now)
    gaps = [later - earlier for earlier, later in itertools.pairwise(written)]
    assert gaps[0] >= GAP_NS
    assert all(later >= min(1.9 * earlier, WIDEST_GAP_NS) for earlier, later in itertools.pairwise(gaps))
    assert len(written) <= 8
    assert trigger.left_out > 0


def test_a_fault_that_is_not_in_the_window_any_more_is_counted_instead():
    trigger = RecordingTrigger(KEEP)
    for start in (0, 34, 98, 222):
        trigger.fault(event(), start * S)
        assert trigger.due(start * S + AFTER_NS) is not None, start
    trigger.fault(event(), 230 * S)
    deadline = trigger.next_deadline()
    assert deadline > 230 * S + KEEP
    assert trigger.due(deadline) is None
    assert trigger.left_out == 1
    assert trigger.next_deadline() is None


def test_the_end_writes_what_still_waits_and_nothing_twice():
    trigger = RecordingTrigger(KEEP)
    assert trigger.end(0) is None
    trigger.fault(event("last"), S)
    assert trigger.end(S + 1) == event("last")
    assert trigger.end(S + 2) is None


@given(st.lists(st.integers(0, 100 * S), max_size=60))
def test_no_fault_is_discarded_it_is_written_waits_or_is_counted(pauses):
    trigger, now, last_file = RecordingTrigger(KEEP), 0, None
    for pause in pauses:
        now += pause
        if trigger.due(now) is not None:
            assert last_file is None or now - last_file >= GAP_NS
            last_file = now
        trigger.fault(event(), now)
        assert trigger.next_deadline() is not None
        assert trigger.next_deadline() <= max(now + AFTER_NS, (last_file or 0) + WIDEST_GAP_NS)
