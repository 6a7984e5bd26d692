"""Optional abilities of ports: filtering of identifiers, and time stamps of received frames.

Callers need not distinguish: a port without a filter delivers all frames, and a port without time stamps uses the time
of reading. This module is separate from `port` because mypyc, which compiles `port`, does not support runtime-checkable
protocols.
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
    """Port that can filter frames, so that its owner runs less often; error frames are always delivered."""

    def set_filter(self, can_ids: Iterable[int]) -> None:
        """Deliver only these identifiers, with the flags of linux/can.h; a later call replaces the filter."""


def set_filter(port: Port, can_ids: Iterable[int]) -> None:
    """Set the filter of a port; no effect on a port that does not support filters."""
    if isinstance(port, Filtering):
        port.set_filter(can_ids)


@runtime_checkable
class Stamping(Protocol):
    """Port with time stamps of received frames from the kernel, the hub or the adapter.

    The cycle does not use them, because each stamp costs time per frame.
    """

    def ask_stamps(self) -> None:
        """Record time stamps from now on; a second call does nothing."""

    def receive_stamped(self) -> tuple[bytes, list[int]]:
        """Return the records of `receive` and the monotonic time of each in ns (0: unknown).

        Raise BusClosed when the channel is gone.
        """


class UnixOffset:
    """Offset from monotonic time to Unix time, stable even if the program pauses between reading the two clocks.

    Each reading bounds the true offset; the value changes only if it is out of bounds, as after the clock was set.
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
        """Return the current offset in ns."""
        low, high = self._bounds()
        self._offset = min(max(self._offset, low), high)
        return self._offset


class Arrivals:
    """Receiver of a port's records with a time for each; create it before the frames of interest arrive.

    Times are strictly increasing, by at least 1 us, so that recordings can distinguish them. A port without time stamps
    gives the time of reading. Times are monotonic; the constant `unix_offset_ns` converts them to Unix time, so that
    setting the clock causes neither a gap nor a step back.
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
        """Return the waiting records and the monotonic time of each in ns; raise BusClosed when the channel is gone."""
        if self._stamping is not None:
            records, stamps = self._stamping.receive_stamped()
        else:
            records = self.port.receive()
            stamps = [0] * (len(records) // RECORD_SIZE)
        if stamps:
            self.order(stamps)
        return records, stamps

    def order(self, stamps: list[int]) -> None:
        """Replace missing stamps and make all strictly increasing, for callers that read the port themselves."""
        now, earliest = self._clock(), self._earliest
        for number, stamp in enumerate(stamps):
            if stamp < earliest:  # or 0
                stamps[number] = max(stamp or now, earliest)
            earliest = stamps[number] + STAMP_STEP_NS
        self._earliest = earliest
