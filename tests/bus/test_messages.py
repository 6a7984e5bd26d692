"""python-can's messages and records are made from each other without loss."""

from __future__ import annotations

import can
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus.messages import message_of, record_of
from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, CanFrame, pack_records

frames = st.one_of(
    st.builds(CanFrame, st.integers(0, 0x7FF), st.binary(max_size=8)),
    st.builds(
        lambda can_id, data: CanFrame(can_id | EXTENDED_FLAG, data), st.integers(0, 2**29 - 1), st.binary(max_size=8)
    ),
    st.builds(
        lambda can_id, length: CanFrame(can_id | REMOTE_FLAG, bytes(length)), st.integers(0, 0x7FF), st.integers(0, 8)
    ),
    st.builds(
        lambda classes, data: CanFrame(classes | ERROR_FLAG, data),
        st.integers(0, 2**29 - 1),
        st.binary(min_size=8, max_size=8),
    ),
)


@given(frames)
def test_a_frame_becomes_a_message_and_the_same_frame_again(frame):
    message = message_of(frame, 12.5, "local:x")
    assert record_of(message) == pack_records([frame])
    assert (message.timestamp, message.channel) == (12.5, "local:x")


def test_a_can_fd_message_has_no_record():
    assert record_of(can.Message(arbitration_id=1, is_fd=True, data=bytes(12))) is None
