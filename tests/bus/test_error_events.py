"""Error frames of drivers of real controllers are converted to events with a sentence."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.error_frames import DRIVER_FRAMES, NAMES

from canopen_control.bus.error_events import error_text, events_of, note_errors
from canopen_control.bus.error_frames import overrun_frame, protocol_error_frame
from canopen_control.bus.port import BusEventKind, PortStats
from canopen_control.frame import CanFrame, pack_records


@pytest.mark.parametrize("row", DRIVER_FRAMES, ids=NAMES)
def test_what_a_driver_reports_becomes_its_event_and_nothing_else(row):
    events = events_of(row.frame)
    assert tuple(event.kind for event in events) == row.kinds
    if row.counters is not None:
        assert "(transmit errors {}, receive errors {})".format(*row.counters) in events[0].text
    else:
        assert not any("transmit errors" in event.text for event in events), "nobody marked these bytes as counters"


def test_a_transmit_overflow_is_reported():
    (event,) = events_of(CanFrame(0x20000004, bytes.fromhex("0002000000000000")))
    assert event.kind is BusEventKind.OVERRUN


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


# Texts of a trace


NOBODY = "no node acknowledged the frame"


@pytest.mark.parametrize(
    ("classes", "data", "says"),
    [
        (0x001, "0000000000000000", ["transmit time-out"]),
        (0x002, "0B00000000000000", ["arbitration lost at bit 11"]),
        (0x002, "0000000000000000", ["arbitration lost"]),
        (0x004, "0000000000000000", ["without detail"]),
        (0x004, "0004000000000000", ["the receive errors have reached the warning level"]),
        (
            0x204,
            "0008000000006000",
            ["the transmit errors have reached the warning level", "(transmit errors 96, receive"],
        ),
        (0x204, "0010000000000088", ["error-passive", "receive errors 136"]),
        (0x004, "0001000000000000", ["receive overrun"]),
        (0x008, "0000040A00000000", ["stuff error, at: data"]),
        (0x088, "0000801900000000", ["while sending, at: acknowledge slot", NOBODY]),
        (0x010, "0000000047000000", ["CANH is shorted to ground, CANL has no wire"]),
        (0x010, "0000000000000000", ["transceiver: a problem without details"]),
        (0x020, "0000000000000000", [NOBODY]),
        (0x040, "0000000000000000", ["bus-off"]),
        (0x080, "0000000000000000", ["a frame was disturbed"]),
        (0x100, "0000000000000000", ["restarted after bus-off"]),
        (0x200, "0000000000001122", ["error counters: transmit errors 17, receive errors 34"]),
        (0x0A8, "0000801900000000", [NOBODY, "bus error"]),
        (0x003, "0500000000000000", ["transmit time-out", "arbitration lost at bit 5"]),
        (0x400, "0000000000000000", ["0x400"]),
        (0x000, "0000000000000000", ["without its class"]),
    ],
)
def test_every_class_has_its_words(classes, data, says):
    text = error_text(CanFrame(0x20000000 | classes, bytes.fromhex(data)))
    assert all(say in text for say in says), text
    assert text.count(NOBODY) <= 1


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=12))
def test_every_error_frame_has_a_text(classes, data):
    assert error_text(CanFrame(0x20000000 | classes, data))
