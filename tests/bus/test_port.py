"""What every port shares: only whole records cross it."""

from __future__ import annotations

import pytest

from canopen_control.bus.port import PortStats, whole_records
from canopen_control.errors import LocalProtocolError


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_whole_records_are_counted_in_every_kind_of_buffer(kind):
    assert whole_records(kind(bytes(48))) == 3


def test_a_cut_record_is_the_callers_mistake():
    with pytest.raises(LocalProtocolError, match="17 bytes are no whole number of 16-byte records"):
        whole_records(bytes(17))


def test_counters_begin_at_zero():
    assert PortStats() == PortStats(rx=0, tx=0, lost=0, errors=0, queued=0)
