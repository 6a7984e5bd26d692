from __future__ import annotations

from datetime import datetime, timedelta

import pytest
from support.services import frame, vectors

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sync import (
    SyncConsumer,
    SyncEvent,
    SyncEventKind,
    SyncProducer,
    TimeOfDay,
    check_cob_id_sync,
    check_overflow,
    is_valid_overflow,
    parse_cob_id_sync,
    parse_time,
)
from canopen_control.errors import LocalProtocolError
from canopen_control.frame import EXTENDED_FLAG

EPOCH = datetime(1984, 1, 1)  # noqa: DTZ001 - TIME knows no zone


@pytest.mark.parametrize("vector", vectors()["time"], ids=lambda v: v["utc"])
def test_times_are_the_vectors_and_the_calendar_agrees(vector):
    time = TimeOfDay(vector["days"], vector["ms"])
    assert parse_time(frame(vector["frame"]).data) == time
    assert EPOCH + timedelta(days=time.days, milliseconds=time.ms) == datetime.fromisoformat(vector["utc"]).replace(
        tzinfo=None
    )


def test_reserved_bits_are_masked_and_wrong_lengths_are_none():
    assert parse_time(bytes.fromhex("010000F00100")) == TimeOfDay(1, 1)
    assert parse_time(b"") is None


KIND = SyncEventKind
SYNC = vectors()["sync"]


def test_reset_starts_the_counter_again():
    producer = SyncProducer(overflow=4)
    producer.frame()
    producer.reset()
    assert producer.frame() == frame("080#01")


def test_the_producer_makes_each_frame_once():
    producer = SyncProducer(overflow=2)
    first, _, third = producer.frame(), producer.frame(), producer.frame()
    assert first is third


@pytest.mark.parametrize("overflow", [1, 241, 255, -1])
def test_reserved_overflow_values_are_refused(overflow):
    assert not is_valid_overflow(overflow)
    assert check_overflow(overflow, 0) is AbortCode.INVALID_VALUE
    with pytest.raises(LocalProtocolError):
        SyncProducer(overflow=overflow)


def test_the_counter_is_fixed_while_a_period_is_set():
    assert [check_overflow(value, 0) for value in (0, 2, 240)] == [None] * 3
    assert check_overflow(4, 20000) is AbortCode.DEVICE_STATE


@pytest.mark.parametrize("vector", SYNC["1005"], ids=lambda v: v["value"])
def test_the_cob_id_entry_is_the_vectors(vector):
    assert parse_cob_id_sync(int(vector["value"], 16)) == (0x80, vector["producer"])
    assert parse_cob_id_sync(0x20012345) == (0x12345 | EXTENDED_FLAG, False)


def test_the_cob_id_is_fixed_while_the_node_produces():
    assert check_cob_id_sync(0x40000081, 0x40000080) is AbortCode.INVALID_VALUE
    assert check_cob_id_sync(0x40000081, 0x00000080) is None
    assert check_cob_id_sync(0x00000081, 0x40000080) is None
    assert check_cob_id_sync(0x40000080, 0x00000080, can_produce=False) is AbortCode.INVALID_VALUE


def test_the_timer_keeps_its_grid_and_skips_what_was_missed():
    producer = SyncProducer(overflow=4, period_ns=100)
    producer.tick(0)
    assert (producer.frames(), producer.next_deadline()) == ([], None)
    producer.start(1000)
    for now in (1000, 1099, 1103, 1450):
        producer.tick(now)
    assert producer.frames() == [frame("080#01"), frame("080#02"), frame("080#03")]
    assert producer.next_deadline() == 1500
    producer.stop()
    assert producer.next_deadline() is None


def test_the_consumer_reports_each_sync_with_its_counter():
    consumer = SyncConsumer(overflow=4)
    for now, text in enumerate(("080#03", "080#04", "080#01", "081#", "080#R0")):
        consumer.receive(frame(text), now)
    assert [(event.kind, event.counter) for event in consumer.events()] == [
        (KIND.SYNC, 3),
        (KIND.SYNC, 4),
        (KIND.SYNC, 1),
    ]
    assert (consumer.count, consumer.skipped) == (3, 0)


def test_a_lost_counter_is_counted():
    consumer = SyncConsumer(overflow=4)
    for text in ("080#01", "080#03", "080#04", "080#02"):
        consumer.receive(frame(text), 0)
    assert consumer.skipped == 2


@pytest.mark.parametrize(("overflow", "text"), [(4, "080#"), (0, "080#01"), (4, "080#0102")])
def test_a_wrong_length_is_reported_and_still_a_sync(overflow, text):
    consumer = SyncConsumer(overflow=overflow)
    consumer.receive(frame(text), 7)
    assert consumer.events() == [SyncEvent(KIND.LENGTH_ERROR, 7), SyncEvent(KIND.SYNC, 7)]
    assert consumer.count == 1


def test_a_missing_sync_is_reported_after_one_and_a_half_periods():
    consumer = SyncConsumer(period_ns=100)
    consumer.receive(frame("080#"), 0)
    assert consumer.next_deadline() == 150
    consumer.tick(149)
    consumer.tick(150)
    consumer.tick(300)
    consumer.receive(frame("080#"), 400)
    assert [event.kind for event in consumer.events()] == [KIND.SYNC, KIND.MISSED, KIND.RESOLVED, KIND.SYNC]
    consumer.reset()
    assert consumer.next_deadline() is None


def test_a_plain_sync_counts_without_an_event_and_any_other_is_left_to_receive():
    consumer = SyncConsumer(period_ns=20)
    assert consumer.receive_plain(0)
    assert (consumer.count, consumer.next_deadline(), consumer.events()) == (1, 30, [])
    assert not consumer.receive_plain(30)  # too late: it resolves a timeout
    consumer.tick(30)
    assert not consumer.receive_plain(40)
    consumer.receive(frame("080#"), 40)
    assert consumer.receive_plain(50)
    assert not SyncConsumer(overflow=10).receive_plain(0)
    assert consumer.count == 3
