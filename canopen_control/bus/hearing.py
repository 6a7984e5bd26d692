"""Hearing less: a port may be told which identifiers its owner wants, so that nobody is woken for the others.

It is a wish: a port that cannot choose gives everything, and its owner ignores what is not his, as before. Who counts
frames (a bus load, unknown identifiers) counts what he hears. Error frames come always.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.bus.port import Port

__all__ = ["Selective", "hear_only"]


@runtime_checkable
class Selective(Protocol):
    """A port that can choose."""

    def hear(self, can_ids: Iterable[int]) -> None:
        """Give these identifiers only, with the flags of linux/can.h; a later call replaces an earlier one."""


def hear_only(port: Port, can_ids: Iterable[int]) -> None:
    """Tell a port which identifiers its owner wants; nothing happens where it cannot choose."""
    if isinstance(port, Selective):
        port.hear(can_ids)
