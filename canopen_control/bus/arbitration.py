"""Arbitration and bus load of an emulated CAN bus with a bit rate.

One frame at a time is on the wire, lowest identifier first. Each sender is a controller with one queue in sending
order; only the head of each queue takes part in arbitration, as with controllers that do not reorder. A frame on the
wire is never interrupted (ISO 11898-1, 8.3.3). Time is an argument: `put` and `advance` process everything up to `now`.
"""

from __future__ import annotations

from collections import deque
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Final

from canopen_control.frame import EXTENDED_FLAG, RECORD, RECORD_SIZE, REMOTE_FLAG

if TYPE_CHECKING:
    from collections.abc import Iterator

    Waiting = tuple[int, int, int, bytes]  # priority, sender, bits, record: the lowest one is sent first


# Length of a classic CAN frame in bits (ISO 11898-1, 10.4 and 10.5). Start of frame, identifier, control, data and CRC
# are stuffed: five equal bits are followed by an opposite one. CRC delimiter, acknowledge, end of frame and the three
# bits of intermission are not.


NS_PER_S = 1_000_000_000
_CRC_POLYNOMIAL = 0x4599
_CRC_BITS: Final = 15
_STUFF_AFTER: Final = 5
_UNSTUFFED_TAIL = 1 + 2 + 7 + 3  # CRC delimiter, acknowledge slot and delimiter, end of frame, intermission


def _crc_table() -> list[int]:
    """Return the CRC contribution of each possible byte shifted out of the register."""
    table = []
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = crc << 1 ^ (_CRC_POLYNOMIAL if crc & 0x4000 else 0)
        table.append(crc & 0x7FFF)
    return table


_CRC: Final = _crc_table()


def _crc15(content: int, bits: int) -> int:
    """Return the CRC of the low `bits` bits of `content`; leading zeros do not change it."""
    crc = 0
    for byte in content.to_bytes((bits + 7) // 8, "big"):
        crc = crc << 8 & 0x7FFF ^ _CRC[crc >> 7 ^ byte]
    return crc


def _header(can_id: int) -> tuple[int, int]:
    """Return the bits of a frame that precede the length field, and the number of these bits."""
    remote = 1 if can_id & REMOTE_FLAG else 0
    if can_id & EXTENDED_FLAG:
        identifier = can_id & 0x1FFFFFFF
        return (identifier >> 18) << 23 | 0b11 << 21 | (identifier & 0x3FFFF) << 3 | remote << 2, 35  # SRR, IDE; r1, r0
    return (can_id & 0x7FF) << 3 | remote << 2, 15  # IDE, r0


@lru_cache(maxsize=4096)
def _stuffed(state: int, content: int, bits: int) -> tuple[int, int]:
    """Return the number of stuff bits in the low `bits` bits of `content`, and the state after them.

    The state is 2 * (number of equal bits) + last bit.
    """
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
    """Return a table, indexed by state << 8 | byte, of (number of stuff bits) << 4 | next state."""
    table = []
    for at in range(2 * _STUFF_AFTER << 8):
        upper, state = _stuffed(at >> 8, at >> 4 & 15, 4)
        lower, state = _stuffed(state, at & 15, 4)
        table.append(upper + lower << 4 | state)
    return table


@lru_cache(maxsize=4096)
def _head(can_id: int, length: int) -> tuple[int, int, int, int]:
    """Return the bit count, the CRC, the number of stuff bits and the stuffing state of a frame before its data."""
    content, bits = _header(can_id)
    content, bits = content << 4 | length, bits + 4
    count, state = _stuffed(0, content, bits)
    return bits, _crc15(content, bits), count, state


def frame_bits(can_id: int, data: bytes) -> int:
    """Return the number of bits of a frame from start of frame to the end of intermission, with stuff bits."""
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
    """Return the maximum number of bits of a data frame with `length` data bytes, with stuff bits."""
    stuffed = (54 if extended else 34) + 8 * length
    return stuffed + (stuffed - 1) // 4 + _UNSTUFFED_TAIL


def duration_ns(bits: int, bitrate: int) -> int:
    """Return the time in ns that `bits` take at `bitrate` bit/s, rounded up."""
    return -(-bits * NS_PER_S // bitrate)


LOAD_WINDOW_NS = NS_PER_S


def priority(can_id: int) -> int:
    """Return the arbitration priority of an identifier as a number; the lower number wins.

    The bits are in the order of the wire: base identifier, RTR or SRR, IDE, identifier extension, RTR (ISO 11898-1).
    """
    remote = bool(can_id & REMOTE_FLAG)
    if can_id & EXTENDED_FLAG:
        base, extension = can_id >> 18 & 0x7FF, can_id & 0x3FFFF
        return base << 21 | 1 << 20 | 1 << 19 | extension << 1 | remote
    return (can_id & 0x7FF) << 21 | remote << 20


@lru_cache(maxsize=4096)
def _on_wire(record: bytes) -> tuple[int, int]:
    can_id, length, data = RECORD.unpack(record)
    return priority(can_id), frame_bits(can_id, data[:length])


class PacedWire:
    """Emulated bus at `bitrate` bit/s; senders are numbers, and for equal identifiers the lower number wins.

    `queues` contains the waiting frames of each sender. `on_wire` is the frame on the wire (priority, sender, bits and
    record), `due_ns` its end; both are None if the wire is idle.
    """

    def __init__(self, bitrate: int) -> None:
        self.bitrate = bitrate
        self.bits = 0
        self.queues: dict[int, deque[Waiting]] = {}
        self.on_wire: Waiting | None = None
        self._done_ns = 0
        self.due_ns: int | None = None
        self._window_start = 0
        self._window_bits = 0
        self._last_load = 0.0

    def backlog(self, sender: int) -> int:
        """Return the number of waiting frames of `sender`."""
        queue = self.queues.get(sender)
        return len(queue) if queue else 0

    def put(self, sender: int, records: bytes, now: int) -> None:
        """Queue raw records of `sender`; call `advance` first, so that all frames due until now are processed."""
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
        if self.on_wire is None:
            self._begin(now if now > self._done_ns else self._done_ns)

    def forget(self, sender: int) -> int:
        """Discard the waiting frames of `sender` and return their number; a frame on the wire is completed."""
        return len(self.queues.pop(sender, ()))

    def drain(self) -> Iterator[tuple[int, bytes]]:
        """Yield the sender and raw record of the frame on the wire, then of the waiting frames in arbitration order."""
        while self.on_wire is not None:
            _, sender, _, record = self.on_wire
            yield sender, record
            self._begin(self._done_ns)

    def repeat(self) -> None:
        """Put the disturbed frame on the wire back at the head of its sender's queue, and start the next frame."""
        if (done := self.on_wire) is not None:
            self.queues.setdefault(done[1], deque()).appendleft(done)
            self._begin(self._done_ns)

    def end(self) -> Waiting | None:
        """Complete the frame on the wire and start the next one; return the completed frame, None if idle."""
        done = self.on_wire
        if self.queues:
            if done is not None:
                self._begin(self._done_ns)
        else:
            self.on_wire = self.due_ns = None
        return done

    def advance(self, now: int) -> Iterator[tuple[int, bytes]]:
        """Yield the sender and the raw record of each frame whose last bit has been sent by `now`."""
        while self.on_wire is not None and self._done_ns <= now:
            if (passed := self.end()) is not None:
                yield passed[1], passed[3]

    def next_deadline(self) -> int | None:
        return self.due_ns

    def load(self, now: int) -> float:
        """Return the bus load of the last full second, 0 to 1."""
        self._roll(now)
        return self._last_load

    def _begin(self, now: int) -> None:
        queues = self.queues
        if not queues:
            self.on_wire = self.due_ns = None
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
        self.on_wire, bits = first, first[2]
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
