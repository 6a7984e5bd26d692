"""Error frames are made in linux/can/error.h's layout and found among others without work per frame."""

from __future__ import annotations

import pytest

from canopen_control.bus import error_frames
from canopen_control.frame import CanFrame, pack_records

ERR = 0x20000000


@pytest.mark.parametrize(
    ("frame", "can_id", "data"),
    [
        (error_frames.bus_off_frame(), ERR | 0x40, "0000000000000000"),
        (error_frames.restarted_frame(), ERR | 0x100, "0000000000000000"),
        (error_frames.passive_frame(), ERR | 0x204, "0030000000008080"),
        (error_frames.active_frame(), ERR | 0x4, "0040000000000000"),
        (error_frames.protocol_error_frame(), ERR | 0x8, "0000000000000000"),
        (error_frames.overrun_frame(258), ERR | 0x4, "FF01000002010000"),
    ],
)
def test_the_layout_is_that_of_linux(frame, can_id, data):
    assert frame == CanFrame(can_id, bytes.fromhex(data))
    assert frame.is_error


def test_one_error_frame_among_many_is_noticed_and_found():
    plain = [CanFrame(0x181 + n, bytes(n % 9)) for n in range(100)]
    assert not error_frames.has_error_frames(pack_records(plain))
    mixed = pack_records([*plain, error_frames.bus_off_frame(), CanFrame(0x700)])
    assert error_frames.has_error_frames(mixed)
    assert list(error_frames.error_frames(mixed)) == [error_frames.bus_off_frame()]
