"""What some ports can do beside `Port`: filter identifiers in the kernel, and say when each frame came.

Both are asked for in a way that serves every port: one that cannot filter gives everything, and its owner ignores
what is not his; one that has no stamps gets the time of reading. A file of its own, since mypyc, which compiles
`port`, makes no protocols that can be asked for at run time.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from canopen_control.bus.subscription import STAMP_STEP_NS
from canopen_control.frame import RECORD_SIZE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.bus.port import Port


_READINGS = 4


@runtime_checkable
class Filtering(Protocol):
    """A port that can leave frames out, so that its owner is not woken for them; error frames come always."""

    def set_filter(self, can_ids: Iterable[int]) -> None:
        """Give these identifiers only, with the flags of linux/can.h; a later call replaces an earlier one."""


def set_filter(port: Port, can_ids: Iterable[int]) -> None:
    """Tell a port which identifiers its owner wants; nothing happens where it cannot filter."""
    if isinstance(port, Filtering):
        port.set_filter(can_ids)


@runtime_checkable
class Stamping(Protocol):
    """A port that learns when its frames came: from the kernel, the hub or the adapter.

    The cycle never asks: each stamp is work for each frame.
    """

    def ask_stamps(self) -> None:
        """Have what comes from now on stamped; a second call does nothing."""

    def receive_stamped(self) -> tuple[bytes, list[int]]:
        """Return what `receive` does, and when each record came in monotonic ns, 0: unknown; raise `BusClosed`."""


class UnixOffset:
    """What makes Unix time of monotonic time, steady though a program may pause between reading the two clocks.

    The truth lies between what a reading before and one after give; it changes when somebody sets the clock.
    """

    def __init__(
        self, monotonic: Callable[[], int] = time.monotonic_ns, unix: Callable[[], int] = lambda: time.time_ns()
    ) -> None:
        self._monotonic, self._unix = monotonic, unix
        low, high = min((self._bounds() for _ in range(_READINGS)), key=lambda bounds: bounds[1] - bounds[0])
        self._offset = (low + high) // 2

    def _bounds(self) -> tuple[int, int]:
        before = self._monotonic()
        unix = self._unix()
        return unix - self._monotonic(), unix - before

    def ns(self) -> int:
        """Return the offset as it is now."""
        low, high = self._bounds()
        self._offset = min(max(self._offset, low), high)
        return self._offset


class Arrivals:
    """Receives from a port, each record with the time at which it came; make it before the frames come that matter.

    Times are strictly increasing, by a microsecond at least, so that recordings keep every one apart. A port that knows
    none gives the time of reading. They are monotonic; `unix_offset_ns`, which is fixed, makes Unix time of them, so
    that a clock which is set meanwhile leaves no gap and no frame before an earlier one.
    """

    def __init__(self, port: Port, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self.port = port
        self.unix_offset_ns = UnixOffset(clock).ns()
        self._clock = clock
        self._stamping = port if isinstance(port, Stamping) else None
        self._earliest = 1
        if self._stamping is not None:
            self._stamping.ask_stamps()

    def receive(self) -> tuple[bytes, list[int]]:
        """Return the records that wait and the time of each in monotonic ns; raise `BusClosed`."""
        if self._stamping is not None:
            records, stamps = self._stamping.receive_stamped()
        else:
            records = self.port.receive()
            stamps = [0] * (len(records) // RECORD_SIZE)
        if stamps:
            self.order(stamps)
        return records, stamps

    def order(self, stamps: list[int]) -> None:
        """Give a time to records without one, and make each later than the one before; for one who reads himself."""
        now, earliest = self._clock(), self._earliest
        for number, stamp in enumerate(stamps):
            if stamp < earliest:  # 0 too
                stamps[number] = max(stamp or now, earliest)
            earliest = stamps[number] + STAMP_STEP_NS
        self._earliest = earliest
