"""The send queue keeps order, drops the oldest, and never cuts a half-sent record."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus.sendqueue import SendQueue
from canopen_control.frame import RECORD_SIZE, CanFrame, frames_of, pack_records


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


def test_clearing_counts_a_half_sent_frame_too():
    queue = SendQueue()
    queue.put(pack_records([frame(1), frame(2)])[3:])
    assert queue.clear() == 2
    assert len(queue) == 0


@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 100)), max_size=50), st.integers(1, 10))
def test_a_reader_sees_whole_frames_in_order_and_every_gap_was_counted(steps, limit):
    queue, stream, number, dropped = SendQueue(limit), b"", 0, 0
    for count, taken in steps:
        dropped += queue.put(pack_records([frame(number + n) for n in range(count)]))
        number += count
        assert len(queue) <= limit
        stream += bytes(queue.data[:taken])
        queue.taken(taken)
    stream += bytes(queue.data)
    assert len(stream) % RECORD_SIZE == 0
    seen = [int.from_bytes(received.data, "little") for received in frames_of(stream)]
    assert seen == sorted(seen)
    assert len(seen) + dropped == number
