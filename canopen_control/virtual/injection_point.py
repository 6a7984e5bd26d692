"""Injection points: service values that only a fault or a quirk changes, and a filter between node and wire.

A node depends on these alone; `fault_table` has the faults, `quirks` the quirks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

if TYPE_CHECKING:
    from canopen_control.frame import CanFrame


T = TypeVar("T")


class InjectionPoint(Generic[T]):
    """Point with a `value` that is `healthy` without a fault; the service that declares it defines the values."""

    __slots__ = ("healthy", "value")

    def __init__(self, healthy: T) -> None:
        self.healthy = self.value = healthy

    def inject(self, value: T) -> None:
        """Set the value of a fault."""
        self.value = value

    def switch(self, on: bool, value: T) -> None:
        """Set the value of a fault while it is `on`, else the healthy one."""
        self.value = value if on else self.healthy

    def clear(self) -> None:
        """Restore the healthy value."""
        self.value = self.healthy


class NodeQuirks(Protocol):
    """Quirks of a node: deviations of a manufacturer's healthy drive from the standards."""

    @property
    def active(self) -> list[str]:
        """Active quirks as text: ``NAME``, ``NAME=VALUE`` or ``NAME=VALUE@AXIS``."""

    def set(self, text: str, on: bool, now: int) -> None:
        """Switch a quirk; ConfigError if the node cannot have it."""


class FaultFilter(Protocol):
    """Faults of a node that act on its frames, between the node and the wire."""

    @property
    def active(self) -> list[str]:
        """Names of the active faults."""

    def set(self, name: str, on: bool, now: int) -> None:
        """Switch a fault; ConfigError for an unknown name."""

    def set_quirks(self, outgoing: tuple[Any, ...], incoming: tuple[Any, ...]) -> None:
        """Set the functions of quirks that change the node's frames, replacing earlier ones."""

    def incoming(self, frame: CanFrame, now: int) -> CanFrame | None:
        """Return the frame received by the node; None: it is lost."""

    def outgoing(self, frames: list[CanFrame], now: int) -> list[CanFrame]:
        """Return the frames that leave the node now."""

    def tick(self, now: int) -> None:
        """Advance to `now`."""

    def next_deadline(self) -> int | None:
        """Return the time of the next event."""
