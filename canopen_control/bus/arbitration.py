"""Arbitration on an emulated CAN bus with a bit rate: one frame at a time, lowest identifier first, bus load.

Each sender is a controller with one queue in order of sending; only the head of each takes part in arbitration, as on a
bus whose controllers do not reorder. A frame that has begun is never interrupted (ISO 11898-1, 8.3.3). Time is an
argument: `put` and `advance` do what would have happened until `now`.
"""

from __future__ import annotations

from collections import deque
from functools import lru_cache
from typing import TYPE_CHECKING

from canopen_control.bus.timing import NS_PER_S, frame_bits
from canopen_control.frame import EXTENDED_FLAG, RECORD, RECORD_SIZE, REMOTE_FLAG

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Waiting = tuple[int, int, int, bytes]  # priority, sender, bits, record: the lowest wins

__all__ = ["PacedWire", "priority"]

LOAD_WINDOW_NS = NS_PER_S


def priority(can_id: int) -> int:
    """Return a number that is lower for what wins arbitration: base identifier, RTR or SRR, IDE, extension, RTR."""
    remote = bool(can_id & REMOTE_FLAG)
    if can_id & EXTENDED_FLAG:
        base, extension = can_id >> 18 & 0x7FF, can_id & 0x3FFFF
        return base << 21 | 1 << 20 | 1 << 19 | extension << 1 | remote
    return (can_id & 0x7FF) << 21 | remote << 20


@lru_cache(maxsize=4096)
def _on_wire(record: bytes) -> tuple[int, int]:
    """Return the priority of a record and its bits."""
    can_id, length, data = RECORD.unpack(record)
    return priority(can_id), frame_bits(can_id, data[:length])


def _never(_sender: int, _record: bytes) -> bool:
    return False


class PacedWire:
    """The wire at `bitrate` bit/s; senders are numbers, and the lower one wins between equal identifiers.

    `queues` are the frames of those who have something to send.
    `disturbed(sender, record)` says whether a frame was, at its last bit: it is sent again. `due_ns` is when the frame
    on the wire ends, None for none.
    """

    def __init__(self, bitrate: int) -> None:
        self.bitrate = bitrate
        self.bits = 0
        self.disturbed: Callable[[int, bytes], bool] = _never
        self.queues: dict[int, deque[Waiting]] = {}
        self._on_wire: Waiting | None = None
        self._done_ns = 0
        self.due_ns: int | None = None
        self._window_start = 0
        self._window_bits = 0
        self._last_load = 0.0

    def backlog(self, sender: int) -> int:
        """Return how many frames of `sender` wait."""
        queue = self.queues.get(sender)
        return len(queue) if queue else 0

    def put(self, sender: int, records: bytes, now: int) -> None:
        """Queue records of `sender`; call `advance` first, so that what was due until now is done."""
        queue = self.queues.get(sender)
        if queue is None:
            queue = self.queues[sender] = deque()
        if len(records) == RECORD_SIZE:
            rank, bits = _on_wire(records)
            queue.append((rank, sender, bits, records))
        else:
            for at in range(0, len(records), RECORD_SIZE):
                record = records[at : at + RECORD_SIZE]
                rank, bits = _on_wire(record)
                queue.append((rank, sender, bits, record))
        if self._on_wire is None:
            self._begin(now if now > self._done_ns else self._done_ns)

    def forget(self, sender: int) -> int:
        """Drop what `sender` has waiting and return the number of frames; one on the wire is finished."""
        return len(self.queues.pop(sender, ()))

    def drain(self) -> Iterator[tuple[int, bytes]]:
        """Yield sender and record of everything that waits, in the order of arbitration, without its time."""
        while self._on_wire is not None:
            _, sender, _, record = self._on_wire
            yield sender, record
            self._begin(self._done_ns)

    def finish(self) -> Waiting | None:
        """End the frame on the wire and begin the next; return priority, sender, bits and record.

        It is None where it was disturbed, or none was there.
        """
        done = self._on_wire
        if done is not None and self.disturbed is not _never and self.disturbed(done[1], done[3]):
            self.queues.setdefault(done[1], deque()).appendleft(done)
            self._begin(self._done_ns)
            return None
        return self.end()

    def end(self) -> Waiting | None:
        """End the frame on the wire, which nobody has disturbed, and begin the next; as `finish`."""
        done = self._on_wire
        if done is not None:
            self._begin(self._done_ns)
        return done

    def advance(self, now: int) -> Iterator[tuple[int, bytes]]:
        """Yield sender and record of each frame whose last bit passed until `now`."""
        while self._on_wire is not None and self._done_ns <= now:
            if (passed := self.finish()) is not None:
                yield passed[1], passed[3]

    def next_deadline(self) -> int | None:
        """Return when the frame on the wire ends."""
        return self.due_ns

    def load(self, now: int) -> float:
        """Return the busy share, 0 to 1, of the last full second."""
        self._roll(now)
        return self._last_load

    def _begin(self, now: int) -> None:
        queues = self.queues
        if not queues:
            self._on_wire = self.due_ns = None
            return
        if len(queues) == 1:
            [(sender, queue)] = queues.items()
            first = queue.popleft()
        else:
            first = min([queue[0] for queue in queues.values()])
            sender = first[1]
            queue = queues[sender]
            queue.popleft()
        if not queue:
            del queues[sender]
        self._on_wire, bits = first, first[2]
        self.due_ns = self._done_ns = now - (-bits * NS_PER_S // self.bitrate)
        if now - self._window_start >= LOAD_WINDOW_NS:
            self._roll(now)
        self.bits += bits
        self._window_bits += bits

    def _roll(self, now: int) -> None:
        windows = (now - self._window_start) // LOAD_WINDOW_NS
        if windows <= 0:
            return
        self._last_load = min(1.0, self._window_bits / self.bitrate) if windows == 1 else 0.0
        self._window_bits = 0
        self._window_start += windows * LOAD_WINDOW_NS
