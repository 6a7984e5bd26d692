"""What happens to a virtual node: what `VirtualNode.events` gives, beside the NMT's `NmtStateChanged`.

The law of this file: events tell, they decide nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_control.cia402.state import State

__all__ = [
    "BitRateActivated",
    "DriveFaulted",
    "DriveStateChanged",
    "EmergencyRaised",
    "FaultSwitched",
    "HeartbeatMissed",
    "ModeChanged",
    "NodeIdChanged",
]


@dataclass(frozen=True, slots=True)
class DriveStateChanged:
    """The power state machine moved."""

    axis: int
    previous: State
    state: State


@dataclass(frozen=True, slots=True)
class DriveFaulted:
    """A fault occurred; `code` is its EMCY code."""

    axis: int
    code: int


@dataclass(frozen=True, slots=True)
class ModeChanged:
    """0x6061 shows another mode."""

    axis: int
    mode: int


@dataclass(frozen=True, slots=True)
class EmergencyRaised:
    """The node reports an error; 0: error reset."""

    code: int
    data: bytes = b""


@dataclass(frozen=True, slots=True)
class HeartbeatMissed:
    """A node watched by 0x1016 (0: the guarding master) is silent, or heard again."""

    node_id: int
    missed: bool


@dataclass(frozen=True, slots=True)
class FaultSwitched:
    """A fault went on or off."""

    name: str
    on: bool


@dataclass(frozen=True, slots=True)
class NodeIdChanged:
    """LSS gave the node another id."""

    node_id: int


@dataclass(frozen=True, slots=True)
class BitRateActivated:
    """LSS switched the bit rate, in bit/s; 0: it is detected."""

    bitrate: int
