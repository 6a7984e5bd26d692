"""Arbitration on an emulated CAN bus with a bit rate: one frame at a time, lowest identifier first, bus load.

Each sender is a controller with one queue in order of sending; only the head of each takes part in arbitration, as on a
bus whose controllers do not reorder. A frame that has begun is never interrupted (ISO 11898-1, 8.3.3). Time is an
argument: `put` and `advance` do what would have happened until `now`.
"""

from __future__ import annotations

from collections import deque
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Final

from canopen_control.frame import EXTENDED_FLAG, RECORD, RECORD_SIZE, REMOTE_FLAG

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Waiting = tuple[int, int, int, bytes]  # priority, sender, bits, record: the lowest wins


# How long a classic CAN frame takes on the wire, to the bit (ISO 11898-1, 10.4 and 10.5).
#
# Start of frame, identifier, control, data and CRC are stuffed: after five equal bits comes one of the other kind. CRC
# delimiter, acknowledge, end of frame and the three bits of intermission are not.


NS_PER_S = 1_000_000_000
_CRC_POLYNOMIAL = 0x4599
_CRC_BITS: Final = 15
_STUFF_AFTER: Final = 5
_UNSTUFFED_TAIL = 1 + 2 + 7 + 3  # CRC delimiter, acknowledge slot and delimiter, end of frame, intermission


def _crc_table() -> list[int]:
    """Return what eight bits that leave the register add to it."""
    table = []
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = crc << 1 ^ (_CRC_POLYNOMIAL if crc & 0x4000 else 0)
        table.append(crc & 0x7FFF)
    return table


_CRC: Final = _crc_table()


def _crc15(content: int, bits: int) -> int:
    """Return the CRC of so many bits, zeros before them, which change nothing: the register begins with zeros."""
    crc = 0
    for byte in content.to_bytes((bits + 7) // 8, "big"):
        crc = crc << 8 & 0x7FFF ^ _CRC[crc >> 7 ^ byte]
    return crc


def _header(can_id: int) -> tuple[int, int]:
    """Return the bits up to the length, and how many they are."""
    remote = 1 if can_id & REMOTE_FLAG else 0
    if can_id & EXTENDED_FLAG:
        identifier = can_id & 0x1FFFFFFF
        return (identifier >> 18) << 23 | 0b11 << 21 | (identifier & 0x3FFFF) << 3 | remote << 2, 35  # SRR, IDE; r1, r0
    return (can_id & 0x7FF) << 3 | remote << 2, 15  # IDE, r0


@lru_cache(maxsize=4096)
def _stuffed(state: int, content: int, bits: int) -> tuple[int, int]:
    """Return how many bits so many bits are stuffed with, and the state after them; it is 2 * equal bits + last bit."""
    run, last, count = state >> 1, state & 1, 0
    for at in range(bits - 1, -1, -1):
        bit = content >> at & 1
        run = run + 1 if bit == last else 1
        last = bit
        if run == _STUFF_AFTER:
            count += 1
            run, last = 1, 1 - bit
    return count, run << 1 | last


@cache
def _stuffed_bytes() -> list[int]:
    """Return what a byte does in each state, at state << 8 | byte: how many bits are stuffed << 4 | the state after."""
    table = []
    for at in range(2 * _STUFF_AFTER << 8):
        upper, state = _stuffed(at >> 8, at >> 4 & 15, 4)
        lower, state = _stuffed(state, at & 15, 4)
        table.append(upper + lower << 4 | state)
    return table


@lru_cache(maxsize=4096)
def _head(can_id: int, length: int) -> tuple[int, int, int, int]:
    """Return what comes before the data: its bits, its CRC, how many bits are stuffed into it, and the state then."""
    content, bits = _header(can_id)
    content, bits = content << 4 | length, bits + 4
    count, state = _stuffed(0, content, bits)
    return bits, _crc15(content, bits), count, state


def frame_bits(can_id: int, data: bytes) -> int:
    """Return the bits from start of frame to the end of intermission, stuffing included."""
    bits, crc, count, state = _head(can_id, len(data))
    stuffed = _stuffed_bytes()
    if not can_id & REMOTE_FLAG:
        bits += 8 * len(data)
        for byte in data:
            crc = crc << 8 & 0x7FFF ^ _CRC[crc >> 7 ^ byte]
            entry = stuffed[state << 8 | byte]
            count += entry >> 4
            state = entry & 15
    more, state = _stuffed(state, crc >> 8, _CRC_BITS - 8)
    return bits + _CRC_BITS + count + more + (stuffed[state << 8 | crc & 0xFF] >> 4) + _UNSTUFFED_TAIL


def worst_case_bits(length: int, *, extended: bool = False) -> int:
    """Return the most bits that a data frame with `length` bytes can take."""
    stuffed = (54 if extended else 34) + 8 * length
    return stuffed + (stuffed - 1) // 4 + _UNSTUFFED_TAIL


def duration_ns(bits: int, bitrate: int) -> int:
    """Return the time of `bits` at `bitrate` bit/s, rounded up to a nanosecond."""
    return -(-bits * NS_PER_S // bitrate)


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
