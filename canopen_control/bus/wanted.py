"""What an end of a ``local:`` bus and its hub tell each other among the frames, in records of their own.

An end asks for identifiers, for time stamps, or for its own frames. A hub that can do it says so in its greeting. It
goes the way of the frames, so that whatever an end sends after a change of its mind, such as the answer to who made it
listen elsewhere, comes after that change. The hub puts a stamp before each chunk of frames that came at once. Each
record that asks holds up to two identifiers, with the flags of linux/can.h; its own identifier, all ones, is none that
a frame can have. An end that has said nothing hears everything but itself, without stamps.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.frame import RECORD_SIZE

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

__all__ = [
    "GIVES_STAMPS",
    "MARK",
    "STAMP_STEP_NS",
    "TAKES_WANTED",
    "Chunk",
    "Wanted",
    "chunks_of",
    "own_stamp",
    "pack_stamp",
    "pack_wanted",
    "pack_wish",
]

TAKES_WANTED: Final = 1
GIVES_STAMPS: Final = 2
"""Abilities of a hub, in its greeting: it takes identifiers; it gives stamps, and own frames back."""
STAMP_STEP_NS: Final = 1000
"""Between the frames of one chunk, which came at the same time: the least that a recording in microseconds keeps."""
_RECORD: Final = struct.Struct("=5sBxxII")  # mark, what it holds, identifiers
_STAMP: Final = struct.Struct("=5sBxxq")  # mark, _OWN or 0, monotonic ns of the first frame
MARK: Final = b"\xff" * 5
"""What such a record begins with."""
_COUNT: Final = 0x03
_STAMPS: Final = 0x10
_ECHO: Final = 0x20
_OWN: Final = 0x01
_LAST: Final = 0x80
_MOST: Final = 4096  # identifiers; an end that wants more hears everything


def pack_wanted(can_ids: Iterable[int]) -> bytes:
    """Return the records that ask for these identifiers only."""
    wanted = sorted(set(can_ids))
    pairs = [wanted[at : at + 2] for at in range(0, len(wanted), 2)] or [[]]
    last = len(pairs) - 1
    return b"".join(
        _RECORD.pack(MARK, len(pair) | (_LAST if number == last else 0), *pair, *[0] * (2 - len(pair)))
        for number, pair in enumerate(pairs)
    )


def pack_wish(*, echo: bool = False) -> bytes:
    """Return the record that asks for time stamps, and with `echo` for the own frames too."""
    return _RECORD.pack(MARK, _STAMPS | (_ECHO if echo else 0), 0, 0)


def pack_stamp(at_ns: int) -> bytes:
    """Return the record before a chunk that came at `at_ns`, monotonic."""
    return _STAMP.pack(MARK, 0, at_ns)


def own_stamp(stamp: bytes) -> bytes:
    """Return the same for the reader who has sent the chunk."""
    return MARK + bytes((_OWN,)) + stamp[len(MARK) + 1 :]


class Chunk(NamedTuple):
    """Whole records that came at once, the first at `at_ns`, each following one `STAMP_STEP_NS` later; 0: unknown."""

    at_ns: int
    own: bool
    records: bytes

    @property
    def stamps(self) -> list[int]:
        """The time of each record."""
        count = len(self.records) // RECORD_SIZE
        return [*range(self.at_ns, self.next_ns, STAMP_STEP_NS)] if self.at_ns else [0] * count

    @property
    def next_ns(self) -> int:
        """The time of what follows without a stamp of its own."""
        return self.at_ns and self.at_ns + len(self.records) // RECORD_SIZE * STAMP_STEP_NS


def chunks_of(data: bytes, before: Chunk) -> Iterator[Chunk]:
    """Part whole records at their stamps; what comes before the first stamp goes on where `before` ended."""
    at_ns, own, begin, mark = before.next_ns, before.own, 0, -1
    if data.startswith(MARK):  # nearly always
        _, kind, at_ns = _STAMP.unpack_from(data)
        own, begin, mark = bool(kind & _OWN), RECORD_SIZE, RECORD_SIZE - 1
    while True:
        mark = data.find(MARK, mark + 1)
        while mark % RECORD_SIZE and mark > 0:  # data of a frame that look like it
            mark = data.find(MARK, mark + 1)
        end = len(data) if mark < 0 else mark
        yield Chunk(at_ns, own, data[begin:end])
        if mark < 0:
            return
        _, kind, at_ns = _STAMP.unpack_from(data, mark)
        own, begin = bool(kind & _OWN), mark + RECORD_SIZE


class Wanted:
    """What one end has asked for: `ids` is None while it hears everything, `echoes` are its own frames."""

    __slots__ = ("_coming", "echoes", "ids", "stamps")

    def __init__(self) -> None:
        self.ids: frozenset[int] | None = None
        self.stamps = self.echoes = False
        self._coming: set[int] = set()

    def take(self, records: bytes) -> bytes:
        """Take the records of this kind out of whole records; return the frames, which are all others."""
        frames = []
        for at in range(0, len(records), RECORD_SIZE):
            if records.startswith(MARK, at):
                self._hear(*_RECORD.unpack_from(records, at)[1:])
            else:
                frames.append(records[at : at + RECORD_SIZE])
        return b"".join(frames)

    def _hear(self, kind: int, *can_ids: int) -> None:
        if kind & _STAMPS:
            self.stamps, self.echoes = True, bool(kind & _ECHO)
            return
        self._coming.update(can_ids[: kind & _COUNT])
        if kind & _LAST:
            self.ids = frozenset(self._coming) if len(self._coming) <= _MOST else None
            self._coming = set()
