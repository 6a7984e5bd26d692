"""Error frames as Linux's drivers make them, of the kernels 6.1 to 6.12: what happened, and the record that tells it.

Made after the drivers' code and linux/can/error.h, not recorded on a bus: sja1000 (Kvaser, PEAK and ESD cards), mcp251x
(Raspberry Pi hats), gs_usb with the firmware candleLight, which makes its frames itself, and peak_usb; a restart is the
kernel's own (can/dev). Data bytes: 0 arbitration lost at which bit, 1 controller, 2 and 3 protocol and where, 6 and 7
transmit and receive errors.
"""

from __future__ import annotations

from typing import NamedTuple

from canopen_control.bus.port import BusEventKind
from canopen_control.frame import CanFrame

OFF, PASSIVE, ACTIVE, OVERRUN = (
    BusEventKind.BUS_OFF,
    BusEventKind.ERROR_PASSIVE,
    BusEventKind.ERROR_ACTIVE,
    BusEventKind.OVERRUN,
)


class DriverFrame(NamedTuple):
    """`kinds` are the events that it is to make; `counters` the transmit and receive errors that they name, if any."""

    driver: str
    meaning: str
    frame: CanFrame
    kinds: tuple[BusEventKind, ...] = ()
    counters: tuple[int, int] | None = None


def _row(driver: str, meaning: str, can_id: int, data: str, *rest: object) -> DriverFrame:
    return DriverFrame(driver, meaning, CanFrame(0x20000000 | can_id, bytes.fromhex(data)), *rest)  # type: ignore[arg-type]  # a table


DRIVER_FRAMES = (
    _row("sja1000", "transmit errors reach 96", 0x204, "00 08 00 00 00 00 60 00"),
    _row("sja1000", "receive errors reach 96", 0x204, "00 04 00 00 00 00 00 61"),
    _row("sja1000", "passive by transmit errors", 0x204, "00 20 00 00 00 00 80 00", (PASSIVE,), (128, 0)),
    _row("sja1000", "passive by receive errors", 0x204, "00 10 00 00 00 00 00 88", (PASSIVE,), (0, 136)),
    _row("sja1000", "passive by both", 0x204, "00 30 00 00 00 00 80 80", (PASSIVE,), (128, 128)),
    _row("sja1000", "from passive to warning", 0x204, "00 08 00 00 00 00 7F 00"),
    _row("sja1000", "active again", 0x204, "00 40 00 00 00 00 5F 00", (ACTIVE,), (95, 0)),
    _row("sja1000", "data overrun", 0x204, "00 01 00 00 00 00 00 00", (OVERRUN,)),
    _row("sja1000", "data overrun of a passive one", 0x204, "00 21 00 00 00 00 80 00", (PASSIVE, OVERRUN), (128, 0)),
    _row("sja1000", "nobody acknowledges, berr-reporting on", 0x288, "00 00 80 19 00 00 80 00"),
    _row("sja1000", "stuff error while it received", 0x288, "00 00 04 0A 00 00 00 01"),
    _row("sja1000", "arbitration lost at bit 5", 0x202, "05 00 00 00 00 00 00 00"),
    _row("sja1000", "bus-off", 0x040, "00 00 00 00 00 00 00 00", (OFF,)),
    _row("can/dev", "restarted, by restart-ms or by hand", 0x100, "00 00 00 00 00 00 00 00", (ACTIVE,)),
    _row("mcp251x", "transmit warning", 0x004, "00 08 00 00 00 00 00 00"),
    _row("mcp251x", "passive by transmit errors", 0x004, "00 20 00 00 00 00 00 00", (PASSIVE,)),
    _row("mcp251x", "passive by receive errors", 0x004, "00 10 00 00 00 00 00 00", (PASSIVE,)),
    _row("mcp251x", "active again: it says nothing at all", 0x000, "00 00 00 00 00 00 00 00"),
    _row("mcp251x", "both receive buffers were full", 0x004, "00 01 00 00 00 00 00 00", (OVERRUN,)),
    _row("mcp251x", "bus-off", 0x040, "00 00 00 00 00 00 00 00", (OFF,)),
    _row("gs_usb", "warning, both ways", 0x004, "00 0C 00 00 00 00 60 10"),
    _row("gs_usb", "passive, both ways", 0x004, "00 30 00 00 00 00 80 00", (PASSIVE,)),
    _row("gs_usb", "passive because nobody acknowledges", 0x024, "00 30 00 00 00 00 80 00", (PASSIVE,)),
    _row("gs_usb", "passive, firmware that marks its counters", 0x204, "00 30 00 00 00 00 80 07", (PASSIVE,), (128, 7)),
    _row("gs_usb", "a bit error", 0x00C, "00 00 10 00 00 00 08 00"),
    _row("gs_usb", "bus-off, with the class of the controller", 0x044, "00 00 00 00 00 00 F8 00", (OFF,)),
    _row("gs_usb", "bus-off, straight from active", 0x044, "00 30 00 00 00 00 F8 00", (OFF,)),
    _row("gs_usb", "a receive overflow in the adapter", 0x004, "00 01 00 00 00 00 00 00", (OVERRUN,)),
    _row("peak_usb", "warning", 0x204, "00 08 00 00 00 00 60 00"),
    _row("peak_usb", "passive", 0x204, "00 20 00 00 00 00 80 00", (PASSIVE,), (128, 0)),
    _row("peak_usb", "active again", 0x204, "00 40 00 00 00 00 00 00", (ACTIVE,), (0, 0)),
    _row("peak_usb", "a receive overflow in the adapter", 0x204, "00 01 00 00 00 00 00 00", (OVERRUN,)),
    _row("peak_usb", "bus-off", 0x040, "00 00 00 00 00 00 00 00", (OFF,)),
)
NAMES = [f"{row.driver}: {row.meaning}" for row in DRIVER_FRAMES]
