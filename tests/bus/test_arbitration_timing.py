"""Frame lengths against the closed formulas and against frames counted by hand."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus.arbitration import _crc15, duration_ns, frame_bits, worst_case_bits
from canopen_control.frame import EXTENDED_FLAG, FRAME_BITS, REMOTE_FLAG


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


def test_a_remote_frame_carries_no_data():
    assert frame_bits(0x701 | REMOTE_FLAG, b"\x00") < 71


def test_durations_round_up():
    assert duration_ns(1, 1_000_000) == 1000
    assert duration_ns(1, 3) == 333_333_334
