"""Behaviour of every port: only complete records are transferred."""

from __future__ import annotations

import select

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus.port import (
    EVENT_LIMIT,
    BusEvent,
    BusEventKind,
    BusEventLog,
    SendQueue,
    WakeDescriptor,
    whole_records,
)
from canopen_control.frame import RECORD_SIZE, CanFrame, frames_of, pack_records


def test_events_come_once_and_in_order():
    log = BusEventLog()
    log.add(BusEventKind.DOWN, "gone")
    log.extend([BusEvent(BusEventKind.UP, "back")])
    assert [event.text for event in log.drain()] == ["gone", "back"]
    assert log.drain() == []


def test_an_owner_without_requests_uses_no_memory():
    log = BusEventLog()
    for number in range(EVENT_LIMIT + 5):
        log.add(BusEventKind.OVERRUN, str(number))
    events = log.drain()
    assert (len(events), events[0].text) == (EVENT_LIMIT, "5")


def frame(number):
    return CanFrame(0x200, number.to_bytes(4, "little"))


def test_the_oldest_whole_frame_is_dropped_and_the_half_sent_one_stays():
    queue = SendQueue(limit=2)
    first = pack_records([frame(1)])
    assert queue.put(first[5:]) == 0
    assert queue.put(pack_records([frame(2)])) == 0
    assert queue.put(pack_records([frame(3)])) == 1
    assert bytes(queue.data) == first[5:] + pack_records([frame(3)])
    assert len(queue) == 2


@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 100)), max_size=50), st.integers(1, 10))
def test_a_reader_receives_whole_frames_in_order_and_every_gap_was_counted(steps, limit):
    queue, stream, number, dropped = SendQueue(limit), b"", 0, 0
    for count, taken in steps:
        dropped += queue.put(pack_records([frame(number + n) for n in range(count)]))
        number += count
        assert len(queue) <= limit
        stream += bytes(queue.data[:taken])
        queue.taken(taken)
    stream += bytes(queue.data)
    assert len(stream) % RECORD_SIZE == 0
    observed = [int.from_bytes(received.data, "little") for received in frames_of(stream)]
    assert observed == sorted(observed)
    assert len(observed) + dropped == number


def readable(wake):
    return bool(select.select([wake], [], [], 0)[0])


def test_it_is_readable_from_set_to_clear():
    wake = WakeDescriptor()
    assert not readable(wake)
    wake.set()
    wake.set()
    assert readable(wake)
    wake.clear()
    assert not readable(wake)
    wake.close()


def test_a_closed_one_ignores_everything():
    wake = WakeDescriptor()
    wake.close()
    wake.set()
    wake.clear()
    wake.close()
    assert wake.fileno() == -1


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_whole_records_are_counted_in_every_kind_of_buffer(kind):
    assert whole_records(kind(bytes(48))) == 3
