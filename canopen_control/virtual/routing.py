"""Routes of a node: identifiers to what takes their frames.

The law of this file: two receivers of one identifier both hear its frames, in the order of the routes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.frame import CanFrame

    Receiver = Callable[[CanFrame, int], None]
    Route = tuple[int, Receiver]

__all__ = ["merged"]


def merged(routes: Iterable[Route]) -> dict[int, Receiver]:
    """Return the table of routes; identifiers carry linux/can.h's flags."""
    table: dict[int, Receiver] = {}
    for can_id, receiver in routes:
        table[can_id] = _both(table[can_id], receiver) if can_id in table else receiver
    return table


def _both(first: Receiver, second: Receiver) -> Receiver:
    def receive(frame: CanFrame, now: int) -> None:
        first(frame, now)
        second(frame, now)

    return receive
