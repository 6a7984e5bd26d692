"""What happens to a virtual node, in words, for its log.

The law of this file: one line for each event, in the standard's terms; what nobody needs to read has no words.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.emcy_codes import error_text
from canopen_control.cia301.nmt import NmtStateChanged
from canopen_control.cia402.modes import mode_name
from canopen_control.virtual.events import (
    BitRateActivated,
    DriveFaulted,
    DriveStateChanged,
    EmergencyRaised,
    FaultSwitched,
    HeartbeatMissed,
    ModeChanged,
    NodeIdChanged,
)

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["in_words"]


def _axis(axis: int) -> str:
    return f"axis {axis}: " if axis else ""


def _emergency(event: EmergencyRaised) -> str:
    if event.code == 0:
        return "error reset"
    extra = f", data {event.data.hex(' ')}" if any(event.data) else ""
    return f"EMCY 0x{event.code:04X} ({error_text(event.code)}){extra}"


def _missed(event: HeartbeatMissed) -> str:
    who = f"heartbeat of node {event.node_id}" if event.node_id else "guarding"
    return f"{who} {'lost' if event.missed else 'is back'}"


_WORDS: dict[type, Callable[..., str]] = {
    NmtStateChanged: lambda event: f"NMT {event.state.name}",
    DriveStateChanged: lambda event: f"{_axis(event.axis)}{event.previous.name} -> {event.state.name}",
    DriveFaulted: lambda event: f"{_axis(event.axis)}fault 0x{event.code:04X} ({error_text(event.code)})",
    ModeChanged: lambda event: f"{_axis(event.axis)}mode {mode_name(event.mode)}",
    EmergencyRaised: _emergency,
    HeartbeatMissed: _missed,
    NodeIdChanged: lambda event: f"LSS: node id {event.node_id}",
    BitRateActivated: lambda event: f"LSS: bit rate {event.bitrate or 'detected by itself'}",
    FaultSwitched: lambda event: f"fault {event.name} {'on' if event.on else 'off'}",
}


def in_words(event: object) -> str | None:
    """Return the line of an event, None for one that has no words."""
    words = _WORDS.get(type(event))
    return None if words is None else words(event)
