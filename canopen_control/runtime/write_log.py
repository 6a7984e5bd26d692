"""What is told of objects that clients write through a robot: who wrote what, and of many that there were more.

The first few of one client at one node are told one by one. What follows within the time is told by one text, so that
the event log counts it: a restore of three hundred objects must not push everything else out of the log.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.od.codec import decode, fitted
from canopen_control.od.eds_values import format_value

if TYPE_CHECKING:
    from canopen_control.od.model import ObjectDictionary

__all__ = ["WriteLog", "written_words"]

FEW: Final = 5
WINDOW_NS: Final = 2_000_000_000
_WIDEST: Final = 40  # characters of a value
_COMMUNICATION: Final = range(0x1000, 0x2000)  # identifiers and mappings are hexadecimal
_MOST: Final = 64  # of clients and nodes that are remembered


def written_words(od: ObjectDictionary, index: int, subindex: int, data: bytes) -> str:
    """Return what was written in words: the value by the EDS, else how many bytes."""
    address, entry = f"0x{index:04X}:{subindex:02X}", od.get(index, subindex)
    whole = None if entry is None else fitted(data, entry.data_type)
    if entry is None or whole is None:
        return f"{len(data)} bytes to {address}"
    value = decode(whole, entry.data_type)
    number = isinstance(value, int) and index not in _COMMUNICATION
    text = str(value) if number else format_value(value, entry.data_type)
    short = text if 0 < len(text) <= _WIDEST and text.isprintable() else f"{len(data)} bytes"
    return f"{short} to {address} {entry.name}"


class WriteLog:
    """Counts the writes of each client at each node."""

    def __init__(self) -> None:
        self._counts: dict[tuple[str, str], tuple[int, int]] = {}  # how many in a row, and when the last one was

    def words(self, now: int, node: str, who: str, what: str) -> str:
        """Return the sentence of a write; `now` in monotonic ns."""
        count, last = self._counts.pop((node, who), (0, now))
        count = 1 if now - last > WINDOW_NS else count + 1
        if len(self._counts) >= _MOST:
            del self._counts[next(iter(self._counts))]
        self._counts[node, who] = count, now
        return f"{who} wrote {what}" if count <= FEW else f"{who} wrote more objects"
