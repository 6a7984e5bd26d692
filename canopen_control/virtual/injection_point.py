"""Injection points: values that only faults and quirks change; and the filter between node and wire.

A node depends only on this module; the faults are in `fault_table`, the quirks in `quirks`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

if TYPE_CHECKING:
    from canopen_control.frame import CanFrame


T = TypeVar("T")


class InjectionPoint(Generic[T]):
    """Value of a service that faults and quirks can change; `healthy` is the value without a fault."""

    __slots__ = ("healthy", "value")

    def __init__(self, healthy: T) -> None:
        self.healthy = self.value = healthy

    def inject(self, value: T) -> None:
        self.value = value

    def switch(self, on: bool, value: T) -> None:
        """Set `value` while the fault is `on`, otherwise restore the healthy value."""
        self.value = value if on else self.healthy

    def clear(self) -> None:
        """Restore the healthy value."""
        self.value = self.healthy


class NodeQuirks(Protocol):
    """Quirks of a node: deviations of a manufacturer's healthy drive from the standards."""

    @property
    def active(self) -> list[str]:
        """Active quirks as text: ``NAME``, ``NAME=VALUE``, ``NAME@AXIS`` or ``NAME=VALUE@AXIS``."""

    def set(self, text: str, on: bool, now: int) -> None:
        """Enable or disable a quirk; raise ConfigError if the node cannot have it."""


class FaultFilter(Protocol):
    """Filter between a node and the wire that applies faults and quirks to frames."""

    @property
    def active(self) -> list[str]:
        """Names of the active faults."""

    def set(self, name: str, on: bool, now: int) -> None:
        """Switch a fault on or off; raise ConfigError for a fault that is unknown or impossible on the node."""

    def set_quirks(self, outgoing: tuple[Any, ...], incoming: tuple[Any, ...]) -> None:
        """Replace the functions with which quirks change the frames of the node."""

    def incoming(self, frame: CanFrame, now: int) -> CanFrame | None:
        """Return a received frame as changed by faults and quirks, or None if the frame is lost."""

    def outgoing(self, frames: list[CanFrame], now: int) -> list[CanFrame]:
        """Return the frames to send now; delayed frames are stored until they are due."""

    def tick(self, now: int) -> None:
        """Switch on the faults scheduled for `now`, and release delayed frames that are due."""

    def next_deadline(self) -> int | None:
        """Return the time in ns at which `tick` is next due, or None if nothing is scheduled or delayed."""
