"""Options and ancillary data of a raw socket, in the layout of the kernel's headers."""

from __future__ import annotations

import socket
import struct

import pytest

from canopen_control.bus import rawsocket
from canopen_control.frame import EXTENDED_FLAG, REMOTE_FLAG

STAMP = (socket.SOL_SOCKET, 35, struct.pack("@ll", 1_700_000_000, 42))
LOST = (socket.SOL_SOCKET, 40, struct.pack("=I", 7))


def test_a_filter_matches_one_identifier_with_its_flags():
    filters = rawsocket.filters_of([0x703, 0x1ABCDEF0 | EXTENDED_FLAG, 0x703 | REMOTE_FLAG])
    for identifier, mask in struct.iter_unpack("=II", filters):
        matched = [
            observed
            for observed in (0x703, 0x704, 0x703 | REMOTE_FLAG, 0x703 | EXTENDED_FLAG, 0x1ABCDEF0 | EXTENDED_FLAG)
            if observed & mask == identifier & mask
        ]
        assert matched == [identifier]


def test_what_comes_alongside_a_frame_is_found_in_any_order_and_a_stranger_is_passed_over():
    stranger = (socket.SOL_SOCKET, 99, b"12345678")
    other_level = (socket.SOL_SOCKET + 1, 35, STAMP[2])
    for ancillary in ([STAMP, LOST], [other_level, LOST, stranger, STAMP]):
        assert rawsocket.stamp_of(ancillary) == 1_700_000_000_000_000_042
        assert rawsocket.overflow_of(ancillary) == 7
    assert rawsocket.stamp_of([LOST, other_level]) is None
    assert rawsocket.overflow_of([STAMP]) is None
    assert rawsocket.stamp_of([(socket.SOL_SOCKET, 35, b"cut")]) is None


@pytest.mark.parametrize(
    ("address", "name"), [(("can0",), "can0"), (("vcan12", 3), "vcan12"), ((), ""), (None, ""), ("can0", "")]
)
def test_a_frame_reports_where_it_is_from(address, name):
    assert rawsocket.interface_of(address) == name
