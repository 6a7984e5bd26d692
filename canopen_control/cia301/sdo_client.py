"""SDO client of one server: a queue of requests, and the phases of the current request (CiA 301, 7.2.4).

A server has one client with one outstanding request; the other requests wait in their order, each with a timeout that
starts when its first frame is sent. A phase decides which frames are answers to the request: command specifier and
multiplexer must match, and the request must have been sent, since an earlier frame can only be a copy of an older
answer. There is one phase per kind of initiate request, and one phase for segments and blocks. The consequences of
answers and errors are in `sdo_exchange`.
"""

from __future__ import annotations

from abc import ABCMeta, abstractmethod
from collections import deque
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_codec import (
    ABORT,
    ANSWER_BASE,
    BLOCK_DOWNLOAD_ANSWER,
    BLOCK_UPLOAD_ANSWER,
    COMMAND_MASK,
    CRC_FLAG,
    DONE,
    DOWNLOAD_ANSWER,
    EXPEDITED_CODES,
    EXPEDITED_LENGTHS,
    IGNORED,
    MAX_BLOCK_SIZE,
    NO_MUX,
    PROGRESS,
    REQUEST_BASE,
    SIZED_FLAG,
    UPLOAD,
    UPLOAD_SIZED,
    UPLOAD_UNSIZED,
)
from canopen_control.cia301.sdo_exchange import Phase, SdoOptions, SdoRequest, SdoTransfer, initiate, initiate_block
from canopen_control.cia301.sdo_transfers import BlockDownload, BlockUpload, SegmentedDownload, SegmentedUpload
from canopen_control.errors import LocalProtocolError, SdoCancelled, SdoRestarted

if TYPE_CHECKING:
    from canopen_control.cia301.sdo_exchange import Transfer
    from canopen_control.errors import CanopenError
    from canopen_control.frame import CanFrame
    from canopen_control.od.model import ObjectDictionary


class Awaiting(Phase, metaclass=ABCMeta):
    """Base class of the phases after an initiate request, while the server's response is pending."""

    def receive(self, exchange: SdoTransfer, data: bytes, now: int) -> None:
        request = exchange.active
        # CiA 301, 7.2.4.3: the answer repeats the multiplexer of the request
        if data[1:4] != exchange.mux or exchange.out or request is None:
            exchange.ignored += 1
        else:
            self.answered(exchange, request, data, now)

    @abstractmethod
    def answered(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Process a frame with the multiplexer of the request."""

    def owns_abort(self, exchange: SdoTransfer, mux: bytes) -> bool:
        """Whether an abort belongs to the request; some servers abort unknown commands with multiplexer 0."""
        if exchange.out:
            return False
        return mux == exchange.mux or (mux == NO_MUX and (self.block or not exchange.late_answers.pending))

    def expire(self, exchange: SdoTransfer, request: SdoRequest, now: int) -> None:
        exchange.handle_timeout(request, now)

    def abandon(self, exchange: SdoTransfer) -> None:
        """Withdraw the initiate request if it is not sent yet, else send an abort."""
        if exchange.out:
            exchange.out.pop()
        else:
            exchange.abort_unanswered(AbortCode.GENERAL_ERROR)


class AwaitingUpload(Awaiting):
    """Phase after the initiate request of an upload; the response has the data (expedited) or announces segments."""

    def answered(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Complete an expedited upload, or start receiving segments (CiA 301, 7.2.4.3.6)."""
        if data[0] & COMMAND_MASK != UPLOAD:
            exchange.ignored += 1
            return
        if exchange.late_answers.pending:
            exchange.late_answers.answered(exchange.mux)
        if (length := EXPEDITED_LENGTHS.get(data[0])) is not None:
            exchange.uploaded(request, data[4 : 4 + length], data[0] & 1 == 1, now)
        elif data[0] in (UPLOAD_SIZED, UPLOAD_UNSIZED):
            size, limit = _size(data, data[0] == UPLOAD_SIZED), exchange.options.max_size
            if exchange.fits(request, size, now):
                transfer = SegmentedUpload(exchange.request_cob_id, size, limit, exchange.out)
                exchange.enter(request, Transferring(transfer, self.block), now)
        else:  # reserved bits, or a size without an expedited transfer (CiA 301, 7.2.4.3.6)
            exchange.abort_transfer(request, AbortCode.UNKNOWN_COMMAND, now)


class AwaitingBlockUpload(AwaitingUpload):
    """Phase after the initiate request of a block upload; the server may switch to another upload protocol."""

    def answered(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Start receiving sub-blocks (CiA 301, 7.2.4.3.13)."""
        command, options = data[0], exchange.options
        if command & ~(CRC_FLAG | SIZED_FLAG) != BLOCK_UPLOAD_ANSWER:
            super().answered(exchange, request, data, now)
            return
        exchange.late_answers.answered(exchange.mux)
        exchange.block_supported = True
        size = _size(data, bool(command & SIZED_FLAG))
        if exchange.fits(request, size, now):
            limits = (size, options.max_size, bool(command & exchange.first[0] & CRC_FLAG), options.block_size)
            transfer = BlockUpload(exchange.request_cob_id, *limits, exchange.out)
            exchange.enter(request, Transferring(transfer, block=True), now)


class AwaitingDownload(Awaiting):
    """Phase after the initiate request of a download; the data was in the request (expedited) or follows."""

    def answered(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Complete an expedited download, or send the first segment (CiA 301, 7.2.4.3.3)."""
        if data[0] != DOWNLOAD_ANSWER:
            exchange.ignored += 1
            return
        exchange.late_answers.answered(exchange.mux)
        if exchange.first[0] & SIZED_FLAG:  # e bit: the data were in the initiate
            exchange.finish(request, now)
        else:
            transfer = SegmentedDownload(exchange.request_cob_id, request.data, exchange.out)
            exchange.enter(request, Transferring(transfer, block=False), now)


class AwaitingBlockDownload(Awaiting):
    """Phase after the initiate request of a block download."""

    def answered(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Send the first sub-block, with the number of segments requested by the server (CiA 301, 7.2.4.3.9)."""
        command, block_size = data[0], data[4]
        if command & ~CRC_FLAG != BLOCK_DOWNLOAD_ANSWER:
            exchange.ignored += 1
            return
        exchange.late_answers.answered(exchange.mux)
        exchange.block_supported = True
        # CiA 301, 7.2.4.3.9: 1 to 127 segments per sub-block
        if not 1 <= block_size <= MAX_BLOCK_SIZE:
            exchange.abort_transfer(request, AbortCode.INVALID_BLOCK_SIZE, now)
            return
        crc = bool(command & exchange.first[0] & CRC_FLAG)
        transfer = BlockDownload(exchange.request_cob_id, request.data, crc, block_size, exchange.out)
        exchange.enter(request, Transferring(transfer, block=True), now)


class FlushingLateAnswers(Awaiting):
    """Phase before the actual request, in which another object is read.

    The answer proves that no late answer can arrive any more and be mistaken for the answer to the actual request.
    """

    def answered(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Start the actual request; any response to the other object proves that no earlier response is outstanding."""
        if data[0] & COMMAND_MASK not in (UPLOAD, ABORT):
            exchange.ignored += 1
            return
        exchange.late_answers.answered(exchange.mux)
        exchange.start_try(request, now)

    def aborted(self, exchange: SdoTransfer, request: SdoRequest, data: bytes, now: int) -> None:
        """Process an abort like any other response."""
        self.answered(exchange, request, data, now)


class Transferring(Phase):
    """Phase in which segments or sub-blocks are exchanged."""

    def __init__(self, transfer: Transfer, block: bool) -> None:
        self.block, self.transfer, self._active = block, transfer, transfer

    def receive(self, exchange: SdoTransfer, data: bytes, now: int) -> None:
        """Pass a frame to the transfer, and end the request once the transfer is complete."""
        outcome = self._active.receive(data, exchange.out)
        request = exchange.active
        if outcome == PROGRESS and request is not None:
            exchange.deadline = now + request.timeout_ns
        elif outcome == IGNORED or request is None:
            exchange.ignored += 1
        elif outcome == DONE and not request.is_write:
            exchange.uploaded(request, self._active.result, True, now)
        elif outcome == DONE:
            exchange.finish(request, now)
        else:
            exchange.abort_transfer(request, outcome, now)

    def owns_abort(self, exchange: SdoTransfer, mux: bytes) -> bool:
        """Whether an abort belongs to the transfer: its multiplexer is that of the request, or 0."""
        return mux in (exchange.mux, NO_MUX)

    def expire(self, exchange: SdoTransfer, request: SdoRequest, now: int) -> None:
        """Acknowledge a sub-block whose end is missing, or end this try."""
        if self._active.acknowledge_on_silence(exchange.out):
            exchange.deadline = now + request.timeout_ns
        elif self._active.toggle_suspect:
            exchange.abort_unanswered(AbortCode.TOGGLE_NOT_ALTERNATED)
            exchange.handle_abort(request, AbortCode.TOGGLE_NOT_ALTERNATED, now)
        else:
            exchange.handle_timeout(request, now)

    def abandon(self, exchange: SdoTransfer) -> None:
        exchange.abort_unanswered(AbortCode.GENERAL_ERROR)


def _size(data: bytes, announced: bool) -> int | None:
    return int.from_bytes(data[4:8], "little") if announced else None


_UPLOAD: Final = AwaitingUpload()
_DOWNLOAD: Final = AwaitingDownload()
_BLOCK_UPLOAD: Final = AwaitingBlockUpload(block=True)
_BLOCK_DOWNLOAD: Final = AwaitingBlockDownload(block=True)
_FLUSHING: Final = FlushingLateAnswers()


def first_phase(exchange: SdoTransfer, request: SdoRequest) -> tuple[Phase, bytes]:
    """Return the first phase and the first frame of a try, or of the flush that must precede the try."""
    if request.block and exchange.may_use_blocks:
        phase: Phase = _BLOCK_DOWNLOAD if request.is_write else _BLOCK_UPLOAD
        data = initiate_block(request, exchange.options)
    else:
        phase = _DOWNLOAD if request.is_write else _UPLOAD
        data = initiate(request, exchange.options)
    if data[1:4] in exchange.late_answers.pending:
        return _FLUSHING, exchange.late_answers.flush_request()
    return phase, data


_DEFAULTS: Final = SdoOptions()


class SdoClient:
    """SDO client of one node, with a queue of requests.

    `timeout_ns` is the time for each answer, `retries` the number of tries after the first, `name` the node's name in
    messages. `request_cob_id` and `answer_cob_id` default to the predefined connection set. `od` is the node's
    dictionary: the data of an upload must then fit the type of the object, else the error is SdoLengthError.
    Requests that SDO cannot express raise LocalProtocolError.
    """

    def __init__(
        self,
        node_id: int,
        *,
        timeout_ns: int = 500_000_000,
        retries: int = 1,
        name: str = "",
        options: SdoOptions = _DEFAULTS,
        od: ObjectDictionary | None = None,
        request_cob_id: int | None = None,
        answer_cob_id: int | None = None,
    ) -> None:
        self.node_id, self.name = node_id, name
        self.timeout_ns = timeout_ns
        self.answer_cob_id = ANSWER_BASE + node_id if answer_cob_id is None else answer_cob_id
        self.request_cob_id = REQUEST_BASE + node_id if request_cob_id is None else request_cob_id
        self._queue: deque[SdoRequest] = deque()
        self._exchange = SdoTransfer(node_id, name, retries, options, self.request_cob_id, first_phase)
        self._exchange.od = od

    # -- requests

    def read(
        self,
        index: int,
        subindex: int = 0,
        *,
        timeout_ns: int | None = None,
        block: bool | None = None,
        now: int | None = None,
    ) -> SdoRequest:
        """Upload an object; `data` of the returned request contains its bytes once the request is `done`.

        Block transfer is used if `block` is True. With `now` the timeout starts at once, without it at the next `tick`.
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
        """Download `data` to an object; the request is `done` once the server has confirmed it.

        If `block` is None, the length determines the transfer (see SdoOptions).
        """
        timeout = self.timeout_ns if timeout_ns is None else timeout_ns
        blocks = len(data) >= self._exchange.options.block_threshold if block is None else block
        request = SdoRequest(index, subindex, bytes(data), timeout, blocks)
        self._enqueue(request, now)
        return request

    def cancel(self, request: SdoRequest, error: CanopenError) -> None:
        """End one request with `error`; no effect if it is done."""
        if request is self._exchange.active:
            self._exchange.cancel(error)
            self._next(None)
        elif request in self._queue:
            self._queue.remove(request)
            self._exchange.report(request, error)

    def cancel_transfer(self, request: SdoRequest) -> None:
        """Abort a transfer in segments or blocks and end its request with SdoCancelled; ignore other requests.

        A request of one frame is completed, because the server executes it anyway.
        """
        exchange = self._exchange
        moving = request is exchange.active and exchange.phase.transfer is not None
        if not request.done and (moving or (request.is_write and len(request.data) >= len(EXPEDITED_CODES))):
            self.cancel(request, SdoCancelled(self.node_id, request.index, request.subindex, self.name))

    def cancel_all(self, error: CanopenError) -> None:
        """End the active request and all waiting requests with `error`."""
        self._exchange.cancel(error)
        while self._queue:
            self._exchange.report(self._queue.popleft(), error)

    def forget(self) -> None:
        """Clear the state of a server that has booted: no late responses will arrive, and a transfer is lost."""
        active = self._exchange.active
        if active is not None and self._exchange.phase.transfer is not None:
            self.cancel(active, SdoRestarted(self.node_id, active.index, active.subindex, self.name))
        self._exchange.forget()

    @property
    def busy(self) -> bool:
        return self._exchange.active is not None

    @property
    def waiting(self) -> int:
        """Number of requests waiting for the end of the active request."""
        return len(self._queue)

    @property
    def ignored(self) -> int:
        """Number of ignored frames of the server: late, duplicate, malformed, or for another object."""
        return self._exchange.ignored

    @property
    def retried(self) -> int:
        """Number of retries, over all requests."""
        return self._exchange.retried

    @property
    def progress(self) -> tuple[int, int | None]:
        """Number of bytes transferred, and size of the object; (0, None) if no transfer is active.

        The property may be read from another thread, and is then slightly out of date.
        """
        return self._exchange.progress

    @property
    def block_supported(self) -> bool | None:
        """Whether the server supports block transfer; None if unknown."""
        return self._exchange.block_supported

    # -- sans-IO interface

    def receive(self, frame: CanFrame, now: int) -> None:
        can_id, data = frame
        if can_id == self.answer_cob_id:
            self._exchange.receive(data, now)
            if self._queue:
                self._next(now)

    def receive_records(self, records: bytes, start: int, now: int) -> int:
        """Process several frame records from byte `start` on at once, as if each were passed to `receive`.

        Return the number of records processed; if it is 0, pass the first record to `receive`.
        """
        return self._exchange.receive_records(records, start, self.answer_cob_id, now)

    def tick(self, now: int) -> None:
        """Start the timeout of a request that was sent, or process an expired timeout."""
        self._exchange.tick(now)
        if self._queue:
            self._next(now)

    def next_deadline(self) -> int | None:
        """Return the time of the next `tick`, 0 for now, or None if no request is active."""
        return self._exchange.deadline

    def frames(self) -> list[CanFrame]:
        if not (out := self._exchange.out):
            return []  # a new list, because callers extend the result
        self._exchange.out = []
        return out

    def events(self) -> list[SdoRequest]:
        if not (finished := self._exchange.finished):
            return []
        self._exchange.finished = []
        return finished

    # -- queue

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
