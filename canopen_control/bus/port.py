"""The port: what every CAN channel offers to its owner.

Rule 1: frames cross it as whole 16-byte records (`canopen_control.frame`), many at once. Rule 2: no verb waits; the
owner's reactor does, on `fileno()`, and on its writability while `wants_write`. Rule 3: what does not fit is dropped,
counted in `stats` and told as an event; nothing is lost silently. Rule 4: the only errors are `BusClosed`, and
`LocalProtocolError` for what is no record.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Protocol

from canopen_control.errors import LocalProtocolError
from canopen_control.frame import RECORD_SIZE

__all__ = ["BusEvent", "BusEventKind", "Port", "PortStats", "Records", "whole_records"]

Records = bytes | bytearray | memoryview
"""Frames, 16 bytes each, one after the other."""


class BusEventKind(enum.Enum):
    """What may happen to a channel; the controller's states are those of ISO 11898-1."""

    BUS_OFF = "bus-off"
    ERROR_PASSIVE = "error-passive"
    ERROR_ACTIVE = "error-active"
    DOWN = "down"
    UP = "up"
    OVERRUN = "overrun"
    CLOSED = "closed"


@dataclass(frozen=True, slots=True)
class BusEvent:
    """Something happened to the channel; `text` is one sentence for people."""

    kind: BusEventKind
    text: str


@dataclass(slots=True)
class PortStats:
    """Counters of a port since it was opened, in frames; `queued` is how many wait for the kernel now.

    `rx` includes error frames, which `errors` counts too. `tx` is what `send` was given. `lost` counts both directions.
    """

    rx: int = 0
    tx: int = 0
    lost: int = 0
    errors: int = 0
    queued: int = 0


class Port(Protocol):
    """One opened CAN channel, of whatever kind. A sender never receives its own frames."""

    @property
    def channel(self) -> str:
        """The channel as the user wrote it, such as ``local:robby``."""

    @property
    def stats(self) -> PortStats:
        """The live counters."""

    @property
    def wants_write(self) -> bool:
        """Whether frames wait for the kernel: call `flush` when the file descriptor is writable."""

    def fileno(self) -> int:
        """Return the descriptor that is readable when `receive` or `events` may return something."""

    def receive(self) -> bytes:
        """Return the whole records that wait, or ``b""``; raise `BusClosed` when the channel is gone."""

    def send(self, records: Records) -> None:
        """Send whole records, in order; what the kernel does not take now is queued, the oldest dropped when full.

        Raise `BusClosed` when the channel is gone.
        """

    def flush(self) -> None:
        """Hand queued records to the kernel as far as it takes them; raise `BusClosed` when the channel is gone."""

    def events(self) -> list[BusEvent]:
        """Return what happened since the last call."""

    def close(self) -> None:
        """Leave the channel; a second call does nothing."""


def whole_records(records: Records) -> int:
    """Return how many records there are; raise `LocalProtocolError` if the last one is cut."""
    size = len(records)
    if size % RECORD_SIZE:
        raise LocalProtocolError(f"{size} bytes are no whole number of {RECORD_SIZE}-byte records")
    return size // RECORD_SIZE
