"""Events of error frames as sentences for users, and the complete text of an error frame for a trace.

Classes and details are those of linux/can/error.h.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.bus.error_frames import (
    ACTIVE_AGAIN,
    ARBITRATION,
    BUS_ERROR,
    BUS_OFF,
    CONTROLLER,
    COUNTERS,
    NO_ACKNOWLEDGE,
    PASSIVE,
    PROTOCOL,
    RESTARTED,
    RX_OVERFLOW,
    RX_WARNING,
    TRANSCEIVER,
    TX_OVERFLOW,
    TX_TIMEOUT,
    TX_WARNING,
    error_frames,
    lost_frames,
)
from canopen_control.bus.port import BusEvent, BusEventKind
from canopen_control.frame import CanFrame

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.bus.port import PortStats, Records


def _controller_events(detail: int, counters: str) -> Iterator[BusEvent]:
    if detail & PASSIVE:
        yield BusEvent(
            BusEventKind.ERROR_PASSIVE,
            f"the CAN controller is error-passive{counters}; check the cable, the terminators and the bit rate",
        )
    if detail & ACTIVE_AGAIN:
        yield BusEvent(BusEventKind.ERROR_ACTIVE, f"the CAN controller is error-active again{counters}")
    if detail & RX_OVERFLOW:
        yield BusEvent(BusEventKind.OVERRUN, "receive overrun: frames arrived faster than they were read")
    if detail & TX_OVERFLOW:
        yield BusEvent(BusEventKind.OVERRUN, "transmit overrun in the CAN controller")


def events_of(frame: CanFrame) -> list[BusEvent]:
    """Return the events of an error frame; a mere bus error has none, and is only counted by `note_errors`.

    Bus-off hides the other events of its frame: some adapters report in the same frame that the controller was
    error-passive before.
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
    """Count the error frames among received records, and return their events."""
    events: list[BusEvent] = []
    for frame in error_frames(records):
        stats.errors += 1
        stats.lost += lost_frames(frame)
        events += events_of(frame)
    return events


# -- text of an error frame

_FULL_LENGTH: Final = 8
_CLASSES: Final = 0x1FFFFFFF
_ACKNOWLEDGE_SLOT: Final = 0x19
_WHILE_SENDING: Final = 0x80
_NOT_ACKNOWLEDGED: Final = (
    "no node acknowledged the frame; check that another node is powered and has the same bit rate"
)
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
_PLACES: Final = {  # data[3], with the codes of an SJA1000
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
    """Return a text, never empty, that describes all error classes of a frame; missing data bytes count as zero."""
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
            yield "a problem of the CAN controller without details"
    if classes & NO_ACKNOWLEDGE:
        yield _NOT_ACKNOWLEDGED
    if classes & (PROTOCOL | BUS_ERROR):
        yield _disturbance(classes, data)
    if classes & TRANSCEIVER:
        wires = [text for code, text in _WIRES.items() if code in (data[4] & 0x0F, data[4] & 0xF0)]
        yield "transceiver: " + (", ".join(wires) or "a problem without details")
    if unknown := classes & ~_EVERY_CLASS:
        yield f"unknown error class 0x{unknown:X}"


def _disturbance(classes: int, data: bytes) -> str:
    """Return the kind of a bus error and its position in the frame, as far as the controller reports them."""
    text = "bus error: a frame was disturbed"
    if not classes & PROTOCOL:
        return text
    violations = ", ".join(name for bit, name in _VIOLATIONS.items() if data[2] & bit)
    place = _PLACES.get(data[3], "")
    text = f"bus error: {violations or 'a frame was disturbed'}"
    text += " while sending" if data[2] & _WHILE_SENDING else ""
    text += f", at: {place}" if place else ""
    unheard = data[3] == _ACKNOWLEDGE_SLOT and data[2] & _WHILE_SENDING
    return f"{text}; {_NOT_ACKNOWLEDGED}" if unheard and not classes & NO_ACKNOWLEDGE else text
