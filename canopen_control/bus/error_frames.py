"""Error frames of a CAN controller, in the layout of linux/can/error.h.

Error frames are records with `ERROR_FLAG`; the identifier contains classes, the data contain details. All channels use
the same layout, so that bus-off on ``local:`` and on a real controller are identical for the owner of a port. The texts
are in `error_events`, because the hub, which must start quickly, does not need them.
"""

from __future__ import annotations

import struct
import sys
from typing import TYPE_CHECKING

from canopen_control.frame import ERROR_FLAG, RECORD_SIZE, CanFrame, frames_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.bus.port import Records


# Error classes, in the identifier.
TX_TIMEOUT = 0x001
ARBITRATION = 0x002  # at which bit: data[0]
CONTROLLER = 0x004
PROTOCOL = 0x008  # data[2], where: data[3]
TRANSCEIVER = 0x010  # data[4]
NO_ACKNOWLEDGE = 0x020
BUS_OFF = 0x040
BUS_ERROR = 0x080
RESTARTED = 0x100
COUNTERS = 0x200  # transmit: data[6], receive: data[7]

# Controller details, in data[1].
RX_OVERFLOW = 0x01
TX_OVERFLOW = 0x02
RX_WARNING = 0x04
TX_WARNING = 0x08
PASSIVE = 0x30  # receive 0x10, transmit 0x20
ACTIVE_AGAIN = 0x40

_WITH_NUMBER = 0xFF
_U32 = struct.Struct("<I")
_FLAG_BYTE = 3 if sys.byteorder == "little" else 0  # highest byte of the identifier in a record, with the flags
_ALL_PLAIN = bytes(65536)


def _frame(error_class: int, detail: int = 0, counters: bytes = bytes(2)) -> CanFrame:
    return CanFrame(ERROR_FLAG | error_class, bytes((0, detail, 0, 0, 0, 0)) + counters)


def bus_off_frame() -> CanFrame:
    """Return the error frame of a controller that entered bus-off."""
    return _frame(BUS_OFF)


def restarted_frame() -> CanFrame:
    """Return the error frame of a controller that restarted after bus-off."""
    return _frame(RESTARTED)


def passive_frame() -> CanFrame:
    """Return the error frame of an error-passive controller, with both error counters at 128."""
    return _frame(CONTROLLER | COUNTERS, PASSIVE, bytes((128, 128)))


def active_frame() -> CanFrame:
    """Return the error frame of a controller that has become error-active again."""
    return _frame(CONTROLLER, ACTIVE_AGAIN)


def protocol_error_frame() -> CanFrame:
    """Return the error frame of one disturbed frame on the wire."""
    return _frame(PROTOCOL)


def overrun_frame(lost: int) -> CanFrame:
    """Return an error frame that reports `lost` frames lost by a reader; the number is in the last four bytes.

    The first byte, unused in this class, distinguishes the report from an overrun of a controller, which has no number.
    """
    data = bytes((_WITH_NUMBER, RX_OVERFLOW, 0, 0)) + _U32.pack(min(lost, 0xFFFFFFFF))
    return CanFrame(ERROR_FLAG | CONTROLLER, data)


def lost_frames(frame: CanFrame) -> int:
    """Return the number in an `overrun_frame`; 0 for any other frame."""
    if frame.can_id != ERROR_FLAG | CONTROLLER or frame.data[:2] != bytes((_WITH_NUMBER, RX_OVERFLOW)):
        return 0
    lost: int = _U32.unpack_from(frame.data, 4)[0]
    return lost


def has_error_frames(records: bytes) -> bool:
    """Whether records may contain error frames; also True if a frame has another flag (extended, remote)."""
    flags = records[_FLAG_BYTE::RECORD_SIZE]
    return flags != _ALL_PLAIN[: len(flags)]


def error_frames(records: Records) -> Iterator[CanFrame]:
    """Yield the error frames among `records`."""
    return (frame for frame in frames_of(records) if frame.can_id & ERROR_FLAG and len(frame.data) == 8)
