"""Recorded error frames of real controllers become events with a sentence."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus.error_events import events_of, note_errors
from canopen_control.bus.error_frames import overrun_frame, protocol_error_frame
from canopen_control.bus.port import BusEventKind, PortStats
from canopen_control.frame import CanFrame, pack_records

# As candump -e prints them: identifier with flags, data.
RECORDED = [
    ("20000204", "0008000000006000", [], "warning level only"),
    ("20000204", "0020000000008000", [BusEventKind.ERROR_PASSIVE], "transmit error-passive, counter 128"),
    ("20000204", "0010000000000088", [BusEventKind.ERROR_PASSIVE], "receive error-passive"),
    ("20000004", "0040000000000000", [BusEventKind.ERROR_ACTIVE], "back to error-active"),
    ("20000040", "0000000000000000", [BusEventKind.BUS_OFF], "bus-off"),
    ("20000100", "0000000000000000", [BusEventKind.ERROR_ACTIVE], "restarted after bus-off"),
    ("20000004", "0001000000000000", [BusEventKind.OVERRUN], "the controller's receive buffer overflowed"),
    ("20000004", "0002000000000000", [BusEventKind.OVERRUN], "the controller's transmit buffer overflowed"),
    ("2000008C", "000000000A000000", [], "bus error with protocol violation"),
    ("200000A8", "0000001900000000", [], "no acknowledge"),
]


@pytest.mark.parametrize(("can_id", "data", "kinds", "meaning"), RECORDED, ids=[row[3] for row in RECORDED])
def test_a_recorded_error_frame_tells(can_id, data, kinds, meaning):
    assert [event.kind for event in events_of(CanFrame(int(can_id, 16), bytes.fromhex(data)))] == kinds


def test_the_counters_are_named_where_they_are_known():
    (event,) = events_of(CanFrame(0x20000204, bytes.fromhex("0030000000008860")))
    assert "transmit errors 136, receive errors 96" in event.text


def test_errors_are_counted_and_lost_frames_added_up():
    stats = PortStats()
    records = pack_records([overrun_frame(5), CanFrame(0x80), protocol_error_frame(), overrun_frame(2)])
    events = note_errors(records, stats)
    assert (stats.errors, stats.lost) == (3, 7)
    assert [event.text for event in events] == [
        f"receive overrun: {lost} frames lost, read more often" for lost in (5, 2)
    ]


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8))
def test_no_error_frame_raises(classes, data):
    note_errors(pack_records([CanFrame(0x20000000 | classes, data)]), PortStats())
