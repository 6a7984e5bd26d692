"""Events of a virtual node in `VirtualNode.events`, next to `NmtStateChanged`.

`in_words` makes each the line of a log, in the standard's terms; what nobody needs to read has no words.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.cia301.emcy import error_text
from canopen_control.cia301.nmt import NmtStateChanged
from canopen_control.cia402.modes import mode_name

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.cia402.state import State


@dataclass(frozen=True, slots=True)
class DriveStateChanged:
    """The power state machine moved."""

    axis: int
    previous: State
    state: State


@dataclass(frozen=True, slots=True)
class DriveFaulted:
    """Fault with its EMCY `code`."""

    axis: int
    code: int


@dataclass(frozen=True, slots=True)
class ControlwordIgnored:
    """Controlword for a transition that the axis refuses, and the reason."""

    axis: int
    controlword: int
    why: str


@dataclass(frozen=True, slots=True)
class ModeChanged:
    """Change of the mode in 0x6061."""

    axis: int
    mode: int


@dataclass(frozen=True, slots=True)
class EmergencyRaised:
    """The node reports an error; 0: error reset."""

    code: int
    data: bytes = b""


@dataclass(frozen=True, slots=True)
class HeartbeatMissed:
    """Missing or returned heartbeat of a node in 0x1016 (0: of the guarding master)."""

    node_id: int
    missed: bool


@dataclass(frozen=True, slots=True)
class FaultSwitched:
    """Fault switched on or off."""

    name: str
    on: bool


@dataclass(frozen=True, slots=True)
class QuirkSwitched:
    """Quirk switched on or off; `text` includes strength and axis."""

    text: str
    on: bool


@dataclass(frozen=True, slots=True)
class NodeIdChanged:
    """Change of the node id by LSS."""

    node_id: int


@dataclass(frozen=True, slots=True)
class BitRateActivated:
    """Change of the bit rate by LSS, in bit/s; 0: automatic detection."""

    bitrate: int


@dataclass(frozen=True, slots=True)
class PdoLeftOff:
    """PDO marked valid in its record but disabled for an invalid COB-ID; `kind` is RPDO or TPDO."""

    kind: str
    number: int
    cob_id: int


def _axis(axis: int) -> str:
    return f"axis {axis}: " if axis else ""


def _emergency(event: EmergencyRaised) -> str:
    if event.code == 0:
        return "error reset"
    extra = f", data {event.data.hex(' ')}" if any(event.data) else ""
    return f"EMCY 0x{event.code:04X} ({error_text(event.code)}){extra}"


def _missed(event: HeartbeatMissed) -> str:
    sender = f"heartbeat of node {event.node_id}" if event.node_id else "guarding"
    return f"{sender} {'lost' if event.missed else 'is back'}"


_WORDS: dict[type, Callable[..., str]] = {
    NmtStateChanged: lambda event: f"NMT {event.state.name}",
    DriveStateChanged: lambda event: f"{_axis(event.axis)}{event.previous.name} -> {event.state.name}",
    DriveFaulted: lambda event: f"{_axis(event.axis)}fault 0x{event.code:04X} ({error_text(event.code)})",
    ControlwordIgnored: lambda event: f"{_axis(event.axis)}controlword 0x{event.controlword:04X} ignored: {event.why}",
    ModeChanged: lambda event: f"{_axis(event.axis)}mode {mode_name(event.mode)}",
    EmergencyRaised: _emergency,
    HeartbeatMissed: _missed,
    NodeIdChanged: lambda event: f"LSS: node id {event.node_id}",
    PdoLeftOff: lambda event: (
        f"{event.kind} {event.number} stays off: its COB-ID 0x{event.cob_id:03X} is reserved, or has another user"
    ),
    BitRateActivated: lambda event: f"LSS: bit rate {event.bitrate or 'detected by itself'}",
    FaultSwitched: lambda event: f"fault {event.name} {'on' if event.on else 'off'}",
    QuirkSwitched: lambda event: f"quirk {event.text} {'on' if event.on else 'off'}",
}


def in_words(event: object) -> str | None:
    """Return the line of an event, None for one without text."""
    words = _WORDS.get(type(event))
    return None if words is None else words(event)
