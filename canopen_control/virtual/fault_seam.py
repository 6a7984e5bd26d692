"""Seams where injected faults act: values of a service that only a fault changes, and between node and wire.

This is all that a healthy node knows of faults; what they do is in `fault_table`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

if TYPE_CHECKING:
    from canopen_control.frame import CanFrame


T = TypeVar("T")


class Seam(Generic[T]):
    """A `value` that is `healthy` unless a fault is on; the service that declares it says what it does."""

    __slots__ = ("healthy", "value")

    def __init__(self, healthy: T) -> None:
        self.healthy = self.value = healthy

    def break_with(self, value: T) -> None:
        """Act as the fault says."""
        self.value = value

    def switch(self, on: bool, value: T) -> None:
        """Act as the fault says while it is `on`, else as a healthy device does."""
        self.value = value if on else self.healthy

    def heal(self) -> None:
        """Act as a healthy device does."""
        self.value = self.healthy


class FaultFilter(Protocol):
    """What a node knows of the faults that are injected into it: they stand between it and the wire."""

    @property
    def active(self) -> list[str]:
        """The names of the faults that are on."""

    def set(self, name: str, on: bool, now: int) -> None:
        """Switch a fault; no-op where it is as wanted. ConfigError for an unknown name."""

    def incoming(self, frame: CanFrame, now: int) -> CanFrame | None:
        """Return what the node hears."""

    def outgoing(self, frames: list[CanFrame], now: int) -> list[CanFrame]:
        """Return what leaves the node now."""

    def tick(self, now: int) -> None:
        """Let time pass."""

    def next_deadline(self) -> int | None:
        """Return when something is due."""
