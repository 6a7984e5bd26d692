"""Injection points: values of a service that only a fault or a quirk changes, and a filter between node and wire.

A node depends on these alone; `fault_table` has the faults, `quirks` the quirks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

if TYPE_CHECKING:
    from canopen_control.frame import CanFrame


T = TypeVar("T")


class InjectionPoint(Generic[T]):
    """A `value` that is `healthy` until a fault is injected; the service that declares it defines the values."""

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
    """Quirks of a node: differences from the standards of a healthy drive of its manufacturer."""

    @property
    def active(self) -> list[str]:
        """The active quirks as they are written, ``NAME``, ``NAME=VALUE`` or ``NAME=VALUE@AXIS``."""

    def set(self, text: str, on: bool, now: int) -> None:
        """Switch a quirk; ConfigError for one that the node cannot have."""


class FaultFilter(Protocol):
    """Faults of a node that act on its frames, between the node and the wire."""

    @property
    def active(self) -> list[str]:
        """Names of the active faults."""

    def set(self, name: str, on: bool, now: int) -> None:
        """Switch a fault; ConfigError for an unknown name."""

    def set_quirks(self, outgoing: tuple[Any, ...], incoming: tuple[Any, ...]) -> None:
        """Let these functions of quirks, and no others, change the frames of the node."""

    def incoming(self, frame: CanFrame, now: int) -> CanFrame | None:
        """Return the frame that the node receives; None: it is lost."""

    def outgoing(self, frames: list[CanFrame], now: int) -> list[CanFrame]:
        """Return the frames that leave the node now."""

    def tick(self, now: int) -> None:
        """Advance to `now`."""

    def next_deadline(self) -> int | None:
        """Return the time of the next event."""
