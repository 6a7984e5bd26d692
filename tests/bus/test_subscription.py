"""Subscriptions of a member: sent between frames, in any number, and distinguishable from them."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus.subscription import (
    HELLO_SIZE,
    LABEL_SIZE,
    MAGIC,
    VERSION,
    Chunk,
    Subscription,
    chunks_of,
    own_stamp,
    pack_hello,
    pack_stamp,
    pack_stamp_request,
    pack_subscription,
    parse_hello,
)
from canopen_control.frame import RECORD_SIZE, CanFrame, pack_records


@given(st.integers(0, 2**32 - 1), st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=80))
def test_a_greeting_returns_with_its_label_cut_between_characters(pid, label):
    hello = parse_hello(pack_hello(pid, label))
    assert (hello.version, hello.pid) == (VERSION, pid)
    fitting = max(end for end in range(len(label) + 1) if len(label[:end].encode()) <= LABEL_SIZE)
    assert hello.label == label[:fitting]


@given(st.binary(min_size=HELLO_SIZE, max_size=HELLO_SIZE))
def test_garbage_is_not_a_greeting(data):
    assert (parse_hello(data) is None) is (data[:8] != MAGIC)


def test_a_greeting_has_the_length_of_whole_records():
    assert HELLO_SIZE % RECORD_SIZE == 0
    assert parse_hello(pack_hello(1, "a")[:-1]) is None


FRAME = pack_records([CanFrame(0x181, b"\xff" * 8)])


@given(st.sets(st.integers(0, 0xFFFFFFFF), max_size=50))
def test_what_is_asked_for_is_what_is_received(can_ids):
    subscription = Subscription()
    assert subscription.take(FRAME + pack_subscription(can_ids) + FRAME) == FRAME * 2
    assert subscription.ids == can_ids


def test_nothing_changes_before_the_last_identifier_is_there():
    expected, requested = Subscription(), pack_subscription([0x80, 0x202, 0x602])
    assert expected.ids is None
    expected.take(requested[:RECORD_SIZE])
    assert expected.ids is None
    expected.take(requested[RECORD_SIZE:])
    assert expected.ids == {0x80, 0x202, 0x602}
    expected.take(pack_subscription([0x80]))
    assert expected.ids == {0x80}


def test_a_subscription_with_too_many_identifiers_receives_everything():
    subscription = Subscription()
    subscription.take(pack_subscription(range(5000)))
    assert subscription.ids is None


NOTHING = Chunk(0, own=False, records=b"")


def test_stamps_and_own_frames_are_asked_for_alongside_identifiers():
    subscription = Subscription()
    assert (subscription.stamps, subscription.echoes) == (False, False)
    assert subscription.take(pack_stamp_request() + FRAME + pack_subscription([0x80])) == FRAME
    assert (subscription.stamps, subscription.echoes, subscription.ids) == (True, False, {0x80})
    subscription.take(pack_stamp_request(echo=True))
    assert (subscription.stamps, subscription.echoes, subscription.ids) == (True, True, {0x80})


def test_frames_are_parted_at_their_stamps():
    data = FRAME + pack_stamp(5000) + FRAME * 3 + own_stamp(pack_stamp(9000)) + FRAME
    parts = list(chunks_of(data, NOTHING))
    assert parts == [(0, False, FRAME), (5000, False, FRAME * 3), (9000, True, FRAME)]
    assert [stamp for part in parts for stamp in part.stamps] == [0, 5000, 6000, 7000, 9000]


def test_a_chunk_that_comes_in_two_readings_continues_in_time():
    *_, last = chunks_of(own_stamp(pack_stamp(5000)) + FRAME * 2, NOTHING)
    assert list(chunks_of(FRAME + pack_stamp(9000) + FRAME, last)) == [(7000, True, FRAME), (9000, False, FRAME)]
    *_, last = chunks_of(pack_stamp(5000), last)
    assert list(chunks_of(FRAME, last)) == [(5000, False, FRAME)]


@given(st.lists(st.one_of(st.integers(1, 2**62), st.binary(min_size=8, max_size=8)), max_size=30))
def test_any_data_and_any_times_are_distinguished(things):
    data, frames = b"", b""
    for thing in things:
        record = pack_records([CanFrame(0x181, thing)]) if isinstance(thing, bytes) else b""
        data += record or pack_stamp(thing)
        frames += record
    parts = list(chunks_of(data, NOTHING))
    assert b"".join(part.records for part in parts) == frames
    stamped = [thing for thing in things if isinstance(thing, int)]
    assert [part.at_ns for part in parts if part.at_ns] == stamped
