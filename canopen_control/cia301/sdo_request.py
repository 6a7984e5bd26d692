"""An SDO request as its caller holds it, the client's options, and how often is tried again.

The law of trying again: a timeout is tried `retries` times more; a toggle error starts the transfer again at most
twice; "not now" to a download is asked again after pauses that grow, until `busy_ns` are over, to an upload once; what
block transfer could not do is done in segments, once. None of these counts against another.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.abort import BUSY_CODES, AbortCode
from canopen_control.cia301.sdo_codec import MAX_BLOCK_SIZE, MAX_TRANSFER_SIZE
from canopen_control.errors import LocalProtocolError

if TYPE_CHECKING:
    from canopen_control.errors import CanopenError

__all__ = ["RetryBudget", "SdoOptions", "SdoRequest"]

_MAX_RESTARTS: Final = 2  # after toggle errors
_FIRST_PAUSE_NS: Final = 20_000_000  # doubles with every "not now"
_MAX_PAUSE_NS: Final = 500_000_000


@dataclasses.dataclass(frozen=True, slots=True)
class SdoOptions:
    """How a client transfers; the defaults suit every server.

    `block_threshold` is the length in bytes from which a write that does not choose uses block transfer;
    `block_size` the segments per sub-block of an upload, 1 to 127; `switch_threshold` the length up to which a server
    may answer a block upload with a plain one (0: it need not ask). `crc` and `announce_size` say what is offered,
    `max_size` how many bytes an upload may take, and `busy_ns` how long "not now" is asked again.
    """

    block_threshold: int = 256
    block_size: int = MAX_BLOCK_SIZE
    switch_threshold: int = 0
    crc: bool = True
    announce_size: bool = True
    max_size: int = MAX_TRANSFER_SIZE
    busy_ns: int = 1_000_000_000

    def __post_init__(self) -> None:
        if not 1 <= self.block_size <= MAX_BLOCK_SIZE:
            raise LocalProtocolError(f"block_size {self.block_size}: a sub-block has 1 to {MAX_BLOCK_SIZE} segments")
        if not 0 <= self.switch_threshold <= 0xFF:
            raise LocalProtocolError(f"switch_threshold {self.switch_threshold}: it travels in one byte, 0 to 255")


class SdoRequest:
    """One upload or download, from the queue to its end.

    `data` is the result of a read and the payload of a write; `error` says why it failed, None while it has not;
    `block` whether block transfer is tried first; `context` is free for whoever asked. `elapsed_ns` counts from the
    first frame, not from the queue; it stays 0 for one that was cancelled.
    """

    __slots__ = (
        "block",
        "context",
        "data",
        "done",
        "elapsed_ns",
        "error",
        "index",
        "is_write",
        "subindex",
        "timeout_ns",
    )

    error: CanopenError | None
    context: object

    def __init__(
        self,
        index: int,
        subindex: int,
        data: bytes | None,
        timeout_ns: int,
        block: bool = False,
    ) -> None:
        self.index = index
        self.subindex = subindex
        self.is_write = data is not None
        self.data = data or b""
        self.timeout_ns = timeout_ns
        self.block = block
        self.error = None
        self.done = False
        self.context = None
        self.elapsed_ns = 0

    def __repr__(self) -> str:
        state = "open" if not self.done else "failed" if self.error else "done"
        verb = "write" if self.is_write else "read"
        return f"<SdoRequest {verb} 0x{self.index:04X}:{self.subindex:02X} {state}>"


class RetryBudget:
    """How often one request may still be tried again, and why; made with its first trouble."""

    __slots__ = ("_busy_until", "_pause_ns", "_restarts", "_tries", "plain", "waited_ns")

    def __init__(self, tries: int) -> None:
        self._tries, self._restarts = tries, _MAX_RESTARTS
        self._pause_ns = _FIRST_PAUSE_NS
        self._busy_until: int | None = None
        self.plain = False  # block transfer is out of the question
        self.waited_ns = 0  # in vain

    def has_try(self, code: int) -> bool:
        """Use up a try after a timeout or a toggle error; False if `code` is none of these or none is left."""
        if code == AbortCode.TIMED_OUT and self._tries > 0:
            self._tries -= 1
            return True
        if code == AbortCode.TOGGLE_NOT_ALTERNATED and self._restarts > 0:
            self._restarts -= 1
            return True
        return False

    @property
    def paused(self) -> bool:
        """Whether it was asked again after a pause."""
        return self._busy_until is not None

    def pause(self, code: int, busy_ns: int, now: int) -> int | None:
        """Return when to ask again what the server cannot do now; None if it is no such code, or for too long."""
        if code not in BUSY_CODES:
            return None
        if self._busy_until is None:
            self._busy_until = now + busy_ns
        until = now + self._pause_ns
        self._pause_ns = min(2 * self._pause_ns, _MAX_PAUSE_NS)
        return until if until <= self._busy_until else None
