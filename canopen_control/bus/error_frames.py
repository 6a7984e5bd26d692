"""Error frames: how a CAN controller tells its own state, in the layout of linux/can/error.h.

They are records with `ERROR_FLAG`; the identifier holds classes, the data details. The same layout serves on every
channel, so that bus-off on ``local:`` and on a real controller look the same to the owner of a port. What they mean in
words is in `error_events`; the hub, which starts fast, has no use for words.
"""

from __future__ import annotations

import struct
import sys
from typing import TYPE_CHECKING, Final

from canopen_control.bus.port import BusEvent, BusEventKind
from canopen_control.frame import ERROR_FLAG, RECORD_SIZE, CanFrame, frames_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.bus.port import PortStats, Records


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
_FLAG_BYTE = 3 if sys.byteorder == "little" else 0  # of the record: the identifier's highest byte, with the flags
_ALL_PLAIN = bytes(65536)


def _frame(error_class: int, detail: int = 0, counters: bytes = bytes(2)) -> CanFrame:
    return CanFrame(ERROR_FLAG | error_class, bytes((0, detail, 0, 0, 0, 0)) + counters)


def bus_off_frame() -> CanFrame:
    """Make the report that the controller left the bus."""
    return _frame(BUS_OFF)


def restarted_frame() -> CanFrame:
    """Make the report that the controller is back after bus-off."""
    return _frame(RESTARTED)


def passive_frame() -> CanFrame:
    """Make the report of an error-passive controller, both counters at 128."""
    return _frame(CONTROLLER | COUNTERS, PASSIVE, bytes((128, 128)))


def active_frame() -> CanFrame:
    """Make the report that the controller is error-active again."""
    return _frame(CONTROLLER, ACTIVE_AGAIN)


def protocol_error_frame() -> CanFrame:
    """Make the report of one disturbed frame on the wire."""
    return _frame(PROTOCOL)


def overrun_frame(lost: int) -> CanFrame:
    """Make the report that this reader lost `lost` frames; the number travels in the last four bytes.

    The first byte, which has no meaning in this class, tells it from the report of a controller, which knows no number.
    """
    data = bytes((_WITH_NUMBER, RX_OVERFLOW, 0, 0)) + _U32.pack(min(lost, 0xFFFFFFFF))
    return CanFrame(ERROR_FLAG | CONTROLLER, data)


def lost_frames(frame: CanFrame) -> int:
    """Return the number in an `overrun_frame`, 0 for any other frame."""
    if frame.can_id != ERROR_FLAG | CONTROLLER or frame.data[:2] != bytes((_WITH_NUMBER, RX_OVERFLOW)):
        return 0
    lost: int = _U32.unpack_from(frame.data, 4)[0]
    return lost


def has_error_frames(records: bytes) -> bool:
    """Whether a record may be an error frame; exact for 11-bit frames, and no work per frame."""
    flags = records[_FLAG_BYTE::RECORD_SIZE]
    return flags != _ALL_PLAIN[: len(flags)]


def error_frames(records: Records) -> Iterator[CanFrame]:
    """Yield the error frames among `records`."""
    return (frame for frame in frames_of(records) if frame.can_id & ERROR_FLAG and len(frame.data) == 8)


# What error frames tell: events with a sentence for people, and all of it as text for a trace.
#
# Classes and details are those of linux/can/error.h.


def _controller_events(detail: int, counters: str) -> Iterator[BusEvent]:
    if detail & PASSIVE:
        yield BusEvent(
            BusEventKind.ERROR_PASSIVE,
            f"the CAN controller is error-passive{counters}; check the cable, the terminators and the bit rate",
        )
    if detail & ACTIVE_AGAIN:
        yield BusEvent(BusEventKind.ERROR_ACTIVE, f"the CAN controller is error-active again{counters}")
    if detail & RX_OVERFLOW:
        yield BusEvent(BusEventKind.OVERRUN, "receive overrun: frames came faster than they were read")
    if detail & TX_OVERFLOW:
        yield BusEvent(BusEventKind.OVERRUN, "transmit overrun in the CAN controller")


def events_of(frame: CanFrame) -> list[BusEvent]:
    """Return what an error frame tells; a lone bus error tells nothing but itself and is only counted.

    Bus-off is the whole news of its frame: some adapters tell in the same one how passive the controller was before.
    """
    if frame.can_id & BUS_OFF:
        return [BusEvent(BusEventKind.BUS_OFF, "bus-off; check the cable, the terminators and the bit rate")]
    events: list[BusEvent] = []
    if frame.can_id & CONTROLLER:
        counters = ""
        if frame.can_id & COUNTERS:
            counters = f" (transmit errors {frame.data[6]}, receive errors {frame.data[7]})"
        lost = lost_frames(frame)
        if lost:
            events.append(BusEvent(BusEventKind.OVERRUN, f"receive overrun: {lost} frames lost, read more often"))
        else:
            events += _controller_events(frame.data[1], counters)
    if frame.can_id & RESTARTED:
        events.append(BusEvent(BusEventKind.ERROR_ACTIVE, "the CAN controller was restarted after bus-off"))
    return events


def note_errors(records: Records, stats: PortStats) -> list[BusEvent]:
    """Count the error frames among received records, and return what they tell."""
    events: list[BusEvent] = []
    for frame in error_frames(records):
        stats.errors += 1
        stats.lost += lost_frames(frame)
        events += events_of(frame)
    return events


# All that an error frame says -------------------------------------------------------------------------------------

_FULL_LENGTH: Final = 8
_CLASSES: Final = 0x1FFFFFFF
_ACKNOWLEDGE_SLOT: Final = 0x19
_WHILE_SENDING: Final = 0x80
_NOBODY: Final = "nobody acknowledged the frame: is another node on the bus, with power and the same bit rate?"
_WARNINGS: Final = {
    RX_WARNING: "the receive errors have reached the warning level, 96",
    TX_WARNING: "the transmit errors have reached the warning level, 96",
}
_VIOLATIONS: Final = {  # data[2]
    0x01: "bit error",
    0x02: "form error",
    0x04: "stuff error",
    0x08: "a dominant bit could not be sent",
    0x10: "a recessive bit could not be sent",
    0x20: "overload",
    0x40: "active error flag",
}
_PLACES: Final = {  # data[3], as an SJA1000 tells it
    0x02: "identifier bits 28 to 21",
    0x03: "start of frame",
    0x04: "SRR or RTR bit",
    0x05: "IDE bit",
    0x06: "identifier bits 20 to 18",
    0x07: "identifier bits 17 to 13",
    0x08: "CRC",
    0x09: "reserved bit 0",
    0x0A: "data",
    0x0B: "data length code",
    0x0C: "RTR bit",
    0x0D: "reserved bit 1",
    0x0E: "identifier bits 4 to 0",
    0x0F: "identifier bits 12 to 5",
    0x11: "active error flag",
    0x12: "intermission",
    0x13: "dominant bits that are tolerated",
    0x16: "passive error flag",
    0x17: "error delimiter",
    0x18: "CRC delimiter",
    _ACKNOWLEDGE_SLOT: "acknowledge slot",
    0x1A: "end of frame",
    0x1B: "acknowledge delimiter",
    0x1C: "overload flag",
}
_WIRES: Final = {  # data[4], the low half of CANH, the high half of CANL
    0x04: "CANH has no wire",
    0x05: "CANH is shorted to the battery",
    0x06: "CANH is shorted to the supply",
    0x07: "CANH is shorted to ground",
    0x40: "CANL has no wire",
    0x50: "CANL is shorted to the battery",
    0x60: "CANL is shorted to the supply",
    0x70: "CANL is shorted to ground",
    0x80: "CANL is shorted to CANH",
}
_EVERY_CLASS: Final = (
    TX_TIMEOUT
    | ARBITRATION
    | CONTROLLER
    | PROTOCOL
    | TRANSCEIVER
    | NO_ACKNOWLEDGE
    | BUS_OFF
    | BUS_ERROR
    | RESTARTED
    | COUNTERS
)


def error_text(frame: CanFrame) -> str:
    """Return all that an error frame says, by its classes; never empty. One that is cut is read as if with zeros."""
    frame = CanFrame(frame.can_id, frame.data[:_FULL_LENGTH].ljust(_FULL_LENGTH, b"\0"))
    text = "; ".join(_parts(frame))
    if frame.can_id & COUNTERS and not lost_frames(frame):
        counters = f"transmit errors {frame.data[6]}, receive errors {frame.data[7]}"
        if counters not in text:
            text = f"{text} ({counters})" if text else f"error counters: {counters}"
    return text or "the CAN controller reports an error without its class"


def _parts(frame: CanFrame) -> Iterator[str]:
    classes, data = frame.can_id & _CLASSES, frame.data
    if classes & TX_TIMEOUT:
        yield "transmit time-out: the CAN controller did not send a frame in time"
    if classes & ARBITRATION:
        yield "arbitration lost" + (f" at bit {data[0]}" if data[0] else "")
    yield from (event.text for event in events_of(frame))
    if classes & CONTROLLER and not lost_frames(frame):
        yield from (text for bit, text in _WARNINGS.items() if data[1] & bit)
        if not data[1] and not classes & BUS_OFF:
            yield "a problem of the CAN controller, without detail"
    if classes & NO_ACKNOWLEDGE:
        yield _NOBODY
    if classes & (PROTOCOL | BUS_ERROR):
        yield _disturbance(classes, data)
    if classes & TRANSCEIVER:
        found = [text for code, text in _WIRES.items() if code in (data[4] & 0x0F, data[4] & 0xF0)]
        yield "transceiver: " + (", ".join(found) or "a problem without detail")
    if unknown := classes & ~_EVERY_CLASS:
        yield f"a class of errors without a name, 0x{unknown:X}"


def _disturbance(classes: int, data: bytes) -> str:
    """Return what disturbed a frame, and where in it, as far as the controller says it."""
    text = "bus error: a frame was disturbed"
    if not classes & PROTOCOL:
        return text
    what = ", ".join(name for bit, name in _VIOLATIONS.items() if data[2] & bit)
    where = _PLACES.get(data[3], "")
    text = f"bus error: {what or 'a frame was disturbed'}"
    text += " while sending" if data[2] & _WHILE_SENDING else ""
    text += f", at: {where}" if where else ""
    unheard = data[3] == _ACKNOWLEDGE_SLOT and data[2] & _WHILE_SENDING
    return f"{text}; {_NOBODY}" if unheard and not classes & NO_ACKNOWLEDGE else text
