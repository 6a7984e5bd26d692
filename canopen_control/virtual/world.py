"""What hangs on the axes of a process's drives: the engine behind all plants, so that another one can replace it.

The law of this file: an engine is asked for the plant of each axis once, and then follows what the drives do to it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from canopen_control.virtual.plant import IdealPlant

if TYPE_CHECKING:
    from canopen_control.virtual.plant import Plant

__all__ = ["PlainWorld", "World"]


class World(Protocol):
    """An engine: makes the plant of each axis and knows what they do together."""

    period_ns: int | None
    """How often every axis wants to be brought to the present, although nothing happens; None: never."""

    def plant(self, node_id: int, axis: int) -> Plant:
        """Return the plant of an axis; asked once for each."""

    def describe(self) -> dict[str, object]:
        """Return what there is beyond the axes: plain values, JSON-able."""

    def close(self) -> None:
        """End it."""


class PlainWorld:
    """Axes that do as they are told and know nothing of each other."""

    period_ns: int | None = None

    def plant(self, node_id: int, axis: int) -> Plant:  # noqa: ARG002 # they are all alike
        """Return an ideal plant."""
        return IdealPlant()

    def describe(self) -> dict[str, object]:
        """Return nothing."""
        return {}

    def close(self) -> None:
        """Do nothing."""
