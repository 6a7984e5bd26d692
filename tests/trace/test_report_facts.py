"""Facts of a report in the form for scripts."""

from canopen_control.rpc.messages.fault import FaultEvent
from canopen_control.rpc.messages.state import RobotEvent
from canopen_control.rpc.wire import plain
from canopen_control.trace.report_facts import Span, event_at


def test_a_span_has_the_stable_json_keys():
    assert plain(Span(1.0, 2.0, None)) == {"from": 1.0, "to": 2.0, "state": None}


def test_an_event_keeps_all_it_reports_and_gets_its_time_in_the_recording():
    event = RobotEvent(
        time=12.5, kind="emcy", node="left", level="warning", text="t", count=3, since=11.0,
        details=FaultEvent(error_code=0x8130),
    )  # fmt: skip
    assert plain(event_at(event, 10.0)) == {**plain(event), "at": 2.5}
