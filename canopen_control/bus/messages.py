"""python-can's messages and our records, each made from the other."""

from __future__ import annotations

import can

from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, RECORD, REMOTE_FLAG, CanFrame

__all__ = ["message_of", "record_of"]

_IDENTIFIER = 0x1FFFFFFF


def message_of(frame: CanFrame, timestamp: float, channel: str | None = None) -> can.Message:
    """Return a received frame as a message; `timestamp` is unix seconds."""
    remote = frame.is_remote
    return can.Message(
        timestamp=timestamp,
        arbitration_id=frame.can_id & _IDENTIFIER,
        is_extended_id=bool(frame.can_id & EXTENDED_FLAG),
        is_remote_frame=remote,
        is_error_frame=frame.is_error,
        channel=channel,
        dlc=len(frame.data),
        data=None if remote else frame.data,
    )


def record_of(message: can.Message) -> bytes | None:
    """Return a message as a record; None for a CAN FD frame, which CANopen does not know."""
    if message.is_fd:
        return None
    can_id = message.arbitration_id & _IDENTIFIER
    if message.is_error_frame:
        can_id |= ERROR_FLAG
    elif message.is_extended_id:
        can_id |= EXTENDED_FLAG
    if message.is_remote_frame:
        return RECORD.pack(can_id | REMOTE_FLAG, min(message.dlc, 8), b"")
    return RECORD.pack(can_id, min(message.dlc, 8), bytes(message.data))
