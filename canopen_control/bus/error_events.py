"""What error frames tell, as events with a sentence for people (classes and details as in linux/can/error.h)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.bus.error_frames import (
    ACTIVE_AGAIN,
    BUS_OFF,
    CONTROLLER,
    COUNTERS,
    PASSIVE,
    RESTARTED,
    RX_OVERFLOW,
    TX_OVERFLOW,
    error_frames,
    lost_frames,
)
from canopen_control.bus.port import BusEvent, BusEventKind

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.bus.port import PortStats, Records
    from canopen_control.frame import CanFrame

__all__ = ["events_of", "note_errors"]


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
