"""Objects that may not be read or written yet, because a late SDO answer about them may still come.

The law: an answer carries command and multiplexer, nothing else, so an answer that comes late cannot be told from that
of the retry, nor from that of the next request for the same object. What can be told is the order: a server works off
its requests one after the other, and the bus keeps the order of one sender's frames. An answer to X thus settles all
that was asked before X: it has been answered, or never will be. If X itself is owed an answer, it settles what was
asked before the first X that is. Before an object in quarantine is asked for again, a mandatory object is read to
settle it: the device type, or else the error register.
"""

from __future__ import annotations

from typing import Final

from canopen_control.cia301.sdo_codec import INITIATE, UPLOAD

__all__ = ["Quarantine"]

_PROBES: Final = (INITIATE.pack(UPLOAD, 0x1000, 0), INITIATE.pack(UPLOAD, 0x1001, 0))


class Quarantine:
    """The multiplexers that are owed an answer, in the order in which they were first asked for."""

    __slots__ = ("owed",)

    def __init__(self) -> None:
        self.owed: dict[bytes, None] = {}  # keys alone: a set that keeps its order

    def died(self, mux: bytes) -> None:
        """Note that a request was given up."""
        self.owed.setdefault(mux)

    def answered(self, mux: bytes) -> None:
        """Note an answer to what has been asked last."""
        if not self.owed:
            return
        if mux not in self.owed:
            self.owed.clear()
            return
        for earlier in list(self.owed):
            if earlier == mux:
                break
            del self.owed[earlier]

    def probe(self) -> bytes:
        """Return the request that settles most: one that is owed nothing, else the one asked for last."""
        order = list(self.owed)
        return max(_PROBES, key=lambda probe: order.index(probe[1:4]) if probe[1:4] in self.owed else len(order))
