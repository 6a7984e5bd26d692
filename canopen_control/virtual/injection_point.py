"""Injection points: values of services that only a fault or a quirk changes, and a filter between node and wire.

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
        """Set the value that a fault causes."""
        self.value = value

    def switch(self, on: bool, value: T) -> None:
        """Set `value` while the fault is `on`, else restore the healthy value."""
        self.value = value if on else self.healthy

    def clear(self) -> None:
        """Restore the healthy value."""
        self.value = self.healthy


class NodeQuirks(Protocol):
    """Interface to the quirks of a node: deviations of a manufacturer's healthy drive from the standards."""

    @property
    def active(self) -> list[str]:
        """Active quirks as text: ``NAME``, ``NAME=VALUE`` or ``NAME=VALUE@AXIS``."""

    def set(self, text: str, on: bool, now: int) -> None:
        """Enable or disable a quirk; raise ConfigError if the node cannot have it."""


class FaultFilter(Protocol):
    """Interface of the filter between a node and the wire that applies faults and quirks to frames."""

    @property
    def active(self) -> list[str]:
        """Names of the active faults."""

    def set(self, name: str, on: bool, now: int) -> None:
        """Switch a fault on or off; raise ConfigError if it is unknown or does not fit the node."""

    def set_quirks(self, outgoing: tuple[Any, ...], incoming: tuple[Any, ...]) -> None:
        """Set the functions by which quirks change the node's frames, replacing earlier functions."""

    def incoming(self, frame: CanFrame, now: int) -> CanFrame | None:
        """Return the frame as the node receives it, None if it is lost."""

    def outgoing(self, frames: list[CanFrame], now: int) -> list[CanFrame]:
        """Return the frames that leave the node now; delayed frames are stored."""

    def tick(self, now: int) -> None:
        """Switch on the scheduled faults and release the delayed frames that are due at `now`."""

    def next_deadline(self) -> int | None:
        """Return the time in ns at which `tick` is due next, None without one."""
