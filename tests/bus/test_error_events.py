"""What the drivers of real controllers tell by error frames becomes events with a sentence."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.error_frames import DRIVER_FRAMES, NAMES

from canopen_control.bus.error_events import events_of, note_errors
from canopen_control.bus.error_frames import overrun_frame, protocol_error_frame
from canopen_control.bus.port import BusEventKind, PortStats
from canopen_control.frame import CanFrame, pack_records


@pytest.mark.parametrize("row", DRIVER_FRAMES, ids=NAMES)
def test_what_a_driver_tells_becomes_its_event_and_nothing_else(row):
    events = events_of(row.frame)
    assert tuple(event.kind for event in events) == row.kinds
    if row.counters is not None:
        assert "(transmit errors {}, receive errors {})".format(*row.counters) in events[0].text
    else:
        assert not any("transmit errors" in event.text for event in events), "nobody marked these bytes as counters"


def test_a_transmit_overflow_is_told():
    (event,) = events_of(CanFrame(0x20000004, bytes.fromhex("0002000000000000")))
    assert event.kind is BusEventKind.OVERRUN


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


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8) | st.binary(min_size=8, max_size=8))
def test_no_error_frame_raises(classes, data):
    stats = PortStats()
    events = note_errors(pack_records([CanFrame(0x20000000 | classes, data)]), stats)
    assert all(event.kind in BusEventKind and event.text for event in events)
    assert stats.errors == (len(data) == 8), "all that a kernel makes have eight bytes"
