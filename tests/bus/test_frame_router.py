"""Core of the hub: split data is reassembled, the order is kept, and a stalled member loses only its own frames."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus import frame_router
from canopen_control.bus.arbitration import duration_ns, frame_bits
from canopen_control.bus.error_frames import lost_frames, overrun_frame, protocol_error_frame
from canopen_control.bus.frame_router import BACKLOG_LIMIT, DropRule, FrameRouter, WireFaults
from canopen_control.bus.subscription import Chunk, chunks_of, pack_stamp_request, pack_subscription
from canopen_control.frame import RECORD_SIZE, CanFrame, frames_of, pack_records

MS = 1_000_000


def frame(number, can_id=0x181):
    return CanFrame(can_id, number.to_bytes(4, "little"))


def take(exchange, member):
    """Write everything of one member, as a reader that keeps up lets the hub do."""
    taken = bytes(member.outbox)
    exchange.sent(member, len(taken))
    return list(frames_of(taken))


@pytest.fixture
def exchange():
    return FrameRouter()


@pytest.fixture
def trio(exchange):
    return [exchange.join(label, pid) for label, pid in (("master", 10), ("left", 11), ("right", 12))]


@given(st.lists(st.integers(0, 0xFFFF), min_size=1, max_size=40), st.data())
def test_any_split_of_the_stream_reassembles(numbers, data):
    exchange = FrameRouter()
    sender, reader = exchange.join("a", 1), exchange.join("b", 2)
    sent = [frame(number) for number in numbers]
    stream = pack_records(sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        exchange.receive(sender, stream[begin:end], 0)
        assert len(reader.outbox) % RECORD_SIZE == 0
    assert list(frames_of(reader.outbox)) == sent
    assert sender.tx == reader.rx == len(sent)


def test_each_reader_is_dirty_once_however_much_arrives(exchange, trio):
    master, left, right = trio
    for number in range(3):
        exchange.receive(master, pack_records([frame(number)]), 0)
    assert exchange.take_dirty() == [left, right]
    assert exchange.take_dirty() == []


def test_the_report_of_lost_frames_stands_where_they_are_missing():
    exchange = FrameRouter(limit=4 * RECORD_SIZE)
    sender, reader = exchange.join("sender", 1), exchange.join("reader", 2)
    exchange.receive(sender, pack_records([frame(number) for number in range(6)]), 0)
    exchange.sent(reader, 2 * RECORD_SIZE)
    exchange.receive(sender, pack_records([frame(6)]), 0)
    assert take(exchange, reader) == [frame(2), frame(3), overrun_frame(2), frame(6)]


@given(st.lists(st.tuples(st.integers(1, 6), st.integers(0, 100)), max_size=60))
def test_frames_received_and_frames_reported_lost_add_up_to_those_sent(steps):
    exchange = FrameRouter(limit=8 * RECORD_SIZE)
    sender, reader = exchange.join("sender", 1), exchange.join("reader", 2)
    stream, sent = b"", 0
    for count, writable in steps:
        exchange.receive(sender, pack_records([frame(sent + n) for n in range(count)]), 0)
        sent += count
        stream += bytes(reader.outbox[:writable])
        exchange.sent(reader, min(writable, len(reader.outbox)))
    while reader.outbox:
        stream += bytes(reader.outbox)
        exchange.sent(reader, len(reader.outbox))
    expected = 0
    for received in frames_of(stream):
        if lost := lost_frames(received):
            expected += lost
        else:
            assert received == frame(expected)
            expected += 1
    assert expected == sent
    assert reader.missed == 0


def test_labels_are_unique_and_an_empty_one_becomes_the_process(exchange):
    assert [exchange.join(label, 7).label for label in ("a", "a", "", "a")] == ["a", "a-2", "pid-7", "a-3"]


# Faults


def test_a_cut_cable_is_silent_in_both_directions_until_it_is_repaired(exchange, trio):
    master, left, right = trio
    exchange.cut("left")
    exchange.receive(left, pack_records([frame(1)]), 0)
    exchange.receive(master, pack_records([frame(2)]), 0)
    assert take(exchange, left) == []
    assert take(exchange, right) == [frame(2)]
    assert take(exchange, master) == []
    assert (left.lost, exchange.dropped) == (1, 1)
    exchange.cut("left", repair=True)
    exchange.receive(left, pack_records([frame(3)]), 0)
    assert take(exchange, master) == [frame(3)]


def test_a_cut_cable_stays_cut_when_its_process_returns(exchange, trio):
    exchange.cut("left")
    exchange.leave(trio[1])
    assert exchange.join("left", 99).silent


def test_bus_off_is_reported_to_the_controller_alone_and_restart_too(exchange, trio):
    master, left, _right = trio
    exchange.bus_off("left")
    assert [f.can_id for f in take(exchange, left)] == [0x20000040]
    assert take(exchange, master) == []
    exchange.receive(left, pack_records([frame(1)]), 0)
    assert take(exchange, master) == []
    exchange.bus_off("left", restart=True)
    assert [f.can_id for f in take(exchange, left)] == [0x20000100]
    exchange.receive(left, pack_records([frame(2)]), 0)
    assert take(exchange, master) == [frame(2)]


def test_a_drop_rule_takes_every_nth_matching_frame_and_ends(exchange, trio):
    master, left, right = trio
    exchange.faults.drops.append(DropRule("master", 0x181, every=2, count=2))
    exchange.receive(master, pack_records([frame(n) for n in range(8)]), 0)
    exchange.receive(master, pack_records([frame(9, can_id=0x80)]), 0)
    kept = [frame(n) for n in (0, 2, 4, 5, 6, 7)]
    assert take(exchange, left) == take(exchange, right) == [*kept, frame(9, can_id=0x80)]
    assert exchange.dropped == 2
    assert not exchange.faults.active


def test_a_delay_holds_frames_until_they_are_due(exchange, trio):
    master, left, _right = trio
    exchange.faults.delay("master", 5 * MS)
    exchange.receive(master, pack_records([frame(1)]), 10 * MS)
    assert exchange.next_deadline() == 15 * MS
    exchange.tick(15 * MS - 1)
    assert not left.outbox
    exchange.tick(15 * MS)
    assert take(exchange, left) == [frame(1)]
    assert exchange.next_deadline() is None


@given(st.lists(st.tuples(st.integers(0, 5), st.sampled_from([0, 1, 3, 10])), min_size=1, max_size=30))
def test_frames_of_one_sender_stay_in_order_when_its_delay_changes(steps):
    exchange = FrameRouter()
    sender, reader = exchange.join("a", 1), exchange.join("b", 2)
    now = 0
    for number, (wait, delay) in enumerate(steps):
        now += wait * MS
        exchange.tick(now)
        exchange.faults.delay("a", delay * MS)
        exchange.receive(sender, pack_records([frame(number)]), now)
    exchange.tick(now + 100 * MS)
    assert take(exchange, reader) == [frame(number) for number in range(len(steps))]


def test_a_delay_holds_back_a_bounded_number_and_counts_the_rest(exchange, trio, monkeypatch):
    monkeypatch.setattr(frame_router, "DELAY_LIMIT", 2)
    master, left, _right = trio
    exchange.faults.delay("master", 5 * MS)
    for number in range(3):
        exchange.receive(master, pack_records([frame(number)]), 0)
    exchange.tick(5 * MS)
    assert take(exchange, left) == [frame(0), frame(1)]
    assert (master.lost, exchange.dropped) == (1, 1)


def test_clearing_repairs_everything_and_reports_those_that_were_bus_off(exchange, trio):
    _master, left, right = trio
    exchange.bus_off("left")
    exchange.cut("right")
    take(exchange, left)
    exchange.clear_faults()
    assert not left.silent
    assert not right.silent
    assert [f.can_id for f in take(exchange, left)] == [0x20000100]
    assert take(exchange, right) == []


# Bit rate


def test_on_a_paced_wire_a_frame_arrives_after_its_bits(exchange, trio):
    master, left, _right = trio
    exchange.pace(1_000_000, 0)
    exchange.receive(master, pack_records([frame(1)]), 0)
    last_bit = duration_ns(frame_bits(*frame(1)), 1_000_000)
    assert exchange.next_deadline() == last_bit
    exchange.tick(last_bit - 1)
    assert not left.outbox
    exchange.tick(last_bit)
    assert take(exchange, left) == [frame(1)]
    assert exchange.next_deadline() is None


def test_the_lowest_identifier_goes_first_but_interrupts_nothing(exchange, trio):
    master, left, right = trio
    exchange.pace(500_000, 0)
    exchange.receive(left, pack_records([frame(1, 0x701)]), 0)
    exchange.receive(right, pack_records([frame(2, 0x182)]), 0)
    exchange.receive(left, pack_records([frame(3, 0x181)]), 0)
    exchange.receive(master, pack_records([frame(4, 0x080)]), 0)
    exchange.tick(10 * MS)
    assert [f.can_id for f in frames_of(b"".join([bytes(m.outbox) for m in trio[:1]]))] == [0x701, 0x181, 0x182]
    assert [f.can_id for f in frames_of(right.outbox)] == [0x701, 0x080, 0x181]


def test_error_frames_are_never_on_the_wire(exchange, trio):
    master, left, _right = trio
    exchange.pace(125_000, 0)
    exchange.receive(master, pack_records([frame(1), protocol_error_frame()]), 0)
    assert take(exchange, left) == [protocol_error_frame()]


def test_a_wire_that_is_behind_pushes_back_on_its_sender_alone(exchange, trio):
    master, left, _right = trio
    exchange.pace(125_000, 0)
    exchange.receive(master, pack_records([frame(n) for n in range(BACKLOG_LIMIT + 1)]), 0)
    assert not exchange.may_read(master)
    assert exchange.may_read(left)
    exchange.tick(10_000 * MS)
    assert exchange.may_read(master)
    assert left.rx == BACKLOG_LIMIT + 1


def test_removing_the_bit_rate_sends_everything_at_once(exchange, trio):
    master, left, _right = trio
    exchange.pace(10_000, 0)
    exchange.receive(master, pack_records([frame(n) for n in range(5)]), 0)
    exchange.pace(None, 1)
    assert take(exchange, left) == [frame(n) for n in range(5)]
    assert exchange.load(1) is None
    assert exchange.next_deadline() is None


@given(st.binary(max_size=200), st.booleans())
def test_garbage_never_raises(data, paced):
    exchange = FrameRouter()
    sender, reader = exchange.join("a", 1), exchange.join("b", 2)
    exchange.pace(1_000_000 if paced else None, 0)
    exchange.receive(sender, data, 0)
    exchange.tick(10**9)
    assert len(reader.outbox) == len(data) // RECORD_SIZE * RECORD_SIZE


# --- Subscriptions ---


def test_a_subscriber_is_not_woken_by_chunks_without_its_frames(exchange, trio):
    master, left, right = trio
    exchange.receive(left, pack_subscription([0x80, 0x202]), 0)
    assert not master.outbox
    assert not right.outbox
    assert exchange.frames == left.tx == 0
    exchange.receive(right, pack_records([frame(1, 0x183)]), 0)
    assert not left.outbox
    assert left.rx == 0
    assert take(exchange, master) == [frame(1, 0x183)]


def test_frames_with_flags_are_passed_on_unfiltered(exchange, trio):
    master, left, _ = trio
    exchange.receive(left, pack_subscription([0x80]), 0)
    for item in (protocol_error_frame(), CanFrame(0x80000080), CanFrame(0x40000702)):
        exchange.receive(master, pack_records([item]), 0)
        assert take(exchange, left) == [item]


def test_what_is_requested_may_come_in_any_split_between_frames(exchange, trio):
    master, left, right = trio
    stream = pack_records([frame(1)]) + pack_subscription(range(0x80, 0x85)) + pack_records([frame(2)])
    for byte in stream:
        exchange.receive(left, bytes([byte]), 0)
    assert take(exchange, master) == [frame(1), frame(2)]
    for can_id in (0x84, 0x85):
        exchange.receive(right, pack_records([frame(can_id, can_id)]), 0)
    assert take(exchange, left) == [frame(0x84, 0x84)]


def test_a_paced_wire_filters_by_requested_identifiers(exchange, trio):
    master, left, _ = trio
    exchange.receive(left, pack_subscription([0x80]), 0)
    exchange.pace(1_000_000, 0)
    exchange.receive(master, pack_records([frame(1, 0x203), CanFrame(0x80)]), 0)
    exchange.tick(MS)
    assert take(exchange, left) == [CanFrame(0x80)]


# Stamps


def chunks(exchange, member):
    """Write everything of one member; return it as (time, whether it is its own, frames)."""
    taken = bytes(member.outbox)
    exchange.sent(member, len(taken))
    result = chunks_of(taken, Chunk(0, own=False, records=b""))
    return [(chunk.at_ns, chunk.own, list(frames_of(chunk.records))) for chunk in result if chunk.records]


@pytest.fixture
def listener(exchange, trio):
    listener = exchange.join("trace", 13)
    exchange.receive(listener, pack_stamp_request(), 0)
    return listener


def test_a_subscriber_with_stamps_gets_one_before_each_chunk_and_the_others_none(exchange, trio, listener):
    master, left, right = trio
    exchange.receive(master, pack_records([frame(1), frame(2)]), 5 * MS)
    exchange.receive(left, pack_records([frame(3)]), 6 * MS)
    assert chunks(exchange, listener) == [(5 * MS, False, [frame(1), frame(2)]), (6 * MS, False, [frame(3)])]
    assert take(exchange, right) == [frame(1), frame(2), frame(3)]
    assert listener.rx == 3
    assert exchange.frames == 3


def test_no_chunk_is_stamped_before_the_last_frame_of_the_one_before(exchange, trio, listener):
    master, left, _ = trio
    exchange.receive(master, pack_records([frame(1)] * 100), MS)
    exchange.receive(left, pack_records([frame(2)]), MS)
    exchange.receive(left, pack_records([frame(3)]), MS + 150_000)
    times = [at for at, _, _ in chunks(exchange, listener)]
    assert times == [MS, MS + 100_000, MS + 150_000]


def test_own_frames_return_in_their_place_and_report_this(exchange, trio):
    master, left, _ = trio
    loud = exchange.join("loud", 13)
    exchange.receive(loud, pack_stamp_request(echo=True), 0)
    exchange.receive(master, pack_records([frame(1)]), MS)
    exchange.receive(loud, pack_records([frame(2)]), 2 * MS)
    exchange.receive(left, pack_records([frame(3)]), 3 * MS)
    expected = [(MS, False, [frame(1)]), (2 * MS, True, [frame(2)]), (3 * MS, False, [frame(3)])]
    assert chunks(exchange, loud) == expected
    exchange.cut("loud")
    exchange.receive(loud, pack_records([frame(4)]), 4 * MS)
    assert not loud.outbox, "what did not get onto the wire does not come back"


def test_on_a_paced_wire_a_frame_has_the_time_of_its_last_bit(exchange, trio, listener):
    exchange.pace(125_000, 0)
    bits = [frame_bits(*frame(number)) for number in (1, 2)]
    exchange.receive(trio[0], pack_records([frame(1), frame(2)]), MS)
    exchange.tick(100 * MS)
    first = MS + duration_ns(bits[0], 125_000)
    times = [at for at, _, _ in chunks(exchange, listener)]
    assert times == [first, first + duration_ns(bits[1], 125_000)]


def test_a_delayed_frame_has_the_time_at_which_it_was_due(exchange, trio, listener):
    exchange.faults.delay("master", 10 * MS)
    exchange.receive(trio[0], pack_records([frame(1)]), 5 * MS)
    exchange.tick(40 * MS)
    assert [at for at, _, _ in chunks(exchange, listener)] == [15 * MS]


def test_a_report_is_stamped_too(exchange, trio, listener):
    exchange.tick(7 * MS)
    exchange.report("", protocol_error_frame())
    assert chunks(exchange, listener) == [(7 * MS, False, [protocol_error_frame()])]
    assert take(exchange, trio[0]) == [protocol_error_frame()]


# Table of wire faults.


def test_a_label_has_its_own_delay_or_that_of_everybody():
    faults = WireFaults()
    faults.delay("", 5)
    faults.delay("a", 9)
    assert [faults.delay_of(label) for label in "ab"] == [9, 5]
    faults.delay("a", 0)
    faults.delay("b", 0)
    assert [faults.delay_of(label) for label in "ab"] == [5, 5]


@given(st.integers(1, 5), st.none() | st.integers(1, 5), st.integers(0, 40))
def test_a_rule_loses_each_nth_frame_up_to_its_count(every, count, sent):
    faults = WireFaults()
    faults.drops.append(DropRule("a", None, every, count))
    kept = list(frames_of(faults.survivors("a", pack_records([CanFrame(n) for n in range(sent)]))))
    expected = sent // every if count is None else min(count, sent // every)
    assert sent - len(kept) == expected
    assert bool(faults.drops) is (count is None or expected < count)


def test_a_rule_spares_other_labels_and_identifiers():
    faults = WireFaults()
    faults.drops.append(DropRule("a", 0x181))
    records = pack_records([CanFrame(0x181), CanFrame(0x182)])
    assert faults.survivors("b", records) == records
    assert faults.survivors("a", records) == pack_records([CanFrame(0x182)])
