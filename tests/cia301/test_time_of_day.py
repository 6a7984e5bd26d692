from __future__ import annotations

from datetime import UTC, datetime

import pytest
from support.services import frame, vectors

from canopen_control.cia301.time_of_day import TimeConsumer, TimeOfDay, parse_cob_id_time, parse_time, time_frame
from canopen_control.errors import LocalProtocolError


@pytest.mark.parametrize("vector", vectors()["time"], ids=lambda v: v["utc"])
def test_times_are_the_vectors_and_the_calendar_agrees(vector):
    time = TimeOfDay(vector["days"], vector["ms"])
    moment = datetime.fromisoformat(vector["utc"]).replace(tzinfo=UTC)
    assert TimeOfDay.from_unix_ms(round(moment.timestamp() * 1000)) == time
    assert time.unix_ms() == round(moment.timestamp() * 1000)
    assert time_frame(time) == frame(vector["frame"])
    assert parse_time(frame(vector["frame"]).data) == time


def test_times_outside_of_the_format_are_refused():
    for unix_ms in (441_763_199_999, 441_763_200_000 + 65536 * 86_400_000):
        with pytest.raises(LocalProtocolError, match="1984"):
            TimeOfDay.from_unix_ms(unix_ms)


def test_reserved_bits_are_masked_and_wrong_lengths_are_none():
    assert parse_time(bytes.fromhex("010000F00100")) == TimeOfDay(1, 1)
    assert parse_time(b"") is None


def test_the_cob_id_entry_says_who_consumes_and_produces():
    assert parse_cob_id_time(0x80000100) == (0x100, True, False)
    assert parse_cob_id_time(0x40000100) == (0x100, False, True)
    assert parse_cob_id_time(0x20012345) == (0x80012345, False, False)


def test_the_consumer_tells_the_time_and_counts_what_is_none():
    consumer = TimeConsumer()
    consumer.receive(frame("100#01000000D416"), 7)
    consumer.receive(frame("100#FFFFFF0F0000"), 8)
    consumer.receive(frame("100#00"), 9)
    consumer.receive(frame("101#01000000D416"), 9)
    assert consumer.events() == [(TimeOfDay(5844, 1), 7)]
    assert consumer.malformed == 2
