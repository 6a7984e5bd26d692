"""What comes between the wire and the RPDOs of a node when a fault is on: RPDOs that arrive late, or not at all.

Healthy, it hands every frame on at once and keeps nothing.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from canopen_control.virtual.fault_seam import Seam

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.frame import CanFrame

    Receive = Callable[[CanFrame, int], None]

__all__ = ["RpdoInput"]


class RpdoInput:
    """Hands RPDO frames on. Seams: `delay_ns`, how late; `lost`, one of how many never is, 0: none is lost.

    `delayed` are those that wait to be handed on, with the time of that; `received` counts what came.
    """

    def __init__(self) -> None:
        self.delay_ns: Seam[int] = Seam(0)
        self.lost: Seam[int] = Seam(0)
        self.received = 0
        self.delayed: deque[tuple[int, Receive, CanFrame]] = deque()

    def receiver(self, receive: Receive) -> Receive:
        """Return what takes a frame from the wire for `receive`."""

        def take(frame: CanFrame, now: int) -> None:
            self.received += 1
            lost, delay = self.lost.value, self.delay_ns.value
            if lost and self.received % lost == 0:
                return
            if delay:
                self.delayed.append((now + delay, receive, frame))
            else:
                receive(frame, now)

        return take

    def tick(self, now: int) -> None:
        """Hand on what was kept until now."""
        delayed = self.delayed
        while delayed and delayed[0][0] <= now:
            _, receive, frame = delayed.popleft()
            receive(frame, now)

    def next_deadline(self) -> int | None:
        """Return when `tick` hands on the next one."""
        return self.delayed[0][0] if self.delayed else None
