"""What an end of a ``local:`` bus wants to hear, told to the hub among the frames of that end.

A hub that takes it says so in its greeting. It goes the way of the frames, so that whatever an end sends after a change
of its mind, such as the answer to who made it listen elsewhere, comes after that change. Each record holds up to two
identifiers, with the flags of linux/can.h; its own identifier, all ones, is none that a frame can have. An end that
has said nothing hears everything.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

from canopen_control.frame import RECORD_SIZE

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["MARK", "TAKES_WANTED", "Wanted", "pack_wanted"]

TAKES_WANTED: Final = 1
"""The ability of a hub, in its greeting."""
_RECORD: Final = struct.Struct("=5sBxxII")  # mark, what it holds, identifiers
MARK: Final = b"\xff" * 5
"""What such a record begins with."""
_COUNT: Final = 0x03
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


class Wanted:
    """What one end has asked for: `ids` is None while it hears everything."""

    __slots__ = ("_coming", "ids")

    def __init__(self) -> None:
        self.ids: frozenset[int] | None = None
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
        self._coming.update(can_ids[: kind & _COUNT])
        if kind & _LAST:
            self.ids = frozenset(self._coming) if len(self._coming) <= _MOST else None
            self._coming = set()
