"""Arbitration: winner, order of frames and load of the wire."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus.arbitration import PacedWire, _crc15, duration_ns, frame_bits, priority, worst_case_bits
from canopen_control.frame import EXTENDED_FLAG, FRAME_BITS, REMOTE_FLAG, CanFrame, frames_of, pack_records


@pytest.mark.parametrize(("length", "shortest", "longest"), [(0, 47, 55), (3, 71, 85), (8, 111, 135)])
def test_an_eleven_bit_frame_stays_between_the_formulas(length, shortest, longest):
    assert (FRAME_BITS + 8 * length, worst_case_bits(length)) == (shortest, longest)
    # 0x555 and 0x55 alternate: no run of five in identifier and data.
    assert shortest <= frame_bits(0x555, b"\x55" * length) <= longest


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_no_standard_frame_leaves_the_bounds(can_id, data):
    assert FRAME_BITS + 8 * len(data) <= frame_bits(can_id, data) <= worst_case_bits(len(data))


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8))
def test_no_extended_frame_leaves_the_bounds(can_id, data):
    assert 67 + 8 * len(data) <= frame_bits(can_id | EXTENDED_FLAG, data) <= worst_case_bits(len(data), extended=True)


def test_a_frame_of_zeros_is_stuffed_after_each_run_of_five():
    # The shortest SYNC: start, identifier, control and a CRC of zeros are 34 dominant bits, so 6 stuff bits.
    assert frame_bits(0x000, b"") == 34 + 6 + 13


@given(st.text("01", min_size=1, max_size=100))
def test_content_and_crc_together_leave_no_remainder(bits):
    content = int(bits, 2)
    assert _crc15(content << 15 | _crc15(content, len(bits)), len(bits) + 15) == 0


S = 1_000_000_000


def test_arbitration_is_decided_bit_by_bit():
    order = [
        0x000,
        0x123,
        0x123 | REMOTE_FLAG,
        (0x123 << 18) | EXTENDED_FLAG,
        (0x123 << 18) | EXTENDED_FLAG | REMOTE_FLAG,
        (0x123 << 18) | 1 | EXTENDED_FLAG,
        0x124,
        0x7FF,
    ]
    assert sorted(order, key=priority) == order
    assert len({priority(can_id) for can_id in order}) == len(order)


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 0x7FF), st.integers(0, 300_000)), min_size=1, max_size=40))
def test_nothing_is_lost_each_sender_keeps_its_order_and_time_is_filled_without_gaps(steps):
    wire, now, out, put = PacedWire(1_000_000), 0, [], []
    for number, (sender, can_id, wait) in enumerate(steps):
        now += wait
        out += wire.advance(now)
        frame = CanFrame(can_id, number.to_bytes(2, "little"))
        put.append((sender, frame))
        wire.put(sender, pack_records([frame]), now)
    bits = sum(frame_bits(*frame) for _, frame in put)
    out += wire.advance(now + duration_ns(bits, 1_000_000))
    passed = [(sender, next(frames_of(record))) for sender, record in out]
    assert sorted(passed) == sorted(put)
    for sender in range(4):
        assert [item for item in passed if item[0] == sender] == [item for item in put if item[0] == sender]
    assert wire.bits == bits
    assert wire.next_deadline() is None


def test_forgetting_a_sender_finishes_what_is_on_the_wire():
    wire = PacedWire(1_000_000)
    wire.put(1, pack_records([CanFrame(1), CanFrame(2), CanFrame(3)]), 0)
    assert wire.backlog(1) == 2
    assert wire.forget(1) == 2
    assert len(list(wire.advance(S))) == 1
    assert wire.backlog(1) == 0


def test_the_load_is_that_of_the_last_full_second():
    wire = PacedWire(1000)
    frame = CanFrame(0x555, b"")
    wire.put(1, pack_records([frame] * 10), 0)
    list(wire.advance(S))
    share = 10 * frame_bits(*frame) / 1000
    assert wire.load(S) == pytest.approx(share, abs=0.001)
    assert wire.load(2 * S - 1) == pytest.approx(share, abs=0.001)
    assert wire.load(2 * S) == 0.0


def test_a_frame_that_was_disturbed_is_sent_again_before_what_its_sender_has_queued():
    wire = PacedWire(1_000_000)
    records = [pack_records([CanFrame(0x100 + number, b"")]) for number in range(2)]
    wire.put(1, b"".join(records), 0)
    wire.repeat()
    assert [record for _, record in wire.advance(10_000_000)] == records
    assert wire.bits == 2 * frame_bits(0x100, b"") + frame_bits(0x101, b"")
