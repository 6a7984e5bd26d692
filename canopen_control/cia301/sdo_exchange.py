"""One SDO request of a client as a state machine: tries, answers, timeouts and aborts (CiA 301, 7.2.4).

The law of this file:
- What is awaited is a `Phase`: it alone knows what a frame, an abort, a timeout or a cancellation
  means; what follows from that is decided here.
- A timeout sends an abort with the true multiplexer. A block transfer that the server refuses, or whose CRC is wrong,
  is done again in segments. Every other abort ends the request.
- The data of a program (0x1F50, CiA 302-3) that broke off are never sent again by themselves, nor in segments: the
  server wants a fresh clear before.
- What an upload of a known object brought has the length of its type; else it is an error, and never a value.
- A request that died (timed out or cancelled) may still be answered: until that is settled, its object is in
  quarantine, so that no late answer can be taken for that of the retry.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.cia301.abort import BUSY_CODES, AbortCode, abort_text
from canopen_control.cia301.sdo_client_block import BlockUpload
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
from canopen_control.errors import LocalProtocolError, SdoAbort, SdoLengthError, SdoTimeout
from canopen_control.frame import CanFrame
from canopen_control.od.codec import fitted

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.errors import CanopenError
    from canopen_control.od.model import Entry

    FirstPhase = Callable[["SdoTransfer", "SdoRequest"], tuple["Phase", bytes]]
    """Function that returns the first phase of a try, and its first frame."""


# An SDO request as its caller holds it, the client's options, and how often is tried again.
#
# The law of trying again: a timeout is tried `retries` times more; a toggle error starts the transfer again at most
# twice; "not now" to a download is asked again after pauses that grow, until `busy_ns` are over, to an upload once;
# what block transfer could not do is done in segments, once. None of these counts against another.


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


# The first frame of an SDO transfer, and answers that servers cut short (CiA 301, 7.2.4.3).
#
# The law: what fits four bytes goes with the initiate (expedited), everything else in segments or blocks. Some servers
# cut their frames behind the last used byte, although CiA 301 wants eight: that is made good where no byte is missing.


BLOCK_ERRORS: Final = frozenset(  # what segments may still do: without CRC a lost segment shows in the length
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
    """Return the first frame of an expedited or segmented transfer."""
    index, subindex, data = request.index, request.subindex, request.data
    if not request.is_write:
        return INITIATE.pack(UPLOAD, index, subindex)
    length, sized = len(data), options.announce_size
    if 1 <= length <= 4:
        command = DOWNLOAD | (EXPEDITED_CODES[length] if sized else SIZED_FLAG)
        return INITIATE_BYTES.pack(command, index, subindex, data)
    return INITIATE_NUMBER.pack(DOWNLOAD | sized, index, subindex, length if sized else 0)


def initiate_block(request: SdoRequest, options: SdoOptions) -> bytes:
    """Return the first frame of a block transfer."""
    crc = CRC_FLAG if options.crc else 0
    index, subindex = request.index, request.subindex
    if not request.is_write:
        parameters = bytes((options.block_size, options.switch_threshold))
        return INITIATE_BYTES.pack(BLOCK_UPLOAD | crc, index, subindex, parameters)
    sized, length = (SIZED_FLAG, len(request.data)) if options.announce_size else (0, 0)
    return INITIATE_NUMBER.pack(BLOCK_DOWNLOAD | crc | sized, index, subindex, length)


def completed(data: bytes) -> bytes:
    """Fill up a frame that was cut behind its last used byte; empty if it lacks a byte that counts."""
    if len(data) < 4 or len(data) > 8:
        return b""
    used = {ABORT: 8, DOWNLOAD_ANSWER: 4}.get(data[0], 4 + EXPEDITED_LENGTHS.get(data[0], 4))
    return data.ljust(8, b"\0") if len(data) >= used else b""


# Objects that may not be read or written yet, because a late SDO answer about them may still come.
#
# The law: an answer carries command and multiplexer, nothing else, so an answer that comes late cannot be told from
# that of the retry, nor from that of the next request for the same object. What can be told is the order: a server
# works off its requests one after the other, and the bus keeps the order of one sender's frames. An answer to X thus
# settles all that was asked before X: it has been answered, or never will be. If X itself is owed an answer, it settles
# what was asked before the first X that is. Before an object in quarantine is asked for again, a mandatory object is
# read to settle it: the device type, or else the error register.


_PROBES: Final = (INITIATE.pack(UPLOAD, 0x1000, 0), INITIATE.pack(UPLOAD, 0x1001, 0))


class LateAnswerGuard:
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


_PROGRAM_DATA: Final = 0x1F50
_UNARMED: Final = 0  # the deadline of a request whose caller did not say when it is; the next tick does


class Transfer(Protocol):
    """What follows an initiate that was not expedited."""

    suspect: bool

    @property
    def result(self) -> bytes:
        """What was read; empty after a write."""

    @property
    def progress(self) -> tuple[int, int | None]:
        """Bytes done, and of how many where that is known."""

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        """Take an answer of the server; returns the state."""

    def nudge(self, out: list[CanFrame]) -> bool:
        """Ask again where the protocol has a way to; returns whether it has."""


class Phase:
    """What the exchange waits for. This one is no request at all: nothing of the server belongs to it.

    `block` says whether block transfer is tried; `transfer` is what follows the first answer.
    """

    def __init__(self, block: bool = False, transfer: Transfer | None = None) -> None:
        self.block, self.transfer = block, transfer

    def receive(self, exchange: SdoTransfer, data: bytes, now: int) -> None:  # noqa: ARG002 - what every phase gets
        """Take a frame of eight bytes that is no abort."""
        exchange.ignored += 1

    def concerns(self, exchange: SdoTransfer, mux: bytes) -> bool:  # noqa: ARG002
        """Whether an abort of this multiplexer is about the request."""
        return False

    def aborted(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Take an abort that concerns the request."""
        if data[1:4] == exchange.mux:
            exchange.quarantine.answered(exchange.mux)
        exchange.refused(request, int.from_bytes(data[4:8], "little"), now)

    def time_out(self, exchange: SdoTransfer, request: SdoRequest, now: int) -> None:
        """Act on a deadline that has passed."""

    def abandon(self, exchange: SdoTransfer) -> None:
        """Let the server know that nobody waits any more, if it has heard of the request."""


class Pausing(Phase):
    """The server has said "not now": the request is made again when the deadline passes."""

    def time_out(self, exchange: SdoTransfer, request: SdoRequest, now: int) -> None:
        """Ask again."""
        exchange.again(request, now)


_IDLE: Final = Phase()
_PAUSING: Final = Pausing()


class SdoTransfer:
    """The request under way, if there is one, as its client sees it, and what its phases do with it.

    `first_phase` says how a try begins. `out` holds what is to be sent and `finished` the requests
    that ended: both are the client's to take. `mux` and `first` are the multiplexer and the first frame of this try.
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
        self.ignored = 0  # frames from the server that belonged to nothing
        self.retried = 0  # tries after the first
        self.entry_of: Callable[[int, int], Entry | None] | None = None  # of the node's dictionary
        self.block_supported: bool | None = None  # None: not known yet
        self.out: list[CanFrame] = []
        self.finished: list[SdoRequest] = []
        self.active: SdoRequest | None = None
        self.deadline: int | None = None
        self.phase: Phase = _IDLE
        self.quarantine = LateAnswerGuard()
        self.first = b""
        self.mux = b""
        self._started: int | None = None  # None: the first frame has not been seen to leave
        self._budget: RetryBudget | None = None  # None: the request has had no trouble yet
        self._in_vain: set[int] = set()  # "not now" of uploads that a pause has not changed

    # -- what the client does

    @property
    def progress(self) -> tuple[int, int | None]:
        """How far the transfer under way is, in bytes; see `SdoClient.progress`."""
        transfer = self.phase.transfer
        return (0, None) if transfer is None else transfer.progress

    def start(self, request: SdoRequest, now: int | None) -> None:
        """Begin a request; with `now` None its timeout starts with the next tick."""
        self.active, self._started, self._budget = request, now, None
        self.begin(request, now)

    def receive(self, data: bytes, now: int) -> None:
        """Take the data of a frame from the server; what answers nothing is counted."""
        if len(data) != 8 and not (data := completed(data)):
            self.ignored += 1
        elif data[0] != ABORT:
            self.phase.receive(self, data, now)
        elif (request := self.active) is not None and self.phase.concerns(self, data[1:4]):
            self.phase.aborted(self, request, data, now)
        else:
            self.ignored += 1

    def receive_records(self, records: bytes, start: int, cob_id: int, now: int) -> int:
        """Take a run of a block upload's segments at once; return how many records, 0 if there is none."""
        transfer, request = self.phase.transfer, self.active
        if not isinstance(transfer, BlockUpload) or request is None:
            return 0
        if count := transfer.receive_records(records, start, cob_id, self.out):
            self.deadline = now + request.timeout_ns
        return count

    def tick(self, now: int) -> None:
        """Start the timeout of a request that has left, or act on one that ran out."""
        request = self.active
        if self.deadline is None or now < self.deadline or request is None:
            return
        if self.deadline == _UNARMED:
            self._started, self.deadline = now, now + request.timeout_ns
        else:
            self.phase.time_out(self, request, now)

    def cancel(self, error: CanopenError) -> None:
        """Give up the request under way without an answer; the server is told if it has heard of it."""
        if (request := self.active) is None:
            return
        self.phase.abandon(self)
        self.idle()
        self.report(request, error)

    def forget(self) -> None:
        """Forget what is known of the server: it has booted."""
        self.quarantine.owed.clear()
        self.block_supported = None
        self._in_vain.clear()

    # -- what the phases do

    def begin(self, request: SdoRequest, now: int | None) -> None:
        """Make a try: send its first frame."""
        self.phase, self.first = self._first_phase(self, request)
        self.mux = self.first[1:4]
        self.out.append(CanFrame(self.request_cob_id, self.first))
        self.deadline = _UNARMED if now is None else now + request.timeout_ns

    @property
    def tries_blocks(self) -> bool:
        """Whether block transfer may still be tried: neither the server nor an earlier try has shown that it fails."""
        return self.block_supported is not False and not (self._budget and self._budget.plain)

    def proceed(self, request: SdoRequest, phase: Phase, now: int) -> None:
        """Go on with what follows the first answer."""
        self.phase = phase
        self.deadline = now + request.timeout_ns

    def again(self, request: SdoRequest, now: int) -> None:
        """Make another try."""
        self.retried += 1
        self.begin(request, now)

    def has_room(self, request: SdoRequest, size: int | None, now: int) -> bool:
        """Whether an upload may be as large as it was announced; if not, the request has ended."""
        if size is None or size <= self.options.max_size:
            return True
        self.give_up(request, AbortCode.OUT_OF_MEMORY, now)
        return False

    def uploaded(self, request: SdoRequest, data: bytes, sized: bool, now: int) -> None:
        """End an upload with its data, if they have the length of the object's type."""
        request.data = data
        entry = None if self.entry_of is None else self.entry_of(request.index, request.subindex)
        if entry is not None:
            if (whole := fitted(data, entry.data_type, told=sized)) is None:
                self.finish(request, now, self._length_error(request, entry))
                return
            request.data = whole
        self.finish(request, now)

    def finish(self, request: SdoRequest, now: int, error: CanopenError | None = None) -> None:
        """End the request under way."""
        request.elapsed_ns = 0 if self._started is None else now - self._started
        self.active = self.deadline = None  # `idle` and `report`, without the calls
        self.phase, self.mux = _IDLE, b""
        request.error = error
        request.done = True
        self.finished.append(request)

    def report(self, request: SdoRequest, error: CanopenError | None) -> None:
        """End a request."""
        request.error = error
        request.done = True
        self.finished.append(request)

    def idle(self) -> None:
        """Wait for nothing."""
        self.active = self.deadline = None
        self.phase, self.mux = _IDLE, b""

    def refused(self, request: SdoRequest, code: int, now: int) -> None:
        """Decide what follows from an abort, be it the server's or ours."""
        budget = self._trouble()
        if self._broke_off(request):
            if self.phase.block and code in BLOCK_ERRORS:
                self.block_supported = False  # whoever clears it and sends it anew does so in segments
            self.finish(request, now, self._abort_error(request, code))
        elif self.phase.block and code in BLOCK_ERRORS:
            if code == AbortCode.UNKNOWN_COMMAND and self.phase.transfer is None:
                self.block_supported = False
            budget.plain = True
            self.again(request, now)
        elif budget.has_try(code):
            self.again(request, now)
        elif self._may_change(request, code, budget) and (
            (until := budget.pause(code, self.options.busy_ns, now)) is not None
        ):
            self.phase, self.mux, self.deadline = _PAUSING, b"", until
        else:
            self.finish(request, now, self._abort_error(request, code))

    def give_up(self, request: SdoRequest, code: int, now: int) -> None:
        """Abort the transfer because of what the server sent."""
        self._send_abort(code)
        if code == AbortCode.OUT_OF_MEMORY:  # our own limit: no pause makes it larger
            self.finish(request, now, self._abort_error(request, code))
        else:
            self.refused(request, code, now)

    def timed_out(self, request: SdoRequest, now: int) -> None:
        """Abort the try that got no answer, and make another one or end the request."""
        budget = self._trouble()
        budget.waited_ns += request.timeout_ns
        broke_off = self._broke_off(request)
        if self.phase.block:
            budget.plain = True  # some servers do not answer what they do not know
        self.die(AbortCode.TIMED_OUT)
        if not broke_off and budget.has_try(AbortCode.TIMED_OUT):
            self.again(request, now)
        else:
            seconds = budget.waited_ns / 1e9
            self.finish(request, now, SdoTimeout(self.node_id, request.index, request.subindex, seconds, self.name))

    def _broke_off(self, request: SdoRequest) -> bool:
        """Whether a program's data have begun to flow, so that no other try may follow by itself."""
        return request.is_write and request.index == _PROGRAM_DATA and self.phase.transfer is not None

    def die(self, code: int) -> None:
        """Abort a transfer whose last answer is still owed."""
        self.quarantine.died(self.mux)
        self.out = [one for one in self.out if one.data[0] == ABORT]  # no segment that nobody wants any more
        self._send_abort(code)

    def _may_change(self, request: SdoRequest, code: int, budget: RetryBudget) -> bool:
        """Whether "not now" may be another answer after a pause; an upload is asked for once more, a download longer.

        What is written may have to wait for what the device does. An upload has nothing to wait for, but for a server
        that serves somebody else; some answer 0x060A0023 for every object without a value (canopen's LocalNode), so
        that a code which a pause did not change is taken at its word from then on.
        """
        if request.is_write:
            return True
        if budget.paused:
            self._in_vain.add(code)
        return not budget.paused and code not in self._in_vain

    def _trouble(self) -> RetryBudget:
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
        wanted = f"{data_type.name} has {((data_type.bits or 0) + 7) // 8}"
        return SdoLengthError(*address, request.data, wanted, entry.name, self.name)
