"""The client of one SDO server: any number of callers, one request at a time (CiA 301, 7.2.4).

The law: a server has one client with one request outstanding; the others wait in the order in which they came, each
with a timeout that starts when its own first frame leaves. What an answer is and what follows from errors is the
exchange's affair (sdo_exchange.py).
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_client_block import BlockDownload, BlockUpload
from canopen_control.cia301.sdo_codec import (
    ABORT,
    ANSWER_BASE,
    BLOCK_DOWNLOAD_ANSWER,
    BLOCK_UPLOAD_ANSWER,
    COMMAND_MASK,
    CRC_FLAG,
    DONE,
    DOWNLOAD_ANSWER,
    DOWNLOAD_SEGMENT_ANSWER,
    EXPEDITED_LENGTHS,
    IGNORED,
    MAX_BLOCK_SIZE,
    NO_MUX,
    PROGRESS,
    REQUEST_BASE,
    SEGMENT,
    SEGMENT_DATA,
    SIZED_FLAG,
    TOGGLE,
    UPLOAD,
    UPLOAD_SEGMENT,
    UPLOAD_SIZED,
    UPLOAD_UNSIZED,
)
from canopen_control.cia301.sdo_exchange import Phase, SdoOptions, SdoRequest, SdoTransfer, initiate, initiate_block
from canopen_control.errors import LocalProtocolError, SdoRestarted
from canopen_control.frame import CanFrame

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.cia301.sdo_exchange import Transfer
    from canopen_control.errors import CanopenError
    from canopen_control.od.model import Entry


# The client's half of segmented transfers (CiA 301, 7.2.4.3.4 and 7.2.4.3.7).
#
# The law: the toggle bit starts at 0 and alternates with every segment. The bus may deliver a frame twice, directly one
# after the other; a copy of the answer before is ignored once, a second one is a toggle error. A transfer says what it
# makes of a frame with PROGRESS, DONE, IGNORED or the abort code to send; the client decides what follows from that.


_NEXT_SEGMENT = {toggle: bytes((UPLOAD_SEGMENT | toggle,)) + bytes(7) for toggle in (0, TOGGLE)}
_NO_ANSWER = b""


class SegmentedUpload:
    """Reads an object segment by segment; `size` is what the server announced, None if it did not."""

    __slots__ = ("_before", "_buffer", "_limit", "_request_id", "_size", "_toggle", "suspect")

    def __init__(self, request_id: int, size: int | None, limit: int, out: list[CanFrame]) -> None:
        self._request_id, self._size, self._limit = request_id, size, limit
        self._buffer = bytearray()
        self._toggle = 0
        self._before = _NO_ANSWER
        self.suspect = False  # a copy was ignored and nothing came since
        out.append(CanFrame(request_id, _NEXT_SEGMENT[0]))

    @property
    def result(self) -> bytes:
        """The object's bytes, as far as they came."""
        return bytes(self._buffer)

    @property
    def progress(self) -> tuple[int, int | None]:
        """Bytes that are over, and how many there are, None where the server has not said."""
        return len(self._buffer), self._size

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        """Take one answer of the server."""
        command = data[0]
        if command & COMMAND_MASK != SEGMENT or out:  # an answer cannot overtake its request
            return IGNORED
        if command & TOGGLE != self._toggle:
            return self._wrong_toggle(data)
        self._before, self.suspect = data, False
        self._toggle ^= TOGGLE
        self._buffer += data[1 : 8 - (command >> 1 & 7)]
        last = command & 1
        if (code := self._length_error(bool(last), empty=command & 0x0E == 0x0E)) != PROGRESS:
            return code
        if last:
            return DONE
        out.append(CanFrame(self._request_id, _NEXT_SEGMENT[self._toggle]))
        return PROGRESS

    def nudge(self, out: list[CanFrame]) -> bool:  # noqa: ARG002 - the interface of all transfers
        """Return False: a lost segment cannot be asked for again."""
        return False

    def _wrong_toggle(self, data: bytes) -> int:
        if data != self._before or self.suspect:
            return AbortCode.TOGGLE_NOT_ALTERNATED
        self.suspect = True
        return IGNORED

    def _length_error(self, last: bool, empty: bool) -> int:
        length, size = len(self._buffer), self._size
        if length > self._limit:
            return AbortCode.OUT_OF_MEMORY
        if size is not None and length > size:
            return AbortCode.LENGTH_TOO_HIGH
        if last and size is not None and length < size:
            return AbortCode.LENGTH_TOO_LOW
        if empty and not last:  # would go on for ever without moving anything
            return AbortCode.GENERAL_ERROR
        return PROGRESS


class SegmentedDownload:
    """Writes an object segment by segment."""

    __slots__ = ("_data", "_offset", "_request_id", "_toggle", "suspect")

    result = b""

    def __init__(self, request_id: int, data: bytes, out: list[CanFrame]) -> None:
        self._request_id, self._data = request_id, data
        self._offset = 0
        self._toggle = 0
        self.suspect = False
        self._send(out)

    @property
    def progress(self) -> tuple[int, int | None]:
        """Bytes that are over, and how many there are, None where the server has not said."""
        return min(self._offset, len(self._data)), len(self._data)

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        """Take one answer of the server."""
        command = data[0]
        if command & COMMAND_MASK != DOWNLOAD_SEGMENT_ANSWER or out:
            return IGNORED
        if command & TOGGLE != self._toggle:
            return self._wrong_toggle()
        self.suspect = False
        self._offset += SEGMENT_DATA
        if self._offset >= len(self._data):
            return DONE
        self._toggle ^= TOGGLE
        self._send(out)
        return PROGRESS

    def nudge(self, out: list[CanFrame]) -> bool:  # noqa: ARG002 - the interface of all transfers
        """Return False: a segment may not be sent twice."""
        return False

    def _wrong_toggle(self) -> int:
        if self._offset == 0 or self.suspect:
            return AbortCode.TOGGLE_NOT_ALTERNATED
        self.suspect = True
        return IGNORED

    def _send(self, out: list[CanFrame]) -> None:
        chunk = self._data[self._offset : self._offset + SEGMENT_DATA]
        last = self._offset + SEGMENT_DATA >= len(self._data)
        command = SEGMENT | self._toggle | (SEGMENT_DATA - len(chunk)) << 1 | last
        out.append(CanFrame(self._request_id, bytes((command,)) + chunk.ljust(SEGMENT_DATA, b"\0")))


# The phases of an SDO request: what a frame, an abort or a timeout means while each of them lasts (CiA 301, 7.2.4).
#
# The law of this file: an answer counts if its command and its multiplexer are those of the request, and if the request
# has left: what comes before that is the bus's copy of an older answer. There is one phase for each kind of first
# frame, and one for the rest of a transfer; what follows from what they find is decided in sdo_exchange.py.


class Awaiting(Phase):
    """The first frame is on its way, and the answer is due; what is one, the phases derived from this know."""

    def receive(self, exchange: SdoTransfer, data: bytes, now: int) -> None:
        """Take an answer to this request alone, and not before the request has left."""
        request = exchange.active
        if data[1:4] != exchange.mux or exchange.out or request is None:
            exchange.ignored += 1
        else:
            self.answered(exchange, request, data, now)

    def answered(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Take a frame with the multiplexer of the request."""
        raise NotImplementedError

    def concerns(self, exchange: SdoTransfer, mux: bytes) -> bool:
        """Whether the abort is about it: some servers name no object when they do not know a command."""
        if exchange.out:
            return False
        return mux == exchange.mux or (mux == NO_MUX and (self.block or not exchange.quarantine.owed))

    def time_out(self, exchange: SdoTransfer, request: SdoRequest, now: int) -> None:
        """Give this try up."""
        exchange.timed_out(request, now)

    def abandon(self, exchange: SdoTransfer) -> None:
        """Take the first frame back, or abort what has left."""
        if exchange.out:
            exchange.out.pop()
        else:
            exchange.die(AbortCode.GENERAL_ERROR)


class AwaitingUpload(Awaiting):
    """An upload was asked for: the answer has the data (expedited), or announces segments."""

    def answered(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Finish an expedited upload, or go on with segments."""
        if data[0] & COMMAND_MASK != UPLOAD:
            exchange.ignored += 1
            return
        if exchange.quarantine.owed:
            exchange.quarantine.answered(exchange.mux)
        if (length := EXPEDITED_LENGTHS.get(data[0])) is not None:
            exchange.uploaded(request, data[4 : 4 + length], data[0] & 1 == 1, now)
        elif data[0] in (UPLOAD_SIZED, UPLOAD_UNSIZED):
            size, limit = _size(data, data[0] == UPLOAD_SIZED), exchange.options.max_size
            if exchange.has_room(request, size, now):
                transfer = SegmentedUpload(exchange.request_cob_id, size, limit, exchange.out)
                exchange.proceed(request, Transferring(transfer, self.block), now)
        else:  # reserved bits are set, or the length of what is no expedited transfer
            exchange.give_up(request, AbortCode.UNKNOWN_COMMAND, now)


class AwaitingBlockUpload(AwaitingUpload):
    """A block upload was asked for; the server may switch and answer as if plainly asked."""

    def answered(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Go on in blocks."""
        command, options = data[0], exchange.options
        if command & ~(CRC_FLAG | SIZED_FLAG) != BLOCK_UPLOAD_ANSWER:
            super().answered(exchange, request, data, now)
            return
        exchange.quarantine.answered(exchange.mux)
        exchange.block_supported = True
        size = _size(data, bool(command & SIZED_FLAG))
        if exchange.has_room(request, size, now):
            limits = (size, options.max_size, bool(command & exchange.first[0] & CRC_FLAG), options.block_size)
            transfer = BlockUpload(exchange.request_cob_id, *limits, exchange.out)
            exchange.proceed(request, Transferring(transfer, block=True), now)


class AwaitingDownload(Awaiting):
    """A download was announced: its data went with it (expedited), or follow in segments."""

    def answered(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Finish an expedited download, or go on with segments."""
        if data[0] != DOWNLOAD_ANSWER:
            exchange.ignored += 1
            return
        exchange.quarantine.answered(exchange.mux)
        if exchange.first[0] & SIZED_FLAG:  # e: the data went with the request
            exchange.finish(request, now)
        else:
            transfer = SegmentedDownload(exchange.request_cob_id, request.data, exchange.out)
            exchange.proceed(request, Transferring(transfer, block=False), now)


class AwaitingBlockDownload(Awaiting):
    """A block download was announced."""

    def answered(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Go on in blocks of the size that the server asks for."""
        command, block_size = data[0], data[4]
        if command & ~CRC_FLAG != BLOCK_DOWNLOAD_ANSWER:
            exchange.ignored += 1
            return
        exchange.quarantine.answered(exchange.mux)
        exchange.block_supported = True
        if not 1 <= block_size <= MAX_BLOCK_SIZE:
            exchange.give_up(request, AbortCode.INVALID_BLOCK_SIZE, now)
            return
        crc = bool(command & exchange.first[0] & CRC_FLAG)
        transfer = BlockDownload(exchange.request_cob_id, request.data, crc, block_size, exchange.out)
        exchange.proceed(request, Transferring(transfer, block=True), now)


class Probing(Awaiting):
    """Another object is read first, so that no late answer can be taken for this request's."""

    def answered(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Begin the request itself: whatever the answer says, it settles what was owed."""
        if data[0] & COMMAND_MASK not in (UPLOAD, ABORT):
            exchange.ignored += 1
            return
        exchange.quarantine.answered(exchange.mux)
        exchange.begin(request, now)

    def aborted(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Take an abort as an answer."""
        self.answered(exchange, request, data, now)


class Transferring(Phase):
    """Segments or blocks are exchanged."""

    def __init__(self, transfer: Transfer, block: bool) -> None:
        self.block, self.transfer, self.rest = block, transfer, transfer

    def receive(self, exchange: SdoTransfer, data: bytes, now: int) -> None:
        """Hand a frame to the transfer, and end the request when it is done."""
        outcome = self.rest.receive(data, exchange.out)
        request = exchange.active
        if outcome == PROGRESS and request is not None:
            exchange.deadline = now + request.timeout_ns
        elif outcome == IGNORED or request is None:
            exchange.ignored += 1
        elif outcome == DONE and not request.is_write:
            exchange.uploaded(request, self.rest.result, True, now)
        elif outcome == DONE:
            exchange.finish(request, now)
        else:
            exchange.give_up(request, outcome, now)

    def concerns(self, exchange: SdoTransfer, mux: bytes) -> bool:
        """Whether the abort is about it: named, or nothing."""
        return mux in (exchange.mux, NO_MUX)

    def time_out(self, exchange: SdoTransfer, request: SdoRequest, now: int) -> None:
        """Let the transfer ask again where it can, else give this try up."""
        if self.rest.nudge(exchange.out):
            exchange.deadline = now + request.timeout_ns
        elif self.rest.suspect:
            exchange.die(AbortCode.TOGGLE_NOT_ALTERNATED)
            exchange.refused(request, AbortCode.TOGGLE_NOT_ALTERNATED, now)
        else:
            exchange.timed_out(request, now)

    def abandon(self, exchange: SdoTransfer) -> None:
        """Abort it."""
        exchange.die(AbortCode.GENERAL_ERROR)


def _size(data: bytes, told: bool) -> int | None:
    return int.from_bytes(data[4:8], "little") if told else None


_UPLOAD: Final = AwaitingUpload()
_DOWNLOAD: Final = AwaitingDownload()
_BLOCK_UPLOAD: Final = AwaitingBlockUpload(block=True)
_BLOCK_DOWNLOAD: Final = AwaitingBlockDownload(block=True)
_PROBING: Final = Probing()


def first_phase(exchange: SdoTransfer, request: SdoRequest) -> tuple[Phase, bytes]:
    """Return what a try waits for first, and its first frame: the request's, or that of another object before it."""
    if request.block and exchange.tries_blocks:
        phase: Phase = _BLOCK_DOWNLOAD if request.is_write else _BLOCK_UPLOAD
        data = initiate_block(request, exchange.options)
    else:
        phase = _DOWNLOAD if request.is_write else _UPLOAD
        data = initiate(request, exchange.options)
    if data[1:4] in exchange.quarantine.owed:
        return _PROBING, exchange.quarantine.probe()
    return phase, data


_DEFAULTS: Final = SdoOptions()


class SdoClient:
    """The queue of one server, and the exchange that works it off.

    `timeout_ns` is what every single answer may take, `retries` counts the tries after the first, `name` is the node's
    in messages. `request_cob_id` and `answer_cob_id` are those of the predefined connection set unless given.
    `entry_of` finds an object in the node's dictionary: an upload of what is known there has the length of its type, or
    is an SdoLengthError. Raises LocalProtocolError when asked for what no SDO can carry.
    """

    def __init__(
        self,
        node_id: int,
        *,
        timeout_ns: int = 500_000_000,
        retries: int = 1,
        name: str = "",
        options: SdoOptions = _DEFAULTS,
        entry_of: Callable[[int, int], Entry | None] | None = None,
        request_cob_id: int | None = None,
        answer_cob_id: int | None = None,
    ) -> None:
        self.node_id, self.name = node_id, name
        self.timeout_ns = timeout_ns
        self.answer_cob_id = ANSWER_BASE + node_id if answer_cob_id is None else answer_cob_id
        self.request_cob_id = REQUEST_BASE + node_id if request_cob_id is None else request_cob_id
        self._queue: deque[SdoRequest] = deque()
        self._exchange = SdoTransfer(node_id, name, retries, options, self.request_cob_id, first_phase)
        self._exchange.entry_of = entry_of

    # -- what callers ask for

    def read(
        self,
        index: int,
        subindex: int = 0,
        *,
        timeout_ns: int | None = None,
        block: bool | None = None,
        now: int | None = None,
    ) -> SdoRequest:
        """Upload an object; `data` of the request holds its bytes once it is `done`.

        Block transfer is used if `block` is True. With `now` the timeout starts at once, else with the next `tick`.
        """
        timeout = self.timeout_ns if timeout_ns is None else timeout_ns
        request = SdoRequest(index, subindex, None, timeout, block is True)
        self._enqueue(request, now)
        return request

    def write(
        self,
        index: int,
        subindex: int,
        data: bytes,
        *,
        timeout_ns: int | None = None,
        block: bool | None = None,
        now: int | None = None,
    ) -> SdoRequest:
        """Download the bytes `data` to an object; the request is `done` when the server has confirmed it.

        Where the caller does not choose with `block`, the length decides (see SdoOptions).
        """
        timeout = self.timeout_ns if timeout_ns is None else timeout_ns
        blocks = len(data) >= self._exchange.options.block_threshold if block is None else block
        request = SdoRequest(index, subindex, bytes(data), timeout, blocks)
        self._enqueue(request, now)
        return request

    def cancel(self, request: SdoRequest, error: CanopenError) -> None:
        """End one request with `error`; one that is done stays as it is."""
        if request is self._exchange.active:
            self._exchange.cancel(error)
            self._next(None)
        elif request in self._queue:
            self._queue.remove(request)
            self._exchange.report(request, error)

    def cancel_all(self, error: CanopenError) -> None:
        """End every request with `error`, waiting ones too."""
        self._exchange.cancel(error)
        while self._queue:
            self._exchange.report(self._queue.popleft(), error)

    def forget(self) -> None:
        """Forget what is known of the server, which has booted: it owes no answers, and a transfer's data are lost."""
        active = self._exchange.active
        if active is not None and self._exchange.phase.transfer is not None:
            self.cancel(active, SdoRestarted(self.node_id, active.index, active.subindex, self.name))
        self._exchange.forget()

    @property
    def busy(self) -> bool:
        """Whether a request is under way."""
        return self._exchange.active is not None

    @property
    def waiting(self) -> int:
        """How many requests wait behind the one under way."""
        return len(self._queue)

    @property
    def ignored(self) -> int:
        """How many frames of the server belonged to nothing: late, doubled, malformed, or about another object."""
        return self._exchange.ignored

    @property
    def retried(self) -> int:
        """How many tries were made after the first."""
        return self._exchange.retried

    @property
    def progress(self) -> tuple[int, int | None]:
        """Bytes of the transfer under way that are over, and how many there are; (0, None) while nobody knows.

        Made for who watches from another thread: a number that is a moment old.
        """
        return self._exchange.progress

    @property
    def block_supported(self) -> bool | None:
        """Whether the server knows block transfer; None if it has not been asked yet."""
        return self._exchange.block_supported

    # -- the sans-IO verbs

    def receive(self, frame: CanFrame, now: int) -> None:
        """Take a frame; those of other COB-IDs are not ours."""
        can_id, data = frame
        if can_id == self.answer_cob_id:
            self._exchange.receive(data, now)
            if self._queue:
                self._next(now)

    def receive_records(self, records: bytes, start: int, now: int) -> int:
        """Take what of the records from byte `start` on may be taken at once, as if each had been received.

        Return how many records that were. 0 is no refusal: the first of them is for `receive`.
        """
        return self._exchange.receive_records(records, start, self.answer_cob_id, now)

    def tick(self, now: int) -> None:
        """Let time pass: start the timeout of a request that has left, or act on one that ran out."""
        self._exchange.tick(now)
        if self._queue:
            self._next(now)

    def next_deadline(self) -> int | None:
        """Return when `tick` is due; 0 means at once."""
        return self._exchange.deadline

    def frames(self) -> list[CanFrame]:
        """Return what to send, in order."""
        if not (out := self._exchange.out):
            return []  # never our own list: callers extend what they get
        self._exchange.out = []
        return out

    def events(self) -> list[SdoRequest]:
        """Return the requests that ended since the last call."""
        if not (finished := self._exchange.finished):
            return []
        self._exchange.finished = []
        return finished

    # -- the queue

    def _enqueue(self, request: SdoRequest, now: int | None) -> None:
        if not (0 <= request.index <= 0xFFFF and 0 <= request.subindex <= 0xFF):
            raise LocalProtocolError(f"no object 0x{request.index:X}:{request.subindex:X}: 0xFFFF:FF is the last one")
        if len(request.data) > 0xFFFFFFFF:
            raise LocalProtocolError(f"{len(request.data)} bytes are more than an SDO transfer can announce")
        if self._exchange.active is None:
            self._exchange.start(request, now)
        else:
            self._queue.append(request)

    def _next(self, now: int | None) -> None:
        if self._queue and self._exchange.active is None:
            self._exchange.start(self._queue.popleft(), now)
