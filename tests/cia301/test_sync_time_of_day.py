from __future__ import annotations

from datetime import datetime, timedelta

import pytest
from support.services import frame, vectors

from canopen_control.cia301.sync import TimeOfDay, parse_time

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
