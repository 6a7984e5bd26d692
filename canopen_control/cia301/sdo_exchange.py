"""State machine of one SDO request of a client: tries, responses, timeouts and aborts (CiA 301, 7.2.4).

Rules:
- A `Phase` interprets frames, aborts, timeouts and cancellations; `SdoTransfer` decides what follows from them.
- A timeout sends an abort with the multiplexer of the request. A block transfer that the server refuses, or whose CRC
  is wrong, is repeated in segments. Any other abort ends the request.
- Interrupted program data (0x1F50, CiA 302-3) are never sent again automatically, not even in segments, because the
    server needs a new clear command first.
- The data of an upload of a known object have the length of its type, or the request fails.
- An abandoned request (timed out or cancelled) may still be answered. `LateAnswerGuard` prevents that a late answer is
    mistaken for the answer to a retry.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.cia301.abort import BUSY_CODES, AbortCode, abort_text
from canopen_control.cia301.sdo_codec import (
    ABORT,
    BLOCK_DOWNLOAD,
    BLOCK_UPLOAD,
    CRC_FLAG,
    DOWNLOAD,
    DOWNLOAD_ANSWER,
    EXPEDITED_CODES,
    EXPEDITED_LENGTHS,
    INITIATE,
    INITIATE_BYTES,
    INITIATE_NUMBER,
    MAX_BLOCK_SIZE,
    MAX_TRANSFER_SIZE,
    SIZED_FLAG,
    UPLOAD,
)
from canopen_control.cia301.sdo_transfers import BlockUpload
from canopen_control.errors import LocalProtocolError, SdoAbort, SdoLengthError, SdoTimeout
from canopen_control.frame import CanFrame
from canopen_control.od.codec import fitted
from canopen_control.od.indices import PROGRAM_DATA

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.errors import CanopenError
    from canopen_control.od.model import Entry, ObjectDictionary

    FirstPhase = Callable[["SdoTransfer", "SdoRequest"], tuple["Phase", bytes]]
    """Function that returns the first phase and the first frame of a try."""


_MAX_RESTARTS: Final = 2  # after toggle errors
_FIRST_PAUSE_NS: Final = 20_000_000  # doubled after each busy abort
_MAX_PAUSE_NS: Final = 500_000_000


@dataclasses.dataclass(frozen=True, slots=True)
class SdoOptions:
    """Options of an SDO client; every server accepts the defaults.

    `block_threshold` is the length in bytes from which a write uses block transfer by default; `block_size` the
    segments per sub-block of an upload, 1 to 127; `switch_threshold` the length up to which a server may switch a block
    upload to another protocol (0: never). `crc` and `announce_size` enable these options, `max_size` limits an upload
    in bytes, and `busy_ns` limits the repetition after busy aborts.
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
            raise LocalProtocolError(f"switch_threshold {self.switch_threshold}: it must be 0 to 255, one byte")


class SdoRequest:
    """One upload or download, from the time it is queued until it is done.

    `data` is the result of a read or the payload of a write; `error` is None on success; `block` requests block
    transfer; `context` is free for the caller. `elapsed_ns` counts from the first frame, and is 0 for a cancelled
    request.
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
    """Remaining retries of one request, created on its first error.

    A timeout is retried `tries` times and a toggle error twice. A busy abort of a download is retried after increasing
    pauses until `busy_ns` have elapsed; a busy abort of an upload is retried once. A failed block transfer is repeated
    in segments, once. These counts are independent.
    """

    __slots__ = ("_busy_until", "_pause_ns", "_restarts", "_tries", "plain", "waited_ns")

    def __init__(self, tries: int) -> None:
        self._tries, self._restarts = tries, _MAX_RESTARTS
        self._pause_ns = _FIRST_PAUSE_NS
        self._busy_until: int | None = None
        self.plain = False  # True after a fallback: block transfer is not tried again
        self.waited_ns = 0  # total time of expired timeouts

    def has_try(self, code: int) -> bool:
        """Use one retry for a timeout or a toggle error; return False for other codes, or if none is left."""
        if code == AbortCode.TIMED_OUT and self._tries > 0:
            self._tries -= 1
            return True
        if code == AbortCode.TOGGLE_NOT_ALTERNATED and self._restarts > 0:
            self._restarts -= 1
            return True
        return False

    @property
    def paused(self) -> bool:
        """Whether the request has been repeated after a busy abort."""
        return self._busy_until is not None

    def pause(self, code: int, busy_ns: int, now: int) -> int | None:
        """Return the time of a retry after a busy abort; None for other codes, or if `busy_ns` would be exceeded."""
        if code not in BUSY_CODES:
            return None
        if self._busy_until is None:
            self._busy_until = now + busy_ns
        until = now + self._pause_ns
        self._pause_ns = min(2 * self._pause_ns, _MAX_PAUSE_NS)
        return until if until <= self._busy_until else None


# errors of block transfer that segments may avoid; without CRC a lost segment appears as a wrong length
BLOCK_ERRORS: Final = frozenset(
    (
        AbortCode.UNKNOWN_COMMAND,
        AbortCode.INVALID_BLOCK_SIZE,
        AbortCode.INVALID_SEQUENCE_NUMBER,
        AbortCode.CRC_ERROR,
        AbortCode.LENGTH_TOO_HIGH,
        AbortCode.LENGTH_TOO_LOW,
    ),
)


def initiate(request: SdoRequest, options: SdoOptions) -> bytes:
    """Return the initiate request of an expedited (up to four bytes) or segmented transfer."""
    index, subindex, data = request.index, request.subindex, request.data
    if not request.is_write:
        return INITIATE.pack(UPLOAD, index, subindex)
    length, sized = len(data), options.announce_size
    # CiA 301, 7.2.4.3.3: up to four bytes are in the initiate (expedited)
    if 1 <= length <= 4:
        command = DOWNLOAD | (EXPEDITED_CODES[length] if sized else SIZED_FLAG)
        return INITIATE_BYTES.pack(command, index, subindex, data)
    return INITIATE_NUMBER.pack(DOWNLOAD | sized, index, subindex, length if sized else 0)


def initiate_block(request: SdoRequest, options: SdoOptions) -> bytes:
    """Return the initiate request of a block transfer."""
    crc = CRC_FLAG if options.crc else 0
    index, subindex = request.index, request.subindex
    if not request.is_write:
        parameters = bytes((options.block_size, options.switch_threshold))
        return INITIATE_BYTES.pack(BLOCK_UPLOAD | crc, index, subindex, parameters)
    sized, length = (SIZED_FLAG, len(request.data)) if options.announce_size else (0, 0)
    return INITIATE_NUMBER.pack(BLOCK_DOWNLOAD | crc | sized, index, subindex, length)


def completed(data: bytes) -> bytes:
    """Return a frame's data padded to 8 bytes; empty if it is longer, or lacks a byte that the protocol uses.

    Some servers truncate frames after the last used byte, although CiA 301 requires 8 bytes.
    """
    # CiA 301, 7.2.4.3: a frame has 8 bytes
    if len(data) < 4 or len(data) > 8:
        return b""
    used = {ABORT: 8, DOWNLOAD_ANSWER: 4}.get(data[0], 4 + EXPEDITED_LENGTHS.get(data[0], 4))
    return data.ljust(8, b"\0") if len(data) >= used else b""


_PROBES: Final = (INITIATE.pack(UPLOAD, 0x1000, 0), INITIATE.pack(UPLOAD, 0x1001, 0))


class LateAnswerGuard:
    """Multiplexers of abandoned requests that may still be answered, in the order of the requests.

    An answer contains only command specifier and multiplexer, so that a late answer cannot be distinguished from the
    answer to a retry or to the next request for the same object. But a server processes requests in order, and the bus
    keeps the order of its frames: an answer to X proves that all requests before X were answered or never will be. If X
    itself is pending, this is true of the requests before the first pending X. Before a pending object is requested
    again, a mandatory object is read: the device type, or else the error register.
    """

    __slots__ = ("pending",)

    def __init__(self) -> None:
        self.pending: dict[bytes, None] = {}  # only the keys are used, as an ordered set

    def add(self, mux: bytes) -> None:
        """Add the multiplexer of an abandoned request."""
        self.pending.setdefault(mux)

    def answered(self, mux: bytes) -> None:
        """Remove the requests that can have no late response after a response to `mux`."""
        if not self.pending:
            return
        if mux not in self.pending:
            self.pending.clear()
            return
        for earlier in list(self.pending):
            if earlier == mux:
                break
            del self.pending[earlier]

    def flush_request(self) -> bytes:
        """Return an upload request for 0x1000 or 0x1001: the object that is not pending, else the one pending last."""
        order = list(self.pending)
        return max(_PROBES, key=lambda probe: order.index(probe[1:4]) if probe[1:4] in self.pending else len(order))


_UNARMED: Final = 0  # deadline of a request whose time is unknown; the next tick sets it


class Transfer(Protocol):
    """Segmented or block transfer after an initiate request."""

    @property
    def toggle_suspect(self) -> bool:
        """Whether a frame with the wrong toggle bit was ignored as a copy; a timeout is then a toggle error."""

    @property
    def result(self) -> bytes:
        """Data of an upload; empty for a download."""

    @property
    def progress(self) -> tuple[int, int | None]:
        """Number of bytes transferred, and the size if known."""

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        """Process a frame of the server, as described in `sdo_transfers`."""

    def acknowledge_on_silence(self, out: list[CanFrame]) -> bool:
        """Acknowledge an incomplete sub-block after a timeout; return False if nothing can be acknowledged."""


class Phase:
    """Base class of the phases of a request; also the idle phase, in which all frames are ignored.

    `block` is True for a block transfer; `transfer` is set after the answer to an initiate request.
    """

    def __init__(self, block: bool = False, transfer: Transfer | None = None) -> None:
        self.block, self.transfer = block, transfer

    def receive(self, exchange: SdoTransfer, data: bytes, now: int) -> None:  # noqa: ARG002 - interface of all phases
        """Receive an eight-byte frame other than an abort."""
        exchange.ignored += 1

    def owns_abort(self, exchange: SdoTransfer, mux: bytes) -> bool:  # noqa: ARG002
        """Whether an abort with this multiplexer belongs to the request."""
        return False

    def aborted(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Process the server's abort of the request."""
        if data[1:4] == exchange.mux:
            exchange.late_answers.answered(exchange.mux)
        exchange.handle_abort(request, int.from_bytes(data[4:8], "little"), now)

    def expire(self, exchange: SdoTransfer, request: SdoRequest, now: int) -> None:
        """Handle the expiry of the deadline of the phase."""

    def abandon(self, exchange: SdoTransfer) -> None:
        """Send an abort for a cancelled request if the request was sent."""


class Pausing(Phase):
    """Phase after a busy abort: the request is repeated at the deadline."""

    def expire(self, exchange: SdoTransfer, request: SdoRequest, now: int) -> None:
        exchange.retry(request, now)


_IDLE: Final = Phase()
_PAUSING: Final = Pausing()


class SdoTransfer:
    """State of a client's transfers: the active request with its phase, and late responses.

    `first_phase` starts a try. The client fetches `out`, the frames to send, and `finished`, the ended requests. `mux`
    and `first` are the multiplexer and the first frame of the current try.
    """

    def __init__(
        self,
        node_id: int,
        name: str,
        retries: int,
        options: SdoOptions,
        request_cob_id: int,
        first_phase: FirstPhase,
    ) -> None:
        self.node_id, self.name, self.retries, self.options = node_id, name, retries, options
        self.request_cob_id, self._first_phase = request_cob_id, first_phase
        self.ignored = 0  # number of ignored frames of the server
        self.retried = 0  # number of tries after the first
        self.od: ObjectDictionary | None = None  # object dictionary of the node
        self.block_supported: bool | None = None  # None: unknown
        self.out: list[CanFrame] = []
        self.finished: list[SdoRequest] = []
        self.active: SdoRequest | None = None
        self.deadline: int | None = None
        self.phase: Phase = _IDLE
        self.late_answers = LateAnswerGuard()
        self.first = b""
        self.mux = b""
        self._started: int | None = None  # None: the first frame was not seen to be sent
        self._budget: RetryBudget | None = None  # None: no error yet
        self._constant_codes: set[int] = set()  # busy aborts of uploads that a pause did not change

    # -- client side

    @property
    def progress(self) -> tuple[int, int | None]:
        """Number of bytes transferred and the size; see `SdoClient.progress`."""
        transfer = self.phase.transfer
        return (0, None) if transfer is None else transfer.progress

    def start(self, request: SdoRequest, now: int | None) -> None:
        """Start a request; if `now` is None, its timeout starts at the next tick."""
        self.active, self._started, self._budget = request, now, None
        self.start_try(request, now)

    def receive(self, data: bytes, now: int) -> None:
        """Receive the data of a server's frame; count it as ignored if it does not answer the request."""
        if len(data) != 8 and not (data := completed(data)):
            self.ignored += 1
        elif data[0] != ABORT:
            self.phase.receive(self, data, now)
        elif (request := self.active) is not None and self.phase.owns_abort(self, data[1:4]):
            self.phase.aborted(self, request, data, now)
        else:
            self.ignored += 1

    def receive_records(self, records: bytes, start: int, cob_id: int, now: int) -> int:
        """Receive the consecutive segments of a block upload at once; return their number, which may be 0."""
        transfer, request = self.phase.transfer, self.active
        if not isinstance(transfer, BlockUpload) or request is None:
            return 0
        if count := transfer.receive_records(records, start, cob_id, self.out):
            self.deadline = now + request.timeout_ns
        return count

    def tick(self, now: int) -> None:
        """Start the timeout of a request that was sent, or process an expired timeout."""
        request = self.active
        if self.deadline is None or now < self.deadline or request is None:
            return
        if self.deadline == _UNARMED:
            self._started, self.deadline = now, now + request.timeout_ns
        else:
            self.phase.expire(self, request, now)

    def cancel(self, error: CanopenError) -> None:
        """End the active request with `error`; send an abort if the request was sent."""
        if (request := self.active) is None:
            return
        self.phase.abandon(self)
        self.idle()
        self.report(request, error)

    def forget(self) -> None:
        """Clear the pending late responses and the learned abilities of a server that has booted."""
        self.late_answers.pending.clear()
        self.block_supported = None
        self._constant_codes.clear()

    # -- phase side

    def start_try(self, request: SdoRequest, now: int | None) -> None:
        """Start a try and send the first frame."""
        self.phase, self.first = self._first_phase(self, request)
        self.mux = self.first[1:4]
        self.out.append(CanFrame(self.request_cob_id, self.first))
        self.deadline = _UNARMED if now is None else now + request.timeout_ns

    @property
    def may_use_blocks(self) -> bool:
        """Whether block transfer may be used: neither the server nor an earlier try has refused it."""
        return self.block_supported is not False and not (self._budget and self._budget.plain)

    def enter(self, request: SdoRequest, phase: Phase, now: int) -> None:
        """Enter the phase that follows the response to the initiate request, and restart the timeout."""
        self.phase = phase
        self.deadline = now + request.timeout_ns

    def retry(self, request: SdoRequest, now: int) -> None:
        """Start another try."""
        self.retried += 1
        self.start_try(request, now)

    def fits(self, request: SdoRequest, size: int | None, now: int) -> bool:
        """Whether the announced size of an upload is within the limit; if not, end the request."""
        if size is None or size <= self.options.max_size:
            return True
        self.abort_transfer(request, AbortCode.OUT_OF_MEMORY, now)
        return False

    def uploaded(self, request: SdoRequest, data: bytes, sized: bool, now: int) -> None:
        """Complete an upload; report SdoLengthError if the data does not fit the type of the object."""
        request.data = data
        entry = None if self.od is None else self.od.get(request.index, request.subindex)
        if entry is not None:
            if (value := fitted(data, entry.data_type, length_known=sized)) is None:
                self.finish(request, now, self._length_error(request, entry))
                return
            request.data = value
        self.finish(request, now)

    def finish(self, request: SdoRequest, now: int, error: CanopenError | None = None) -> None:
        """End the active request, successfully or with `error`."""
        request.elapsed_ns = 0 if self._started is None else now - self._started
        self.active = self.deadline = None  # inlined from `idle` and `report`
        self.phase, self.mux = _IDLE, b""
        request.error = error
        request.done = True
        self.finished.append(request)

    def report(self, request: SdoRequest, error: CanopenError | None) -> None:
        """Mark a request as done with `error`, and add it to `finished`."""
        request.error = error
        request.done = True
        self.finished.append(request)

    def idle(self) -> None:
        """Clear the active request and return to the idle phase."""
        self.active = self.deadline = None
        self.phase, self.mux = _IDLE, b""

    def handle_abort(self, request: SdoRequest, code: int, now: int) -> None:
        """Process an abort by the server or this client: retry, pause, or end the request."""
        budget = self._retry_budget()
        if self._program_started(request):
            if self.phase.block and code in BLOCK_ERRORS:
                self.block_supported = False  # the caller must clear the program and send it again, then in segments
            self.finish(request, now, self._abort_error(request, code))
        elif self.phase.block and code in BLOCK_ERRORS:
            if code == AbortCode.UNKNOWN_COMMAND and self.phase.transfer is None:
                self.block_supported = False
            budget.plain = True
            self.retry(request, now)
        elif budget.has_try(code):
            self.retry(request, now)
        elif self._may_disappear(request, code, budget) and (
            (until := budget.pause(code, self.options.busy_ns, now)) is not None
        ):
            self.phase, self.mux, self.deadline = _PAUSING, b"", until
        else:
            self.finish(request, now, self._abort_error(request, code))

    def abort_transfer(self, request: SdoRequest, code: int, now: int) -> None:
        """Abort the transfer because of an invalid frame of the server, or an object larger than `max_size`."""
        self._send_abort(code)
        if code == AbortCode.OUT_OF_MEMORY:  # the limit of this client does not change with a pause
            self.finish(request, now, self._abort_error(request, code))
        else:
            self.handle_abort(request, code, now)

    def handle_timeout(self, request: SdoRequest, now: int) -> None:
        """Abort a try after a timeout, then start another try or end the request."""
        budget = self._retry_budget()
        budget.waited_ns += request.timeout_ns
        program_started = self._program_started(request)
        if self.phase.block:
            budget.plain = True  # some servers do not answer unknown commands
        self.abort_unanswered(AbortCode.TIMED_OUT)
        if not program_started and budget.has_try(AbortCode.TIMED_OUT):
            self.retry(request, now)
        else:
            seconds = budget.waited_ns / 1e9
            self.finish(request, now, SdoTimeout(self.node_id, request.index, request.subindex, seconds, self.name))

    def _program_started(self, request: SdoRequest) -> bool:
        """Whether program data has been sent, so that no automatic retry may follow (CiA 302-3)."""
        return request.is_write and request.index == PROGRAM_DATA and self.phase.transfer is not None

    def abort_unanswered(self, code: int) -> None:
        """Abort a request that may still be answered."""
        self.late_answers.add(self.mux)
        self.out = [frame for frame in self.out if frame.data[0] == ABORT]  # pending segments are dropped
        self._send_abort(code)

    def _may_disappear(self, request: SdoRequest, code: int, budget: RetryBudget) -> bool:
        """Whether a retry after a pause may help: always for a download, once for an upload.

        A write may have to wait for the device. A read only waits if the server is busy with another client. Some
        servers answer every object without a value with 0x060A0023 (LocalNode of canopen), so that a code which a pause
        did not change is final from then on.
        """
        if request.is_write:
            return True
        if budget.paused:
            self._constant_codes.add(code)
        return not budget.paused and code not in self._constant_codes

    def _retry_budget(self) -> RetryBudget:
        if self._budget is None:
            self._budget = RetryBudget(self.retries)
        return self._budget

    def _send_abort(self, code: int) -> None:
        _, index, subindex, _ = INITIATE_NUMBER.unpack(self.first)
        self.out.append(CanFrame(self.request_cob_id, INITIATE_NUMBER.pack(ABORT, index, subindex, code)))

    def _abort_error(self, request: SdoRequest, code: int) -> SdoAbort:
        return SdoAbort(self.node_id, request.index, request.subindex, code, abort_text(code), self.name)

    def _length_error(self, request: SdoRequest, entry: Entry) -> SdoLengthError:
        data_type, address = entry.data_type, (self.node_id, request.index, request.subindex)
        expected = f"{data_type.name} has {((data_type.bits or 0) + 7) // 8}"
        return SdoLengthError(*address, request.data, expected, entry.name, self.name)
